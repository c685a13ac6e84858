"""Speedup of directly assembled programs over CVXPY.

Transfers and avoidance by the toolkit's own paths, against the statement in CVXPY, which is
compiled once with start, goal and half-spaces as parameters; both by Clarabel, at the same
tolerance, on one thread. Whole calls are timed, from the data to the controls. All take turns, so
that whatever else the machine does slows all of them; times are the processor's, and ratios are of
medians.
"""

from time import process_time
from typing import Annotated, NamedTuple

import cvxpy as cp
import numpy as np
import typer
from problem_families import DENSE_OVERRIDES, SPEED_LIMIT, LegStart
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems.avoidance import AvoidanceProblem
from problems.conic import Infeasible
from problems.convexify import choose_normals, convexify
from problems.transfer import TransferProblem
from sato.reconfiguration.planning import make_horizon

TOLERANCE = 1e-9  # what the toolkit asks of Clarabel
COST_TOLERANCE = 1e-7  # optima, relative


class TransferCase(NamedTuple):
    """Row of the table."""

    name: str
    transfer: TransferProblem
    instances: list[AvoidanceProblem]
    max_time_ratio: float  # to reach


class CvxpyStatement:
    """Transfer among half-spaces in CVXPY, compiled once."""

    def __init__(self, transfer: TransferProblem, step: np.ndarray) -> None:
        """Build the problem for half-spaces at these steps."""
        n, m = transfer.model.B.shape[1:]
        rows = len(step)
        self.start, self.goal = cp.Parameter(n), cp.Parameter(n)
        x, self.u, effort, limits = transfer.build_cvxpy(self.start)
        limits = [*limits, x[len(transfer.model)] == self.goal]
        self.half_spaces: tuple[cp.Parameter, ...] = ()
        if rows:
            self.half_spaces = cp.Parameter((rows, n)), cp.Parameter((rows, m)), cp.Parameter(rows)
            on_state, on_control, least = self.half_spaces
            kept = cp.sum(cp.multiply(on_state, x[step]), axis=1)
            kept += cp.sum(cp.multiply(on_control, self.u[step]), axis=1)
            limits.append(kept >= least)
        self.problem = cp.Problem(cp.Minimize(effort), limits)

    def __call__(self, question: AvoidanceProblem) -> np.ndarray:
        """Return the optimal controls."""
        self.start.value, self.goal.value = question.start, question.goal
        for parameter, value in zip(self.half_spaces, question.half_spaces[1:], strict=False):
            parameter.value = value
        within = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), TOLERANCE)
        self.problem.solve(solver=cp.CLARABEL, max_threads=1, **within)
        return np.asarray(self.u.value)


def unconstrained_case(count: int) -> TransferCase:
    """Build the case without a speed limit."""
    start = LegStart.from_scenario("random", "leg.steps=50").farthest(count)
    transfer = start.make_transfer()
    ends = zip(start.states, start.targets, strict=True)
    questions = [AvoidanceProblem.alone(transfer, *pair) for pair in ends]
    return TransferCase(
        "transfer, 2-D, 50 steps",
        transfer,
        questions,
        0.7,
    )


def speed_limited_case(count: int) -> TransferCase:
    """Build the case with a speed limit that binds."""
    start = LegStart.from_scenario("random_cw", "agents=48", "leg.steps=48", "plan.step_min=0.5")
    transfer, free = start.make_transfer(SPEED_LIMIT), start.make_transfer()
    questions = []
    for ends in zip(start.states, start.targets, strict=True):
        x = AvoidanceProblem.alone(free, *ends).solve().trajectory.x
        limited = AvoidanceProblem.alone(transfer, *ends)
        if transfer.is_too_fast(x).any() and is_feasible(limited):
            questions.append(limited)
    return TransferCase(
        "transfer, orbit, 48 steps, speed limit",
        transfer,
        questions[:count],
        0.9,
    )


def avoidance_case(neighbors: int, count: int) -> TransferCase:
    """Build the case of avoidance among blocking neighbors."""
    questions: list[AvoidanceProblem] = []
    seed = 0
    while len(questions) < count:
        seed += 1
        start = LegStart.from_scenario("random", "leg.steps=40", *DENSE_OVERRIDES, seed=seed)
        transfer = start.make_transfer(start.mission.max_speed)
        horizon = make_horizon(start.mission, 0.0, 40)
        ends = list(zip(start.states, start.targets, strict=True))
        free = [AvoidanceProblem.alone(transfer, *pair).solve().trajectory for pair in ends]
        paths = np.stack([horizon.control_points(flight.x, flight.u) for flight in free])
        for i, flight in enumerate(free):
            away = np.linalg.norm(start.states - start.states[i], axis=1)
            others = paths[np.argsort(away, kind="stable")[1 : neighbors + 1]]
            normal = choose_normals(paths[i] - others, horizon.required_separation)
            spaces = convexify(horizon, len(flight.u), others, normal)
            question = AvoidanceProblem(transfer, *ends[i], spaces)
            if spaces.violation(flight.x, flight.u).max() > 0 and is_feasible(question):
                questions.append(question)
    return TransferCase(
        f"avoidance, 2-D, 40 steps, {neighbors} neighbors",
        transfer,
        questions[:count],
        0.9,
    )


def is_feasible(question: AvoidanceProblem) -> bool:
    """Check that the transfer is feasible within the half-spaces."""
    try:
        question.solve()
    except Infeasible:
        return False
    return True


def solve_directly(question: AvoidanceProblem) -> np.ndarray:
    """Return the optimal controls by the toolkit's own path."""
    return question.solve().trajectory.u


def weighted_fuel(transfer: TransferProblem, u: np.ndarray) -> float:
    """Return the weighted fuel, which both implementations minimize."""
    return float(transfer.model.dt * transfer.weights @ np.abs(u).sum(axis=1))


def time_case(table: Table, case: TransferCase, turns: int) -> bool:
    """Time a case and add it to the table; return True if it misses a target."""
    stated = CvxpyStatement(case.transfer, case.instances[0].half_spaces.step_index)
    ways = (solve_directly, stated)
    for way in ways:  # what is done once is not what is timed
        way(case.instances[0])
    times: list[list[float]] = [[], []]
    apart = 0.0
    for turn in range(turns):
        for question in case.instances:
            values = [0.0, 0.0]
            for k in (0, 1) if turn % 2 else (1, 0):
                began = process_time()
                u = ways[k](question)
                times[k].append(process_time() - began)
                values[k] = weighted_fuel(case.transfer, u)
            apart = max(apart, abs(values[0] - values[1]) / values[1])
    ours, theirs = (1e3 * float(np.median(taken)) for taken in times)
    missed = ours / theirs > case.max_time_ratio or apart > COST_TOLERANCE
    table.add_row(
        case.name,
        str(len(case.instances)),
        str(len(case.instances[0].half_spaces.rhs)),
        f"{ours:.2f}",
        f"{theirs:.2f}",
        f"{ours / theirs:.2f} ({case.max_time_ratio})",
        f"{apart:.0e} ({COST_TOLERANCE:.0e})",
        style="red" if missed else None,
    )
    return missed


def main(
    instances: Annotated[int, typer.Option(help="flights of each case")] = 10,
    turns: Annotated[int, typer.Option(help="of each flight")] = 9,
) -> None:
    """Compare; exit 1 where a target is missed."""
    paths = Table("path", "flights", "half-spaces", "ours, ms", "CVXPY, ms", "ratio ≤", "cost ≤")
    with threadpool_limits(1):
        cases = [
            unconstrained_case(instances),
            speed_limited_case(instances),
            avoidance_case(5, instances),
        ]
        cases.append(avoidance_case(20, instances))
        missed = [time_case(paths, case, turns) for case in cases]
    Console(width=120).print(paths)
    raise typer.Exit(int(any(missed)))


if __name__ == "__main__":
    typer.run(main)
