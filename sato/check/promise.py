"""Promises of a run, kept or broken."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

# Rounding in one step, relative to the largest position, speed or control.
ROUNDING_TOLERANCE = 1e-10


class Promise(NamedTuple):
    """Property that a run must have, and the value that was found."""

    name: str
    kept: bool
    value: float  # worst violation, or the quantity itself
    tolerance: float  # largest value that keeps the promise
    message: str


def expect_none(name: str, count: int | np.integer, violations: str) -> Promise:
    """Promise that there are no violations, described in the plural."""
    text = (
        violations
        if violations.startswith(("legs", "every"))
        else f"{int(count) or 'no'} {violations}"
    )
    return Promise(name, int(count) == 0, float(count), 0.0, text)


def expect_small_error(name: str, value: float, tolerance: float, error: str) -> Promise:
    """Promise that an error is within its tolerance."""
    return Promise(name, bool(value <= tolerance), value, tolerance, f"{value:.3g} {error}")


def expect_below(name: str, value: float, limit: float, relative: float, quantity: str) -> Promise:
    """Promise that a quantity does not exceed its limit, but for a relative tolerance."""
    kept = bool(value <= limit * (1 + relative))
    return Promise(name, kept, value, limit, f"{value:.6g} {quantity}, {limit:.6g} allowed")


def max_or_zero(values: Float[Array, "*k"] | Bool[Array, "*k"]) -> float:
    """Return the largest value; NaN where there is one, which breaks every promise."""
    return float(np.max(values, initial=0.0))
