"""The suite on each Python, with the lowest and the newest dependencies: make matrix.

python scripts/test_matrix.py [--python PATH] [--only 3.13-lowest] [-- -n 1 -x]

The Pythons are those that pyproject.toml names. They are sought in PATH and among those of pyenv,
or given by path, and a missing one is a failure. Environments are made anew in build/matrix, from
the bounds of pyproject.toml: with the lowest version of each direct dependency that has a wheel
for the Python and the newest of all others, or with the newest of all. Words after `--` go to
pytest, whose output is in build/matrix/3.13-lowest.log. The last lines are a table for the page.
Exit code 1 where a Python is missing, an environment cannot be made, or a suite fails.
"""

import argparse
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import Any

ROOT = Path(__file__).parents[1]
HOME = ROOT / "build/matrix"
EXTRAS = "dev,rerun"
KINDS = {"lowest": "lowest-direct", "newest": "highest"}
WITHOUT_WHEELS = {"ecos", "oem"}  # compiled where there is none: both have a single version
SHOWN = (
    "numpy",
    "scipy",
    "numba",
    "cvxpy",
    "clarabel",
    "highspy",
    "casadi",
    "xarray",
    "matplotlib",
)


def read_project() -> dict[str, Any]:
    """Read the table of the project in pyproject.toml."""
    table: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    return table


def list_versions(project: dict[str, Any]) -> list[str]:
    """List the Pythons that the project names, as in 3.13."""
    said = (re.fullmatch(r"Programming .* (3\.\d+)", word) for word in project["classifiers"])
    return [match[1] for match in said if match]


def list_direct(project: dict[str, Any]) -> list[str]:
    """List the names of direct dependencies, with those of all extras."""
    optional = project["optional-dependencies"].values()
    lines = [*project["dependencies"], *(line for lines in optional for line in lines)]
    names = {re.match(r"[\w.-]+", line)[0] for line in lines}  # type: ignore[index]
    return sorted(names - {project["name"]})


def list_candidates(version: str) -> Iterator[Path]:
    """List where an interpreter may be: in PATH, and among those of pyenv."""
    folders = [Path(word) for word in os.environ["PATH"].split(os.pathsep)]
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    folders += sorted(pyenv.glob(f"{version}.*/bin"), reverse=True)
    return (folder / f"python{version}" for folder in folders)


def ask_version(python: Path) -> str | None:
    """Ask an interpreter for its version, as in 3.13; a shim of none has no answer."""
    asked = [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    try:
        done = subprocess.run(asked, capture_output=True, text=True)
    except OSError:
        return None
    return done.stdout.strip() if done.returncode == 0 else None


def find_pythons(versions: list[str], given: list[Path]) -> dict[str, Path]:
    """Find an interpreter of each version, those given by path first.

    Raises:
        SystemExit: A version is missing, or a path leads to none of them.
    """
    found = {}
    for path in given:
        version = ask_version(path)
        if version not in versions:
            raise SystemExit(f"{path}: not one of Python {', '.join(versions)}")
        found[version] = path
    for version in versions:
        paths = (path for path in list_candidates(version) if ask_version(path) == version)
        if version not in found and (path := next(paths, None)):
            found[version] = path
    if missing := [version for version in versions if version not in found]:
        words = " ".join(f"/path/to/python{version}" for version in missing)
        raise SystemExit(f'Python {", ".join(missing)}: not found; PYTHONS="{words}" would do')
    return found


def make_environment(python: Path, home: Path, resolution: str, direct: list[str]) -> None:
    """Make an environment anew, and install the project with its extras into it."""
    uv = [sys.executable, "-m", "uv"]
    make = [*uv, "venv", "--quiet", "--clear", "--no-python-downloads", "--python", python, home]
    wheels = [f"--only-binary={name}" for name in direct if name not in WITHOUT_WHEELS]
    install = [*uv, "pip", "install", "--quiet", "--python", home / "bin/python", *wheels]
    install += ["--resolution", KINDS[resolution], "--editable", f"{ROOT}[{EXTRAS}]"]
    subprocess.run(make, check=True)
    subprocess.run(install, check=True)


def read_versions(home: Path) -> list[str]:
    """Read the versions of the packages that the table shows."""
    ask = "import sys; from importlib.metadata import version; print(*map(version, sys.argv[1:]))"
    done = subprocess.run(
        [home / "bin/python", "-c", ask, *SHOWN], check=True, capture_output=True, text=True
    )
    return done.stdout.split()


def run_suite(home: Path, words: list[str]) -> tuple[int, str]:
    """Run the suite in an environment, and return exit code and last line."""
    # Commands that tests start by name are those of the environment.
    env = os.environ | {"PATH": os.pathsep.join([str(home / "bin"), os.environ["PATH"]])}
    command = [home / "bin/python", "-m", "pytest", *words]
    log = home.parent / f"{home.name}.log"
    with log.open("w") as out:
        done = subprocess.run(command, cwd=ROOT, env=env, stdout=out, stderr=subprocess.STDOUT)
    lines = log.read_text("utf-8").strip().splitlines()
    return done.returncode, lines[-1].strip("= ") if lines else ""


def try_environment(python: Path, name: str, words: list[str]) -> tuple[bool, list[str]]:
    """Make an environment and run the suite in it; return the outcome and a row of the table."""
    home, begin = HOME / name, monotonic()
    row = name.split("-")
    try:
        make_environment(python, home, row[1], list_direct(read_project()))
        row += read_versions(home)
    except subprocess.CalledProcessError as error:
        return False, [*row, *["–"] * len(SHOWN), f"cannot be made: {error}"]
    print(f"{name}: made in {monotonic() - begin:.0f} s", flush=True)
    code, line = run_suite(home, words)
    print(f"{name}: exit code {code}, {line}", flush=True)
    return code == 0, [*row, line]


def main() -> None:
    """Run the suite in all environments, and print a table for the page."""
    names = [f"{version}-{kind}" for version in list_versions(read_project()) for kind in KINDS]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--python", type=Path, nargs="*", default=[], help="interpreters, by path")
    parser.add_argument("--only", choices=names, nargs="*", help="environments, all by default")
    parser.add_argument("words", nargs="*", help="arguments of pytest, after --")
    arguments = parser.parse_args()
    chosen = arguments.only or names
    pythons = find_pythons(sorted({name.split("-")[0] for name in chosen}), arguments.python)
    HOME.mkdir(parents=True, exist_ok=True)
    outcomes = [
        try_environment(pythons[name.split("-")[0]], name, arguments.words) for name in chosen
    ]
    heads = ["Python", "dependencies", *SHOWN, "suite"]
    rows = [heads, ["---"] * len(heads), *(row for _, row in outcomes)]
    print(*(f"| {' | '.join(row)} |" for row in rows), sep="\n")
    sys.exit(not all(is_good for is_good, _ in outcomes))


if __name__ == "__main__":
    main()
