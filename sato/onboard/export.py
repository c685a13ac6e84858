"""Export of a folder of C that solves one agent's transfer, whole or not at all."""

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
    """Write C that solves the transfer of one agent of a scenario.

    Args:
        scenario: Name of a built-in scenario, or a file.
        out: A new folder, or an empty one.
        neighbors: Number of neighbors for which the program has room.
        steps: Number of steps of the flight; that of the first leg if None.

    Returns:
        The problem that the code solves.

    Raises:
        ValueError: The scenario has no such problem, the folder is not empty, or the generator
            is not installed.
        OSError: The folder cannot be written.
    """
    out = Path(out)
    require_cvxpygen()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"{out}: exists already; --out takes a folder that is new, or empty")
    problem = build_onboard_problem(scenario, neighbors, steps)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".exporting-", dir=out.parent) as tmp_dir:
        sources = Path(tmp_dir, "sources")
        _write_sources(problem, sources)
        os.replace(sources, out)
    return problem


def describe(problem: OnboardProblem) -> str:
    """Describe in a sentence the flights that the code can plan."""
    program, limit = problem.program, "no speed limit"
    if program.has_speed_limit:
        limit = f"the speed limit of {program.transfer.max_speed:g} m/s"
    return (
        f"{problem.scenario}: flights of {len(program.transfer.model)} steps with {limit}, and "
        f"{program.rows_per_step} half-spaces in each of the first {program.horizon_steps}, "
        f"which is room for {problem.neighbors} neighbors"
    )


def _write_sources(problem: OnboardProblem, folder: Path) -> None:
    with as_file(files("sato.onboard") / "c") as sources:
        shutil.copytree(sources, folder)
    sizes = generate_solver(problem.program, folder / "generated")
    for name, text in (
        ("sato_model.h", format_model_header(problem.program, sizes)),
        ("sato_numbers.h", format_data_header(problem.program)),
        ("README.md", _format_readme(problem)),
    ):
        (folder / name).write_text(text, encoding="utf-8")


def _format_readme(problem: OnboardProblem) -> str:
    program = problem.program
    transfer = program.transfer
    max_speed = f"{transfer.max_speed:g} m/s" if program.has_speed_limit else "none"
    return f"""# One agent's transfer, in C

Written by sato {version("sato-swarm")} with CVXPYgen {version("cvxpygen")} from the scenario
`{problem.scenario}`. `make` compiles `libsato_onboard.so`; `sato_onboard.h` declares its function.

| | |
|---|---|
| steps of the flight | {len(transfer.model)} of {transfer.model.dt:g} s |
| axes | {transfer.model.axes} |
| largest control | {transfer.max_control:g} m/s² an axis |
| largest speed | {max_speed} |
| half-spaces | {program.rows_per_step} in each of the first {program.horizon_steps} steps |
| room for | {problem.neighbors} neighbors, {problem.horizon.pieces_per_step} pieces per step |

It needs a C99 compiler, `malloc` and, on a POSIX system, `clock_gettime`. Another number of
steps needs another export. Where there is no feasible flight, the code reports that it found none,
without a proof. The code in `generated/` has licenses of its own: CVXPYgen Apache 2.0, QOCO BSD
3-clause, QDLDL Apache 2.0, AMD BSD 3-clause.
"""
