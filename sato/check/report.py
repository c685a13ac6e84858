"""Report of a check: the promises of a run, each kept or broken."""

from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dynamics.doors import checked


class Promise(NamedTuple):
    """Property that a run must have, and the value that was found."""

    name: str
    kept: bool
    value: float  # worst violation, or the quantity itself
    tolerance: float  # largest value that keeps the promise
    message: str


@checked
def expect_none(name: str, violations: ArrayLike, text: str) -> Promise:
    """Promise that there are no violations, described in the plural.

    Violations are a number, or an array that is true at each.
    """
    count = int(np.sum(violations))
    return Promise(name, not count, float(count), 0.0, f"{count or 'no'} {text}")


@checked
def expect_small_error(name: str, errors: ArrayLike, tolerance: float, text: str) -> Promise:
    """Promise that the largest of all errors is within its tolerance."""
    worst = largest(errors)
    return Promise(name, bool(worst <= tolerance), worst, tolerance, f"{worst:.3g} {text}")


@checked
def expect_below(name: str, values: ArrayLike, limit: float, relative: float, text: str) -> Promise:
    """Promise that a quantity does not exceed its limit, but for a relative tolerance."""
    most = largest(values)
    text = f"{most:.6g} {text}, {limit:.6g} allowed"
    return Promise(name, bool(most <= limit * (1 + relative)), most, limit, text)


def largest(*errors: ArrayLike) -> float:
    """Return the largest size in some arrays; NaN where there is one, which breaks a promise."""
    return float(np.max([np.max(np.abs(each), initial=0.0) for each in errors]))


@checked
@dataclass(frozen=True)
class Report:
    """Promises of a run, and the summary that was recomputed with them."""

    promises: tuple[Promise, ...]
    summary: dict[str, Any]  # as in summary.json, without time and memory
    skipped: tuple[str, ...] = ()  # promises that could not be recomputed

    @property
    def broken(self) -> tuple[Promise, ...]:
        """Promises that were not kept."""
        return tuple(promise for promise in self.promises if not promise.kept)

    def __str__(self) -> str:
        """Tell how many promises were kept, and which were not."""
        kept = f"{len(self.promises) - len(self.broken)} of {len(self.promises)} promises kept"
        return "\n".join([kept, *(f"{each.name} broken: {each.message}" for each in self.broken)])

    @property
    def kept(self) -> bool:
        """True where every promise was kept."""
        return not self.broken

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values, fit for JSON."""
        return {
            "kept": self.kept,
            "promises": [finite_or_none(promise._asdict()) for promise in self.promises],
            "skipped": list(self.skipped),
            "summary": self.summary,
        }


def finite_or_none(value: Any) -> Any:
    """Replace numbers that JSON cannot hold, in lists and tables too."""
    if isinstance(value, float) and not isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: finite_or_none(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(part) for part in value]
    return value
