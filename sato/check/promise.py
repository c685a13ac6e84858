"""A promise, and how it is said to be kept or broken."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

ROUNDING_TOLERANCE = (
    1e-10  # of the largest position, speed or control: what rounding may do in a step
)


class Promise(NamedTuple):
    """Something that a run must keep, and what was found."""

    name: str
    kept: bool
    value: float  # what was found: the worst violation, or the quantity itself
    tolerance: float  # what it may be
    message: str


def expect_none(name: str, count: int | np.integer, what: str) -> Promise:
    """Nothing may have been found of this."""
    text = what if what.startswith(("legs", "every")) else f"{int(count) or 'no'} {what}"
    return Promise(name, int(count) == 0, float(count), 0.0, text)


def expect_small_error(name: str, value: float, tolerance: float, what: str) -> Promise:
    """An error within rounding."""
    return Promise(name, bool(value <= tolerance), value, tolerance, f"{value:.3g} {what}")


def expect_below(name: str, value: float, limit: float, relative: float, what: str) -> Promise:
    """A quantity below its limit."""
    kept = bool(value <= limit * (1 + relative))
    return Promise(name, kept, value, limit, f"{value:.6g} {what}, {limit:.6g} allowed")


def max_or_zero(values: Float[Array, "*k"] | Bool[Array, "*k"]) -> float:
    """The largest of some sizes; NaN where there is any, so that nothing passes unseen."""
    return float(np.max(values, initial=0.0))
