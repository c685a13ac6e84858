"""A folder of C that solves one agent's programme, whole or not at all."""

import os
import shutil
import tempfile
from importlib.metadata import version
from importlib.resources import as_file, files
from pathlib import Path

from sato.onboard.codegen import generate_solver, require_cvxpygen
from sato.onboard.headers import format_data_header, format_model_header
from sato.onboard.problem import OnboardProblem, build_onboard_problem


def export_c(
    scenario: str, out: str | Path, neighbors: int = 5, steps: int | None = None
) -> OnboardProblem:
    """Write C that solves the programme of one agent of a scenario.

    Args:
        scenario: Built in, or a file.
        out: A folder that is not there yet, or empty.
        neighbours: For how many there is room in the programme.
        steps: That the flight has left; those of the first leg if None.

    Returns:
        What was written.

    Raises:
        ValueError: The scenario has no such programme, the folder is not free, or the
            generator is not installed.
        OSError: The folder cannot be written.
    """
    out = Path(out)
    require_cvxpygen()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"{out}: is there already; --out takes a folder that is new, or empty")
    what = build_onboard_problem(scenario, neighbors, steps)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".exporting-", dir=out.parent) as workshop:
        made = Path(workshop, "made")
        _write_sources(what, made)
        os.replace(made, out)
    return what


def describe(what: OnboardProblem) -> str:
    """What the code can do, in a sentence."""
    programme, limit = what.program, "no speed limit"
    if programme.has_speed_limit:
        limit = f"the speed limit of {programme.transfer.max_speed:g} m/s"
    return (
        f"{what.scenario}: flights of {len(programme.transfer.model)} steps with {limit}, and "
        f"{programme.rows_per_step} half-spaces in each of the first {programme.horizon_steps}, which is room "
        f"for {what.neighbors} neighbours"
    )


def _write_sources(what: OnboardProblem, folder: Path) -> None:
    with as_file(files("sato.onboard") / "c") as ours:
        shutil.copytree(ours, folder)
    sizes = generate_solver(what.program, folder / "generated")
    for name, text in (
        ("sato_model.h", format_model_header(what.program, sizes)),
        ("sato_numbers.h", format_data_header(what.program)),
        ("README.md", _format_readme(what)),
    ):
        (folder / name).write_text(text, encoding="utf-8")


def _format_readme(what: OnboardProblem) -> str:
    programme = what.program
    transfer = programme.transfer
    fast = f"{transfer.max_speed:g} m/s" if programme.has_speed_limit else "none"
    return f"""# One agent's transfer, in C

Written by sato {version("sato-swarm")} with CVXPYgen {version("cvxpygen")} from the scenario
`{what.scenario}`. `make` compiles `libsato_onboard.so`; `sato_onboard.h` says what to call.

| | |
|---|---|
| steps of the flight | {len(transfer.model)} of {transfer.model.dt:g} s |
| axes | {transfer.model.axes} |
| largest control | {transfer.max_control:g} m/s² an axis |
| largest speed | {fast} |
| half-spaces | {programme.rows_per_step} in each of the first {programme.horizon_steps} steps |
| which is room for | {what.neighbors} neighbours, {what.horizon.pieces_per_step} pieces of path a step |

It needs a C99 compiler, `malloc` and, on a POSIX system, `clock_gettime`. Another number of
steps is another export. It finds no proof where there is no flight, and says only that none
was found. What is in `generated/` comes with licences of its own: CVXPYgen Apache 2.0, QOCO
BSD 3-clause, QDLDL Apache 2.0, AMD BSD 3-clause.
"""
