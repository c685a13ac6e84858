"""Run, check and plot in hostile environments: python scripts/try_environments.py.

Each condition is a change of the environment, a command that starts the other, or a file, and is
tried alone, and some in pairs. A command works, and writes what it writes elsewhere, to the bit; or
it says in a sentence what would do. Exit code 1 where one ends otherwise: with a traceback, a
signal, or another result.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from sato.run_file import read_run_file

ROOT = Path(__file__).parents[1]
PACKAGES = ("dynamics", "problems", "sato")
COMMANDS = {"run": "run crossing --out r", "check": "check r", "plot": "plot r"}
PAIRS = 15
PATIENCE = 900.0  # for a command [s]
SENTENCES = ("sato: ", "Error: ", "ImportError: ")  # of which one begins the last line
CRASHES = ("Traceback", "fault of the program", "Fatal Python error")
NOBODY = ("setpriv", "--reuid=65534", "--regid=65534", "--clear-groups")
OWN_MOUNTS = "unshare", "-m", "bash", "-c"
TERMINAL = "import os, pty, sys; sys.exit(os.waitstatus_to_exitcode(pty.spawn(sys.argv[1:])))"
RC = """
text.usetex: True
font.family: Nowhere Sans
backend: TkAgg
savefig.transparent: True
savefig.bbox: tight
savefig.dpi: 17
figure.figsize: 1, 1
axes.grid: True
image.interpolation: nothing
no.such.key: 3
"""
JUMPING = """
import time
from itertools import cycle
true, jumps = time.time, cycle([0.0, 1e6, -1e6, 3e9])
time.time = lambda: true() + next(jumps)
"""


def with_files(texts: dict[str, str]) -> Callable[[Path], None]:
    """Return a function that writes files into a folder, or adds to those that are there."""

    def write(home: Path) -> None:
        for name, text in texts.items():
            path = home / name
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a") as file:
                file.write(text)
            path.chmod(0o755)

    return write


def install_elsewhere(home: Path) -> None:
    """Copy the packages under a path with spaces and letters."""
    for name in PACKAGES:
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, home / "ça là, 目录" / name, ignore=ignored)


class Condition(NamedTuple):
    """Change of the environment of a command."""

    variables: tuple[tuple[str, str], ...] = ()  # H/ stands for the folder
    prefix: tuple[str, ...] = ()
    set_up: Callable[[Path], None] = lambda home: None
    more: str = ""  # a further command
    is_ordinary: bool = False  # of a user who may not write to the tree, and has no home


def variable(**values: str) -> Condition:
    """Return the condition of some variables of the environment."""
    return Condition(tuple(values.items()))


def started_by(*prefix: str, **values: str) -> Condition:
    """Return the condition that another command starts the commands."""
    return Condition(tuple(values.items()), prefix)


def shell(line: str, **values: str) -> Condition:
    """Return the condition that a shell does something before it starts the commands."""
    return started_by("bash", "-c", f'{line} && exec "$@"', "sh", **values)


def files(name: str, text: str, more: str = "", **values: str) -> Condition:
    """Return the condition that there is a file."""
    return Condition(tuple(values.items()), (), with_files({name: text}), more)


def at_start(code: str, more: str = "") -> Condition:
    """Return the condition that Python runs code when it starts, as a script may."""
    return files("site/sitecustomize.py", code, more)


CONDITIONS: dict[str, Condition] = {
    "another user": Condition((("HOME", "/nonexistent"),), is_ordinary=True),
    "no home": variable(HOME=""),
    "ASCII": variable(PYTHONIOENCODING="ascii"),
    "C locale": variable(LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0"),
    "Latin-1": variable(PYTHONIOENCODING="latin-1"),
    "20 columns": variable(COLUMNS="20"),
    "dumb terminal": started_by(sys.executable, "-c", TERMINAL, TERM="dumb", COLUMNS="20"),
    "terminal": started_by(sys.executable, "-c", TERMINAL, TERM="xterm"),
    "no output": shell("exec >&-"),
    "no input": shell("exec <&-"),
    "no kernels": variable(NUMBA_DISABLE_JIT="1"),
    "errors of NumPy": at_start("import numpy\nnumpy.seterr(all='raise')\n"),
    "rc of the folder": files("matplotlibrc", RC),
    "rc of the home": files(".config/matplotlib/matplotlibrc", RC, HOME="H/"),
    "another backend": variable(MPLBACKEND="module://nowhere"),
    "ffmpeg that fails": files(
        "bin/ffmpeg", "#!/bin/sh\nexit 3\n", "animate r", PATH=f"H/bin:{os.environ['PATH']}"
    ),
    "spawn": at_start(
        "import multiprocessing\nmultiprocessing.set_start_method('spawn')\n",
        "run crossing --out p --processes",
    ),
    "dynamics.py": files("dynamics.py", "x = 1\n"),
    "problems": files("problems/__init__.py", "x = 1\n"),
    "2 GB": shell("ulimit -v 2000000"),
    "32 files": shell("ulimit -n 32"),
    "files of 20 kB": shell("ulimit -f 40"),
    "8 processes": shell("ulimit -u 8")._replace(is_ordinary=True),
    "full temporary folder": started_by(
        *OWN_MOUNTS,
        'mount -t tmpfs -o size=8k none $TMPDIR; yes > $TMPDIR/full 2>/dev/null; exec "$@"',
        "sh",
        TMPDIR="H/tmp",
    ),
    "read-only temporary folder": started_by(
        *OWN_MOUNTS, 'mount -t tmpfs -o ro none $TMPDIR && exec "$@"', "sh", TMPDIR="H/tmp"
    ),
    "clock that jumps": at_start(JUMPING),
    "path with spaces": Condition((("PYTHONPATH", "H/site:H/ça là, 目录"),), (), install_elsewhere),
}


def try_conditions(names: tuple[str, ...], home: Path) -> dict[str, str]:
    """Run each command under some conditions; return how it ended."""
    chosen: list[Condition] = [CONDITIONS[name] for name in names]
    home.mkdir()
    for name in ("site", "tmp"):
        (home / name).mkdir()
    variables = os.environ | {"PYTHONPATH": f"{home}/site:{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
    variables |= {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS")}
    commands = dict(COMMANDS)
    for each in chosen:
        each.set_up(home)
        variables |= {key: text.replace("H/", f"{home}/") for key, text in each.variables}
        commands |= {each.more.split()[0] + " too": each.more} if each.more else {}
    for path in (home, *home.rglob("*")):
        path.chmod(path.stat().st_mode | (0o777 if path.is_dir() else 0o444))
    prefix = tuple(word for each in chosen for word in each.prefix)
    prefix += NOBODY if any(each.is_ordinary for each in chosen) else ()
    return {name: _end(home, prefix, words, variables) for name, words in commands.items()}


def _end(home: Path, prefix: tuple[str, ...], words: str, variables: dict[str, str]) -> str:
    started = [*prefix, sys.executable, "-m", "sato", *words.split()]
    try:
        done = subprocess.run(
            started, cwd=home, env=variables, capture_output=True, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return "FAULT: hangs"
    said = (done.stdout + done.stderr).decode(errors="replace")
    last = (done.stderr.decode(errors="replace").strip() or said.strip()).splitlines()[-1:]
    if any(word in said for word in CRASHES) or done.returncode < 0:
        return f"FAULT: {done.returncode}: {said[-1500:]}"
    if done.returncode and not any(line.startswith(SENTENCES) for line in last):
        return f"FAULT: {done.returncode}, without a sentence: {said[-1500:]}"
    return f"{last[0]}" if done.returncode else "works"


def results(home: Path) -> dict[str, object]:
    """Return the digest of the run of a folder, and its figures."""
    folder = home / "r"
    found: dict[str, object] = {path.name: path.read_bytes() for path in folder.glob("*.png")}
    if (folder / "run.nc").exists():
        found["run"] = read_run_file(folder / "run.nc").attrs["digest"]
    return found


def main() -> int:
    """Try all conditions alone, and some pairs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("conditions", nargs="*", metavar="CONDITION", help="alone; all, and pairs")
    parser.add_argument("--pairs", type=int, default=PAIRS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only-pairs", action="store_true")
    given = parser.parse_args()
    place = Path(tempfile.mkdtemp(prefix="environments-"))
    place.chmod(0o755)
    chosen: list[tuple[str, ...]] = [(name,) for name in given.conditions or CONDITIONS]
    rng, both = np.random.default_rng(given.seed), list(combinations(CONDITIONS, 2))
    pairs = [both[k] for k in rng.choice(len(both), given.pairs, replace=False)]
    chosen = pairs if given.only_pairs else chosen if given.conditions else chosen + pairs
    try_conditions((), place / "plain")
    expected, faults = results(place / "plain"), 0
    for number, names in enumerate(chosen):
        began, home = perf_counter(), place / str(number)
        ended = try_conditions(names, home)
        works = [name for name, text in ended.items() if text == "works"]
        differing = [key for key, value in results(home).items() if value != expected.get(key)]
        wrong = [text for text in ended.values() if text.startswith("FAULT")]
        wrong += [f"FAULT: {key} differs" for key in differing]
        if set(COMMANDS) <= set(works) and set(results(home)) != set(expected):
            wrong.append("FAULT: something was not written")
        faults += len(wrong)
        print(
            f"{' + '.join(names)}: {', '.join(works) or 'none'} in {perf_counter() - began:.0f} s"
        )
        refused = {text for text in ended.values() if text != "works"}
        print(*(f"    {text}" for text in [*sorted(refused | set(wrong))]), sep="\n", flush=True)
        shutil.rmtree(home)
    print(f"{faults} faults in {len(chosen)} environments")
    shutil.rmtree(place)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
