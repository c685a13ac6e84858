"""What is gained by assembling programmes ourselves, and what an adapter costs.

Transfers and avoidance by the toolkit's own paths, against the statement in CVXPY, which is
compiled once with start, goal and half-spaces as parameters; both by Clarabel, at the same
tolerance, on one thread. Whole calls are timed, from the data to the controls. All take turns, so
that whatever else the machine does slows all of them; times are the processor's, and ratios are of
medians. An adapter's overhead is the time of its solve less that of the library's own calls, which
whoever uses the library alone would have to make: handing over the right-hand side, solving, and
reading out the point and its duals.
"""

from collections.abc import Callable
from time import perf_counter, process_time
from typing import Annotated, NamedTuple

import cvxpy as cp
import numpy as np
import typer
from draw_families import CLOSE, SPEED, Start
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems.avoidance import Avoidance, HalfSpaces, no_spaces
from problems.conic import Infeasible
from problems.convexify import half_spaces, normals
from problems.families import family
from problems.solvers import adapters
from problems.speed_cones import SpeedCones
from problems.transfer import Transfer
from sato.reconfiguration.planning import look_ahead

TOLERANCE = 1e-9  # what the toolkit asks of Clarabel
EQUAL = 1e-7  # optima, relative
OVERHEAD = 2e-4  # of an adapter, at most [s]
ENOUGH = 2.0  # of a slow solver, whose overhead then shows [s]
ASKED = {"linear": "transfer-lp", "second-order": "transfer-socp", "semidefinite": "gain-sdp"}


class Question(NamedTuple):
    """One flight that is asked for."""

    start: np.ndarray
    goal: np.ndarray
    spaces: HalfSpaces


class Case(NamedTuple):
    """One row of the table."""

    name: str
    transfer: Transfer
    ours: Callable[[Question], np.ndarray]  # the controls
    questions: list[Question]
    ratio: float  # to reach


class Statement:
    """A transfer among half-spaces, compiled once."""

    def __init__(self, transfer: Transfer, step: np.ndarray) -> None:
        """State it, for half-spaces at these steps."""
        n, m = transfer.steps.B.shape[1:]
        rows = len(step)
        self.start, self.goal = cp.Parameter(n), cp.Parameter(n)
        x, self.u, effort, limits = transfer.statement(self.start)
        limits = [*limits, x[len(transfer.steps)] == self.goal]
        self.spaces: tuple[cp.Parameter, ...] = ()
        if rows:
            self.spaces = cp.Parameter((rows, n)), cp.Parameter((rows, m)), cp.Parameter(rows)
            on_state, on_control, least = self.spaces
            kept = cp.sum(cp.multiply(on_state, x[step]), axis=1)
            kept += cp.sum(cp.multiply(on_control, self.u[step]), axis=1)
            limits.append(kept >= least)
        self.problem = cp.Problem(cp.Minimize(effort), limits)

    def __call__(self, question: Question) -> np.ndarray:
        """The controls."""
        self.start.value, self.goal.value = question.start, question.goal
        for parameter, value in zip(self.spaces, question.spaces[1:], strict=False):
            parameter.value = value
        within = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
        self.problem.solve(solver=cp.CLARABEL, max_threads=1, **within)
        return np.asarray(self.u.value)


def alone(count: int) -> Case:
    """Without a speed limit."""
    start = Start.of("random", "leg.steps=50").farthest(count)
    transfer = start.transfer()
    programme, none = Avoidance(transfer), no_spaces(transfer)
    questions = [Question(*ends, none) for ends in zip(start.states, start.goals, strict=True)]
    return Case(
        "transfer, 2-D, 50 steps",
        transfer,
        lambda q: programme.solve(q.start, q.goal, q.spaces).flight.u,
        questions,
        0.7,
    )


def limited(count: int) -> Case:
    """With a speed limit that would be broken without it."""
    start = Start.of("random_cw", "agents=48", "leg.steps=48", "plan.step_min=0.5")
    transfer, free = start.transfer(SPEED), start.transfer()
    programme, none = SpeedCones(transfer), no_spaces(transfer)
    questions = []
    for ends in zip(start.states, start.goals, strict=True):
        x = Avoidance(free).solve(*ends, none).flight.x
        if np.linalg.norm(x[1:-1, 3:], axis=1).max() > SPEED and feasible(programme, *ends):
            questions.append(Question(*ends, none))
    return Case(
        "transfer, orbit, 48 steps, speed limit",
        transfer,
        lambda q: programme.solve(q.start, q.goal).u,
        questions[:count],
        0.7,
    )


def feasible(programme: SpeedCones, start: np.ndarray, goal: np.ndarray) -> bool:
    """Whether the limit leaves a way."""
    try:
        programme.solve(start, goal)
    except Infeasible:
        return False
    return True


def crowded(neighbours: int, count: int) -> Case:
    """Past neighbours who are in the way."""
    questions: list[Question] = []
    seed = 0
    while len(questions) < count:
        seed += 1
        start = Start.of("random", "leg.steps=40", *CLOSE, seed=seed)
        transfer = start.transfer(start.mission.max_speed)
        programme, horizon = Avoidance(transfer), look_ahead(start.mission, 0.0, 40)
        ends = list(zip(start.states, start.goals, strict=True))
        free = [programme.solve(*pair, no_spaces(transfer)).flight for pair in ends]
        paths = np.stack([horizon.path(flight.x, flight.u) for flight in free])
        for i, flight in enumerate(free):
            away = np.linalg.norm(start.states - start.states[i], axis=1)
            others = paths[np.argsort(away, kind="stable")[1 : neighbours + 1]]
            normal = normals(paths[i] - others, horizon.keep)
            spaces = half_spaces(horizon, len(flight.u), others, normal)
            if spaces.missing(flight.x, flight.u).max() > 0 and passable(
                programme, ends[i], spaces
            ):
                questions.append(Question(*ends[i], spaces))
    return Case(
        f"avoidance, 2-D, 40 steps, {neighbours} neighbours",
        transfer,
        lambda q: programme.solve(q.start, q.goal, q.spaces).flight.u,
        questions[:count],
        0.9,
    )


def passable(programme: Avoidance, ends: tuple[np.ndarray, np.ndarray], spaces: HalfSpaces) -> bool:
    """Whether the half-spaces leave a way."""
    try:
        programme.solve(*ends, spaces)
    except Infeasible:
        return False
    return True


def cost(transfer: Transfer, u: np.ndarray) -> float:
    """What both minimise."""
    return float(transfer.steps.dt * transfer.weight @ np.abs(u).sum(axis=1))


def tell_case(table: Table, case: Case, turns: int) -> bool:
    """Time a case and add it to the table; whether it misses a target."""
    stated = Statement(case.transfer, case.questions[0].spaces.step)
    ways = (case.ours, stated)
    for way in ways:  # what is done once is not what is timed
        way(case.questions[0])
    times: list[list[float]] = [[], []]
    apart = 0.0
    for turn in range(turns):
        for question in case.questions:
            values = [0.0, 0.0]
            for k in (0, 1) if turn % 2 else (1, 0):
                began = process_time()
                u = ways[k](question)
                times[k].append(process_time() - began)
                values[k] = cost(case.transfer, u)
            apart = max(apart, abs(values[0] - values[1]) / values[1])
    ours, theirs = (1e3 * float(np.median(taken)) for taken in times)
    missed = ours / theirs > case.ratio or apart > EQUAL
    table.add_row(
        case.name,
        str(len(case.questions)),
        str(len(case.questions[0].spaces.least)),
        f"{ours:.2f}",
        f"{theirs:.2f}",
        f"{ours / theirs:.2f} ({case.ratio})",
        f"{apart:.0e} ({EQUAL:.0e})",
        style="red" if missed else None,
    )
    return missed


def overheads(turns: int) -> dict[tuple[str, str], tuple[float, float]]:
    """Median time of a solve, and of that what the adapter takes [s]; of each solver and family."""
    installed = [solver for solver in adapters().values() if solver.installed]
    found = {}
    for name in ASKED.values():
        instances = family(name, "medium").instances
        first = instances[0].problem
        bs = [each.problem.b for each in instances if each.problem.A is first.A]
        sessions = {s.name: s.read(first, 1e-6) for s in installed if s.takes(first)}
        taken: dict[str, list[tuple[float, float]]] = {solver: [] for solver in sessions}
        for turn in range(turns + 1):
            for solver, session in sessions.items():
                if sum(seconds for seconds, _ in taken[solver]) > ENOUGH:
                    continue
                began = perf_counter()
                claim = session.solve(bs[turn % len(bs)].copy())
                seconds = perf_counter() - began
                if turn:  # what a library does once is not what is timed
                    taken[solver].append((seconds, seconds - claim.seconds))
        for solver, some in taken.items():
            whole, over = np.median(np.array(some), axis=0)
            found[solver, name] = float(whole), float(over)
    return found


def main(
    instances: Annotated[int, typer.Option(help="flights of each case")] = 10,
    turns: Annotated[
        int, typer.Option(help="of each flight; adapters take five times as many")
    ] = 9,
) -> None:
    """Compare; exit 1 where a target is missed."""
    paths = Table("path", "flights", "half-spaces", "ours, ms", "CVXPY, ms", "ratio ≤", "cost ≤")
    adapted = Table("solver", "family", "a solve, ms", f"adapter, ms ≤ {1e3 * OVERHEAD:g}")
    with threadpool_limits(1):
        cases = [alone(instances), limited(instances), crowded(5, instances)]
        cases.append(crowded(20, instances))
        missed = [tell_case(paths, case, turns) for case in cases]
        for (solver, name), (whole, over) in sorted(overheads(5 * turns).items()):
            missed.append(over > OVERHEAD)
            row = solver, name, f"{1e3 * whole:.2f}", f"{1e3 * over:.3f}"
            adapted.add_row(*row, style="red" if missed[-1] else None)
    console = Console(width=120)
    console.print(paths)
    console.print(adapted)
    raise typer.Exit(int(any(missed)))


if __name__ == "__main__":
    typer.run(main)
