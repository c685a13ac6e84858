"""Every program of a run, given to each solver that takes its cones, and runs flown with each.

    python scripts/study_solvers.py --scenario crossing --scenario orbit --scenario random

The programs are those that the default solver answers in the first runs of some scenarios, for the
least fuel and the least energy, with speeds limited axis by axis so that their cones are linear,
and with the Euclidean limit of the scenario. Each solver is asked by the loop's own code: at 1e-8,
verified at 1e-6, infeasible programs with a certificate; a new session a program.
"""

from collections import defaultdict
from time import process_time
from typing import Annotated, NamedTuple

import numpy as np
import typer
from problem_families import record_problems
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

import sato
from problems.conic import TOLERANCE, ConicProgram, Infeasible
from problems.solvers import SolverAdapter, load_adapters
from problems.solvers.verified import VerifiedSolver, solve_program

PATIENCE = 0.5  # a solver that takes longer gets no further program of that kind [s]
AGREEMENT = 1e-5  # of the objective, relative
UNDETECTABLE = "plan.allow_undetectable=true"  # a box of speeds has corners beyond the limit


class Answer(NamedTuple):
    """Outcome of a solver on one program."""

    is_accepted: bool
    error: float  # of the objective, relative; NaN where it is not accepted, or infeasible
    seconds: float  # with the set-up


def record_run(scenario: str, overrides: list[str]) -> list[ConicProgram]:
    """Fly a mission with the default solver, and return the programs that it solved."""
    with record_problems() as asked:
        sato.run(scenario, overrides=overrides)
    return asked


def ask(adapter: SolverAdapter, program: ConicProgram, reference: float) -> Answer:
    """Give a program to a solver."""
    began = process_time()
    verdict = VerifiedSolver(adapter.name).answer(program)
    seconds = process_time() - began
    if verdict.kind == "infeasible":
        return Answer(bool(np.isnan(reference)), np.nan, seconds)
    if verdict.solution is None or verdict.kind != "solved":
        return Answer(False, np.nan, seconds)
    cost = program.cost(verdict.solution.x)
    return Answer(True, abs(cost - reference) / max(abs(reference), TOLERANCE), seconds)


def reference_cost(program: ConicProgram) -> float:
    """Return the optimum by the default solver; NaN where the program is infeasible."""
    try:
        return program.cost(solve_program(program).x)
    except Infeasible:
        return np.nan


def print_answers(
    title: str, programs: list[ConicProgram], solvers: list[str]
) -> dict[str, list[Answer]]:
    """Ask solvers, in turn, print a row for each, and return their answers."""
    found: dict[str, list[Answer]] = defaultdict(list)
    references = [reference_cost(program) for program in programs]
    for program, reference in track(list(zip(programs, references, strict=True))):
        for name in solvers:
            adapter = load_adapters()[name]
            slow = any(one.seconds > PATIENCE for one in found.get(name, ())[1:])
            if not slow and not adapter.refusal(program):
                found[name].append(ask(adapter, program, reference))
    infeasible = int(np.isnan(references).sum())
    table = Table("solver", "accepted", "within 1e-5", "worst error", "median [ms]", title=title)
    for name, answers in found.items():
        errors = np.array([one.error for one in answers if np.isfinite(one.error)])
        accepted = sum(one.is_accepted for one in answers)
        table.add_row(
            name,
            f"{accepted} of {len(answers)}",
            f"{(errors <= AGREEMENT).sum()} of {len(errors)}",
            f"{errors.max(initial=0.0):.0e}",
            f"{1e3 * np.median([one.seconds for one in answers]):.2g}",
        )
    Console(width=100).print(table, f"{len(programs)} programs, {infeasible} of them infeasible")
    return found


def print_flights(scenario: str, overrides: list[str], solvers: list[str]) -> None:
    """Fly a mission with each solver, beside the default."""
    for name in solvers:
        summary = sato.run(scenario, overrides=[*overrides, f"plan.solver={name}"]).summary
        energy = summary.get("energy_m2_s3", np.nan)
        print(
            f"  {name}: reached {summary['reached']}, {summary['fuel_m_s']:.6g} m/s, "
            f"{energy:.6g} m²/s³, {summary.get('solver_fallbacks', 0)} rejected of "
            f"{summary['solves']}, {summary['wall_s']:.1f} s"
        )


def main(
    scenario: Annotated[list[str], typer.Option(help="name")] = ["crossing", "random"],  # noqa: B006
    most: Annotated[int, typer.Option(help="programs of a kind, evenly chosen")] = 200,
    solver: Annotated[list[str] | None, typer.Option(help="name; all")] = None,
    flights: Annotated[list[str] | None, typer.Option(help="solvers to fly with")] = None,
    override: Annotated[list[str] | None, typer.Option(help="TABLE.KEY=VALUE")] = None,
) -> None:
    """Record the programs of some runs, and compare solvers on them."""
    total: dict[str, list[Answer]] = defaultdict(list)
    for name in scenario:
        for objective in ("fuel", "energy"):
            for norm in ('"inf"', "2"):
                chosen = [*(override or ()), f"plan.objective={objective}", UNDETECTABLE]
                chosen.append(f"model.speed_norm={norm}")
                programs = record_run(name, chosen)
                if not programs:
                    print(f"{name}, least {objective}, speed norm {norm}: no programs")
                    continue
                step = max(1, -(-len(programs) // most))
                title = f"{name}, least {objective}, speed norm {norm}"
                found = print_answers(title, programs[::step], solver or list(load_adapters()))
                for each, answers in found.items():
                    total[each] += answers
                print_flights(name, chosen, flights or [])
    for each, answers in total.items():
        accepted = sum(one.is_accepted for one in answers)
        print(f"{each}: {accepted} of {len(answers)} accepted, {accepted / len(answers):.1%}")


if __name__ == "__main__":
    with threadpool_limits(1):
        typer.run(main)
