"""The solver in C, written by CVXPYgen, with QOCO inside [Schaller2022, Chari2025]."""

import re
import shutil
import warnings
from contextlib import redirect_stdout
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem

COPIED_PATHS = ("include", "src/cpg_solve.c", "src/cpg_workspace.c")
# Of QOCO and what it rests on: no build files, and no clocks of other systems.
IGNORED_PATTERNS = (
    "CMakeLists.txt",
    "*.in",
    "*.md",
    ".*",
    "configure",
    "timer_macos.c",
    "timer_windows.c",
)
SETUP_CALL = re.compile(
    r"qoco_setup\(qoco_solver, (\d+), (\d+), (\d+), P, Canon_Params\.c, A, Canon_Params\.b, "
    r"G, Canon_Params\.h, (\d+), (\d+),"
)


class ProgramSizes(NamedTuple):
    """Of the programme that the solver solves: Gx + s = h with s in the cones, Ax = b."""

    variables: int
    inequalities: int
    equations: int
    linear: int  # inequalities that come first; the others are cones
    cones: int


def require_cvxpygen() -> None:
    """Refuse to begin where the generator is missing.

    Raises:
        ValueError: It is not installed.
    """
    if find_spec("cvxpygen") is None:
        raise ValueError(
            "CVXPYgen, which writes the solver in C, is not installed; pip install "
            "'cvxpygen>=1.0.2,<1.1' would do"
        )


def generate_solver(programme: FixedSizeAvoidanceProblem, folder: Path) -> ProgramSizes:
    """Write the solver into a folder that is not there yet.

    Raises:
        RuntimeError: What the generator wrote is not of the form that is built upon.
    """
    from cvxpygen import cpg

    whole = folder.with_name(folder.name + "-whole")
    with warnings.catch_warnings(), redirect_stdout(StringIO()):
        warnings.simplefilter("ignore")  # of its own dependencies, and of no use here
        cpg.generate_code(programme.to_cvxpy(), code_dir=str(whole), solver="QOCO", wrapper=False)
    made = whole / "c"
    folder.mkdir()
    for part in COPIED_PATHS:
        there = folder / part
        there.parent.mkdir(exist_ok=True)
        (shutil.copytree if (made / part).is_dir() else shutil.copyfile)(made / part, there)
    solver = made / "solver_code"
    shutil.copytree(
        solver, folder / "solver_code", ignore=shutil.ignore_patterns(*IGNORED_PATTERNS)
    )
    shutil.rmtree(whole)
    found = SETUP_CALL.search((folder / "src" / "cpg_solve.c").read_text(encoding="utf-8"))
    if found is None:
        raise RuntimeError("CVXPYgen writes another C than that which this is made for: 1.0")
    return ProgramSizes(*map(int, found.groups()))
