"""Sizes and tolerances of a comparison, and guarantees that it must keep."""

from collections.abc import Iterable

from problems.conic import TOLERANCE
from problems.families import SIZES
from sato.compare.measure import Measurement
from sato.compare.plan import DEFAULT_SOLVER, format_tolerance
from sato.compare.worker import SolveOutcome


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
