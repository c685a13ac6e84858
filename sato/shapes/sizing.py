"""How large a shape is, and where it stands."""

from collections.abc import Callable, Sequence
from math import ceil, isfinite, isinf, log10
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.path import least_distance

Centre = Literal["origin", "given"] | Sequence[float]
"""Where the middle of a shape goes; "given" leaves it where its own coordinates put it."""

ROUNDING = 1e-12  # relative: targets asked for at a spacing are never an ulp closer than it


class Draft(NamedTuple):
    """A shape at whatever scale it was drawn."""

    what: str  # as it stands in a message
    points: Float[Array, "count d"]  # in order
    middle: Float[Array, " d"]  # what `centre` places
    measure: Literal["height", "radius"] | None  # the name of its size; None has none
    size: float  # its height or radius as drawn
    most: Callable[[float], int] | None = None  # how many targets fit at a spacing, same size


def place(
    draft: Draft,
    *,
    spacing: float | None,
    size: float | None,
    minimum_spacing: float,
    centre: Centre,
) -> Float[Array, "count d"]:
    """Scale a draft to a spacing or to a size, and move it to its centre.

    Raises:
        ValueError: The targets would stand closer than `minimum_spacing`.
    """
    _check_size(draft.measure, spacing, size)
    if not (isfinite(minimum_spacing) and minimum_spacing >= 0):
        raise ValueError(f"minimum_spacing must not be negative, got {minimum_spacing} m")
    drawn = least_distance(draft.points)
    if drawn == 0:
        raise ValueError(f"{draft.what} has no room for {len(draft.points)} separate targets")
    scale = 1.0
    if spacing is not None and isinf(drawn):
        # One target alone: no spacing tells the size, so it stands in the middle.
        draft = draft._replace(points=draft.middle[None])
    elif spacing is not None:
        scale = spacing / drawn * (1 + ROUNDING)
    elif size is not None and draft.size > 0:
        scale = size / draft.size
    if drawn * scale < minimum_spacing * (1 - 1e-9):
        raise ValueError(_too_close(draft, drawn, scale, spacing, minimum_spacing))
    goal = _goal(centre, draft.middle * scale)
    return np.asarray((draft.points - draft.middle) * scale + goal)


def check_count(count: int) -> None:
    """Refuse a shape without targets."""
    if count < 1:
        raise ValueError(f"a shape needs at least one target, got count = {count}")


def require_size(measure: str, spacing: float | None, size: float | None) -> None:
    """Refuse a shape that has no size of its own and was given none."""
    if spacing is None and size is None:
        raise ValueError(f"give the spacing of the targets or the {measure} of the shape")


def _check_size(measure: str | None, spacing: float | None, size: float | None) -> None:
    for name, value in (("spacing", spacing), (measure, size)):
        if value is not None and not (isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive number of metres, got {value}")
    if spacing is not None and size is not None:
        raise ValueError(f"give spacing or {measure}, not both: either one settles the other")


def _goal(centre: Centre, given: Float[Array, " d"]) -> Float[Array, " d"]:
    if isinstance(centre, str):
        if centre not in ("origin", "given"):
            raise ValueError(f'centre must be "origin", "given" or a point, got "{centre}"')
        return np.zeros_like(given) if centre == "origin" else given
    goal = np.array(centre, dtype=float)
    if goal.shape != given.shape or not np.isfinite(goal).all():
        raise ValueError(f"centre must be {len(given)} finite numbers, got {list(centre)}")
    return goal


def _too_close(
    draft: Draft, drawn: float, scale: float, spacing: float | None, needed: float
) -> str:
    count = len(draft.points)
    if spacing is not None or draft.measure is None:
        at, cure = "", f"a spacing of {needed:.4g} m"
    else:
        size = draft.size * scale
        at = f" at a {draft.measure} of {size:.4g} m"
        cure = f"a {draft.measure} of {_up(size * needed / (drawn * scale)):.4g} m"
        if draft.most is not None:
            fewer = draft.most(needed / scale)
            cure += f", or at most {fewer} target{'s' * (fewer != 1)},"
    return (
        f"{draft.what}{at} puts {count} targets {drawn * scale:.5g} m apart, "
        f"and they need {needed:.5g} m: {cure} would do"
    )


def _up(value: float) -> float:
    # To four digits, and never down: a size that is said to do must do.
    unit = 10.0 ** (ceil(log10(value)) - 4)
    return ceil(value / unit) * unit
