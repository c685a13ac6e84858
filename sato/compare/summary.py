"""A line for each solver and family, from all that was measured of it."""

from collections.abc import Iterable, Sequence
from statistics import median
from typing import NamedTuple

from problems.conic import TOLERANCE
from problems.families import SIZES
from sato.compare.measure import Measurement
from sato.compare.plan import DEFAULT_SOLVER, format_tolerance
from sato.compare.worker import SolveOutcome


class SolverSummary(NamedTuple):
    """How a solver did in a family. Times, iterations and accuracy are those at one tolerance."""

    solver: str
    correct: tuple[str, ...]  # "7/8" at each tolerance, of all instances of all sizes
    wrong_claims: int  # of all solves of all tolerances
    unproven: int
    failed: int
    crashed: int
    skipped: int
    first: tuple[float | None, ...]  # median of what it had right of each size [s]
    second: tuple[float | None, ...]
    iterations: tuple[float | None, ...]
    cost_error: float | None  # the largest relative error of the cost, of what it solved
    memory: float | None  # of the largest size [MiB]


def summarize(measurements: Sequence[Measurement], tolerance: float) -> list[SolverSummary]:
    """One line a solver, in the order in which they were asked.

    Args:
        measurements: Of one family.
        tolerance: At which times, iterations and accuracy are told.
    """
    return [
        _summarize_solver(solver, [m for m in measurements if m.solver == solver], tolerance)
        for solver in dict.fromkeys(m.solver for m in measurements)
    ]


def reference_tolerance(tolerances: Iterable[float]) -> float:
    """The tolerance whose times a table shows: that of the toolkit, or the next above it."""
    return min((t for t in tolerances if t >= TOLERANCE), default=max(tolerances))


def sizes_present(measurements: Iterable[Measurement]) -> list[str]:
    """The sizes that were asked, the smallest first."""
    there = {m.size for m in measurements}
    return [size for size in SIZES if size in there]


def find_violations(measurements: Iterable[Measurement]) -> list[str]:
    """What the toolkit promises of a comparison, where that is broken.

    Its default solver is right on every instance at 1e-6 and looser; no answer that is accepted
    violates the tolerance that was asked, also not in its cost, as far as duality allows; and
    nothing is accepted against what is known of an instance.
    """
    found = []
    for m in measurements:
        where = f"{m.instance.name} at {format_tolerance(m.tolerance)}"
        if m.solver == DEFAULT_SOLVER and m.tolerance >= TOLERANCE and not m.is_correct:
            bad = next(outcome for outcome in m.outcomes if outcome.verdict != m.expected)
            found.append(f"{m.solver} on {where}: {bad.verdict}, {bad.reason}")
        found += [
            f"{m.solver} on {where}: accepted, but {why}"
            for outcome in m.outcomes
            if outcome.verdict in ("solved", "infeasible") and (why := _violation(m, outcome))
        ]
    return found


def _violation(m: Measurement, outcome: SolveOutcome) -> str:
    if outcome.verdict != m.expected:
        return f"it is known to be {m.expected}"
    if outcome.verdict == "infeasible":
        return ""
    left = outcome.primal_residual, outcome.dual_residual, outcome.gap
    if not all(part <= m.tolerance for part in left):
        return f"off by {max(left):.1e}"
    error = outcome.cost_error * m.instance.cost_scale
    allowed = m.instance.cost_tolerance(m.tolerance)
    return "" if error <= allowed else f"its cost is off by {error:.1e}, above {allowed:.1e}"


def _summarize_solver(solver: str, some: list[Measurement], tolerance: float) -> SolverSummary:
    verdicts = [outcome.verdict for m in some for outcome in m.outcomes]
    there = [m for m in some if m.tolerance == tolerance and m.is_correct]
    by_size = [[m for m in there if m.size == size] for size in sizes_present(some)]
    right = []
    for asked in sorted({m.tolerance for m in some}, reverse=True):
        here = [m for m in some if m.tolerance == asked]
        right.append(f"{sum(m.is_correct for m in here)}/{len(here)}")
    largest = [
        m.memory_growth
        for m in some
        if m.size == sizes_present(some)[-1] and m.memory_growth == m.memory_growth
    ]
    return SolverSummary(
        solver,
        tuple(right),
        verdicts.count("wrong claim"),
        verdicts.count("unproven"),
        verdicts.count("failed"),
        verdicts.count("crashed"),
        verdicts.count("skipped"),
        tuple(_median_of_known(m.first.seconds for m in group) for group in by_size),
        tuple(_median_of_known(m.second.seconds for m in group if m.second) for group in by_size),
        tuple(_median_of_known(m.first.iterations for m in group) for group in by_size),
        max((m.first.cost_error for m in there if m.instance.is_feasible), default=None),
        max(largest, default=None),
    )


def _median_of_known(numbers: Iterable[float | None]) -> float | None:
    known = [number for number in numbers if number is not None]
    return median(known) if known else None
