"""Transfers of least energy against references, and solvers of their programs side by side.

    python scripts/study_energy.py --cases 500

Random transfers of 20 to 60 steps, in the plane, in space and about a circular orbit, half of them
among half-spaces that their optimum without these violates. The reference states the problem in
CVXPY, with the states kept, and is solved by Clarabel and HiGHS at 1e-9. The condensed programs are
then given to every solver that takes them, and again with 10 nearby goals, a session a program.
"""

from collections import defaultdict
from dataclasses import replace
from statistics import median
from time import perf_counter
from typing import Annotated, NamedTuple

import numpy as np
import typer
from problem_families import record_problems
from rich.console import Console
from rich.progress import Progress, track
from rich.table import Table
from threadpoolctl import threadpool_limits

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems.avoidance import AvoidanceProblem, HalfSpaces, cost_unit
from problems.conic import ConicProgram, verify
from problems.solvers import SolverAdapter, load_adapters
from problems.transfer import TransferProblem

REFERENCE_TOLERANCE = 1e-9
TOLERANCE = 1e-6  # asked of the solvers side by side, and of their answers
AGREEMENT = 1e-6  # of energies, relative
NEARBY_GOALS = 10
PATIENCE = 1.0  # a solver that takes longer gets no further program [s]


class Answer(NamedTuple):
    """Energy of a problem by the toolkit and by two references [m²/s³]."""

    own: float
    clarabel: float
    highs: float  # NaN where HiGHS fails verification
    program: ConicProgram | None  # without the states; None where no limit is active


class Solved(NamedTuple):
    """Outcome of a solver on one program."""

    error: float  # of the energy, relative; NaN where the answer is refused
    first: float  # with its set-up [s]
    nearby: float  # median of other goals [s]
    nearby_share: float  # of these that are accepted


def draw_problem(rng: np.random.Generator, has_half_spaces: bool) -> AvoidanceProblem:
    """Draw a transfer that controls below the limit fly."""
    T, d = int(rng.integers(20, 61)), int(rng.integers(2, 4))
    model: DiscreteModel = discretize_zoh(DoubleIntegrator(d), 1.0, T)
    U = 0.1
    if rng.random() < 1 / 3:
        model, U, d = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, T), 1e-3, 3
    transfer = TransferProblem(model, U, objective="energy")
    start = np.concatenate([rng.normal(0, 5, d), rng.normal(0, 0.1, d)])
    push = rng.choice([-1.0, 1.0], d) * U * rng.uniform(0.3, 0.95)
    u = np.where(np.arange(T)[:, None] < T / 2, push, -push) + rng.normal(0, U / 50, (T, d))
    flown = transfer.simulate(start, np.clip(u, -U, U))
    goal = flown.x[-1]
    rows = int(rng.integers(1, 9)) if has_half_spaces else 0
    step, on_state = rng.integers(1, T, rows), np.zeros((rows, 2 * d))
    on_state[:, :d] = rng.normal(size=(rows, d))
    # Half of the way from what is cheapest to what is flown stays open.
    (free,), _, _ = transfer.solve_without_limits(start, goal[None])
    values = [(on_state * x[step]).sum(axis=1) for x in (free, flown.x)]
    on_state *= np.sign(values[1] - values[0])[:, None]
    rhs = (on_state * (free + flown.x)[step] / 2).sum(axis=1)
    spaces = HalfSpaces(step, on_state, np.zeros((rows, d)), rhs)
    return AvoidanceProblem(transfer, start, goal, spaces)


def answer(problem: AvoidanceProblem) -> Answer:
    """Solve a problem by the toolkit's own path, and its statement in CVXPY by two solvers."""
    with record_problems() as asked:
        own = problem.transfer.cost(problem.solve().trajectory)
    with record_problems() as stated:
        problem.solve_cvxpy()
    references = []
    for name in ("clarabel", "highs"):
        session = load_adapters()[name].open_session(stated[0], REFERENCE_TOLERANCE)
        verdict = verify(stated[0], session.solve(stated[0].b), 10 * REFERENCE_TOLERANCE)
        found = verdict.solution if verdict.kind == "solved" else None
        references.append(np.nan if found is None else stated[0].cost(found.x))
    clarabel, highs = np.array(references) * cost_unit([problem])
    return Answer(own, clarabel, highs, asked[-1] if asked else None)


def measure(adapter: SolverAdapter, program: ConicProgram, rng: np.random.Generator) -> Solved:
    """Solve a program at `TOLERANCE`, then with other goals near its own."""
    exact = load_adapters()["clarabel"].open_session(program, REFERENCE_TOLERANCE)
    reference = verify(program, exact.solve(program.b), TOLERANCE).solution
    if reference is None:
        raise ValueError("the reference is not solved")
    began = perf_counter()
    session = adapter.open_session(program, TOLERANCE)
    result = session.solve(program.b)
    first = perf_counter() - began
    verdict = verify(program, result, TOLERANCE)
    error = np.nan
    if verdict.kind == "solved" and verdict.solution is not None:
        error = abs(program.cost(verdict.solution.x) / program.cost(reference.x) - 1)
    times, accepted = [], 0
    for _ in range(NEARBY_GOALS if first < PATIENCE else 0):
        b = program.b.copy()
        b[: program.zero] *= 1 + rng.normal(0, 1e-3, program.zero)
        began = perf_counter()
        result = session.solve(b)
        times.append(perf_counter() - began)
        accepted += verify(replace(program, b=b), result, TOLERANCE).kind == "solved"
    return Solved(error, first, median(times or [np.nan]), accepted / max(len(times), 1))


def print_solvers(programs: list[ConicProgram], rng: np.random.Generator) -> None:
    """Measure all solvers on some programs, in turn."""
    found: dict[str, list[Solved]] = defaultdict(list)
    with Progress() as progress:
        for program in progress.track(programs):
            for name, adapter in load_adapters().items():
                slow = any(one.first > PATIENCE for one in found.get(name, ()))
                if not slow and not adapter.refusal(program):
                    found[name].append(measure(adapter, program, rng))
    table = Table("solver", "accepted", "worst error", "first [ms]", "nearby [ms]", "accepted")
    for name, results in sorted(found.items(), key=lambda item: median(s.first for s in item[1])):
        errors = np.array([one.error for one in results])
        times = (1e3 * float(np.nanmedian([one[k] for one in results])) for k in (1, 2))
        share = np.mean([one.nearby_share for one in results])
        table.add_row(
            name,
            f"{np.isfinite(errors).sum()} of {len(errors)}",
            f"{np.nanmax(errors, initial=0.0):.0e}",
            *(f"{time:.2g}" for time in times),
            f"{100 * share:.0f} %",
        )
    Console().print(table)


def main(
    cases: Annotated[int, typer.Option(help="random problems")] = 500,
    programs: Annotated[int, typer.Option(help="of these that all solvers are given")] = 40,
    seed: Annotated[int, typer.Option(help="random seed")] = 0,
) -> None:
    """Compare energies with references, then solvers with each other."""
    rng = np.random.default_rng(seed)
    found = [answer(draw_problem(rng, has_half_spaces=k % 2 == 1)) for k in track(range(cases))]
    own, clarabel, highs = np.array([one[:3] for one in found]).T
    worst = float(np.abs(own / clarabel - 1).max(initial=0.0))
    asked = [one.program for one in found if one.program is not None]
    print(f"{cases} problems, {len(asked)} with an active limit")
    print(f"energy against Clarabel at 1e-9: {worst:.1e} relative at most, to reach 1e-6")
    known = np.isfinite(highs)
    other = float(np.abs(own / highs - 1)[known].max(initial=0.0))
    print(f"energy against HiGHS at 1e-9, {known.sum()} verified: {other:.1e} relative at most")
    if not worst <= AGREEMENT or not other <= AGREEMENT:
        raise typer.Exit(1)
    print_solvers(asked[:programs], rng)


if __name__ == "__main__":
    with threadpool_limits(1):
        typer.run(main)
