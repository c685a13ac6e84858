"""Measure the code: lines, docstrings, names, modules: python scripts/measure_code.py.

A line of code is one that is not blank, a comment or part of a docstring.
"""

import ast
import io
import sys
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import numpy as np

import sato

ROOT = Path(__file__).parents[1]
PACKAGES = ("dynamics", "problems", "sato")
EVASIVE = {"What", "Who", "How", "Whether", "Where", "When", "As", "By", "That"}
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}
Documented = ast.Module | ast.ClassDef | ast.FunctionDef


def code_lines(file: Path) -> int:
    """Count the lines of code of a file."""
    text = file.read_text(encoding="utf-8")
    docstrings: set[int] = set()
    for node in documented(ast.parse(text)):
        if ast.get_docstring(node) is not None:
            first = node.body[0]
            docstrings.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in LAYOUT:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def documented(tree: ast.AST) -> Iterator[Documented]:
    """Yield the nodes of a tree that may have a docstring."""
    return (node for node in ast.walk(tree) if isinstance(node, Documented))


def trees(folder: str) -> Iterator[tuple[str, ast.Module]]:
    """Yield the syntax tree of every file in a folder, with its path."""
    for file in sorted((ROOT / folder).rglob("*.py")):
        yield str(file.relative_to(ROOT)), ast.parse(file.read_text(encoding="utf-8"))


def evasive_docstrings() -> list[str]:
    """List docstrings of the packages that begin with a word like What or Whether."""
    found = []
    for package in PACKAGES:
        for path, tree in trees(package):
            for node in documented(tree):
                text = ast.get_docstring(node)
                if text and text.split()[0].rstrip(",:") in EVASIVE:
                    found.append(f"{path}:{getattr(node, 'lineno', 1)}: {text.splitlines()[0]}")
    return found


def shared_class_names() -> dict[str, list[str]]:
    """Return the public classes of the packages that share a name, with their files."""
    files: dict[str, list[str]] = defaultdict(list)
    for package in PACKAGES:
        for path, tree in trees(package):
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    files[node.name].append(path)
    return {name: paths for name, paths in files.items() if len(paths) > 1}


def long_test_names(longest: int = 70) -> list[str]:
    """List the tests with longer names."""
    return [
        node.name
        for _, tree in trees("tests")
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and node.name.startswith("test_")
        and len(node.name) > longest
    ]


def modules_of_a_mission() -> tuple[list[str], list[str]]:
    """List the modules that run from the constructor to the loop, for arrays, and to a frame."""
    row = np.c_[np.arange(4.0), np.zeros((4, 3))]
    model, leg = sato.DoubleIntegrator(2), sato.Leg(row + np.eye(4)[1], steps=20)
    limits = {"step": 1.0, "comm_radius": 20.0, "collision_radius": 0.5, "max_control": 0.2}

    def fly() -> None:
        mission = sato.Reconfiguration(model=model, start=row, legs=[leg], max_speed=1.0, **limits)
        next(sato.simulate(mission))

    fly()  # imports, which run module and class bodies
    entered: dict[str, bool] = {}  # true where the loop had begun
    has_begun = False
    folders = [str(ROOT / package) for package in PACKAGES]

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(tuple(folders)):
            nonlocal has_begun
            entered.setdefault(str(Path(code.co_filename).relative_to(ROOT)), has_begun)
            is_loop = code.co_filename.endswith("/loop.py")
            has_begun = has_begun or (is_loop and code.co_qualname == "simulate")

    sys.setprofile(note)
    try:
        fly()
    finally:
        sys.setprofile(None)
    after = [module for module, is_after in entered.items() if is_after]
    return [module for module in entered if module not in after], after


def main() -> None:
    """Print the measures."""
    lines: Counter[str] = Counter()
    for folder in (*PACKAGES, "tests", "scripts", "campaigns"):
        lines[folder] = sum(map(code_lines, (ROOT / folder).rglob("*.py")))
    for folder, count in lines.items():
        print(f"{folder}: {count} lines of code")
    print(f"three packages: {sum(lines[package] for package in PACKAGES)} lines of code")
    print(f"docstrings that begin with a word like What: {len(evasive_docstrings())}")
    print(f"public classes that share a name: {len(shared_class_names())}")
    entered, after = modules_of_a_mission()
    print(f"modules entered before the loop, for arrays: {len(entered)}: {', '.join(entered)}")
    print(f"and until the first frame: {len(after)}")
    print(f"test names longer than 70 characters: {len(long_test_names())}")


if __name__ == "__main__":
    main()
