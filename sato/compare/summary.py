"""Summary of a solver's measurements, and guarantees that a comparison must keep."""

from collections import Counter
from collections.abc import Iterable, Sequence
from statistics import median
from typing import NamedTuple

from problems.conic import TOLERANCE
from problems.families import SIZES
from sato.compare.measure import Measurement
from sato.compare.plan import DEFAULT_SOLVER, format_tolerance
from sato.compare.worker import SolveOutcome


class SolverSummary(NamedTuple):
    """Results of a solver; times, iterations and accuracy are those at one tolerance."""

    solver: str
    correct: tuple[str, ...]  # "7/8" at each tolerance, the loosest first, over all sizes
    verdicts: Counter[str]  # number of solves with each verdict, over all tolerances
    first: tuple[float | None, ...]  # median over correct measurements of each size [s]
    second: tuple[float | None, ...]
    iterations: tuple[float | None, ...]
    cost_error: float | None  # largest relative error of the cost of correct solutions
    memory: float | None  # at the largest size [MiB]


def summarize(measurements: Sequence[Measurement], tolerance: float) -> list[SolverSummary]:
    """Summarize each solver, in the order in which they were measured.

    Args:
        measurements: All measurements, or those of one family.
        tolerance: Tolerance at which times, iterations and accuracy are taken.
    """
    return [
        _summarize_solver(solver, [m for m in measurements if m.solver == solver], tolerance)
        for solver in dict.fromkeys(m.solver for m in measurements)
    ]


def reference_tolerance(tolerances: Iterable[float]) -> float:
    """Return the tolerance for which tables show times: the toolkit's own, or the next above."""
    tolerances = list(tolerances)
    return min((t for t in tolerances if t >= TOLERANCE), default=max(tolerances))


def sizes_present(measurements: Iterable[Measurement]) -> list[str]:
    """Return the sizes that were measured, the smallest first."""
    present = {m.size for m in measurements}
    return [size for size in SIZES if size in present]


def tolerances_present(measurements: Iterable[Measurement]) -> list[float]:
    """Return the tolerances that were measured, the loosest first."""
    return sorted({m.tolerance for m in measurements}, reverse=True)


def find_violations(measurements: Iterable[Measurement]) -> list[str]:
    """List violations of what the toolkit guarantees of every comparison.

    Its default solver is correct on every instance at 1e-6 and looser; no accepted answer
    violates the requested tolerance, nor in its cost what duality allows; and no answer is
    accepted that contradicts what is known of an instance.
    """
    violations = []
    for m in measurements:
        where = f"{m.instance.name} at {format_tolerance(m.tolerance)}"
        if m.solver == DEFAULT_SOLVER and m.tolerance >= TOLERANCE and not m.is_correct:
            bad = next(outcome for outcome in m.outcomes if outcome.verdict != m.expected)
            violations.append(f"{m.solver} on {where}: {bad.verdict}, {bad.reason}")
        violations += [
            f"{m.solver} on {where}: accepted, but {reason}"
            for outcome in m.outcomes
            if outcome.verdict in ("solved", "infeasible") and (reason := _violation(m, outcome))
        ]
    return violations


def _violation(m: Measurement, outcome: SolveOutcome) -> str:
    if outcome.verdict != m.expected:
        return f"it is known to be {m.expected}"
    if outcome.verdict == "infeasible":
        return ""
    residuals = outcome.primal_residual, outcome.dual_residual, outcome.gap
    if not all(residual <= m.tolerance for residual in residuals):
        return f"off by {max(residuals):.1e}"
    error = outcome.cost_error * m.instance.cost_scale
    allowed = m.instance.cost_tolerance(m.tolerance)
    return "" if error <= allowed else f"its cost is off by {error:.1e}, above {allowed:.1e}"


def _summarize_solver(
    solver: str, measurements: list[Measurement], tolerance: float
) -> SolverSummary:
    sizes = sizes_present(measurements)
    correct = [m for m in measurements if m.tolerance == tolerance and m.is_correct]
    by_size = [[m for m in correct if m.size == size] for size in sizes]
    shares = []
    for each in tolerances_present(measurements):
        given = [m.is_correct for m in measurements if m.tolerance == each]
        shares.append(f"{sum(given)}/{len(given)}")
    growth = [m.memory_growth for m in measurements if m.size == sizes[-1]]
    return SolverSummary(
        solver,
        tuple(shares),
        Counter(outcome.verdict for m in measurements for outcome in m.outcomes),
        tuple(_median_of_known(m.first.seconds for m in group) for group in by_size),
        tuple(_median_of_known(m.second.seconds for m in group if m.second) for group in by_size),
        tuple(_median_of_known(m.first.iterations for m in group) for group in by_size),
        max((m.first.cost_error for m in correct if m.instance.is_feasible), default=None),
        max((mebibytes for mebibytes in growth if mebibytes == mebibytes), default=None),
    )


def _median_of_known(numbers: Iterable[float | None]) -> float | None:
    known = [number for number in numbers if number is not None]
    return median(known) if known else None
