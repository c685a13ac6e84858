"""How large a shape is, and where it stands."""

from collections.abc import Callable, Sequence
from math import ceil, isfinite, isinf, log10
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance

Center = Literal["origin", "given"] | Sequence[float]
"""Where the middle of a shape goes; "given" leaves it where its own coordinates put it."""

ROUNDING = 1e-12  # relative: targets asked for at a spacing are never an ulp closer than it


class UnplacedShape(NamedTuple):
    """A shape at whatever scale it was drawn."""

    label: str  # as it stands in a message
    points: Float[Array, "count d"]  # in order
    center: Float[Array, " d"]  # what `centre` places
    size_name: Literal["height", "radius"] | None  # the name of its size; None has none
    size: float  # its height or radius as drawn
    max_count: Callable[[float], int] | None = None  # how many targets fit at a spacing, same size


def place_shape(
    shape: UnplacedShape,
    *,
    spacing: float | None,
    size: float | None,
    minimum_spacing: float,
    center: Center,
) -> Float[Array, "count d"]:
    """Scale a draft to a spacing or to a size, and move it to its centre.

    Raises:
        ValueError: The targets would stand closer than `minimum_spacing`.
    """
    _check_size(shape.size_name, spacing, size)
    if not (isfinite(minimum_spacing) and minimum_spacing >= 0):
        raise ValueError(f"minimum_spacing must not be negative, got {minimum_spacing} m")
    drawn = min_distance(shape.points)
    if drawn == 0:
        raise ValueError(f"{shape.label} has no room for {len(shape.points)} separate targets")
    scale = 1.0
    if spacing is not None and isinf(drawn):
        # One target alone: no spacing tells the size, so it stands in the middle.
        shape = shape._replace(points=shape.center[None])
    elif spacing is not None:
        scale = spacing / drawn * (1 + ROUNDING)
    elif size is not None and shape.size > 0:
        scale = size / shape.size
    if drawn * scale < minimum_spacing * (1 - 1e-9):
        raise ValueError(_too_close_message(shape, drawn, scale, spacing, minimum_spacing))
    goal = _resolve_center(center, shape.center * scale)
    return np.asarray((shape.points - shape.center) * scale + goal)


def check_count(count: int) -> None:
    """Refuse a shape without targets."""
    if count < 1:
        raise ValueError(f"a shape needs at least one target, got count = {count}")


def check_size_given(measure: str, spacing: float | None, size: float | None) -> None:
    """Refuse a shape that has no size of its own and was given none."""
    if spacing is None and size is None:
        raise ValueError(f"give the spacing of the targets or the {measure} of the shape")


def _check_size(measure: str | None, spacing: float | None, size: float | None) -> None:
    for name, value in (("spacing", spacing), (measure, size)):
        if value is not None and not (isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive number of metres, got {value}")
    if spacing is not None and size is not None:
        raise ValueError(f"give spacing or {measure}, not both: either one settles the other")


def _resolve_center(centre: Center, given: Float[Array, " d"]) -> Float[Array, " d"]:
    if isinstance(centre, str):
        if centre not in ("origin", "given"):
            raise ValueError(f'centre must be "origin", "given" or a point, got "{centre}"')
        return np.zeros_like(given) if centre == "origin" else given
    goal = np.array(centre, dtype=float)
    if goal.shape != given.shape or not np.isfinite(goal).all():
        raise ValueError(f"centre must be {len(given)} finite numbers, got {list(centre)}")
    return goal


def _too_close_message(
    draft: UnplacedShape, drawn: float, scale: float, spacing: float | None, needed: float
) -> str:
    count = len(draft.points)
    if spacing is not None or draft.size_name is None:
        at, cure = "", f"a spacing of {needed:.4g} m"
    else:
        size = draft.size * scale
        at = f" at a {draft.size_name} of {size:.4g} m"
        cure = f"a {draft.size_name} of {_round_up(size * needed / (drawn * scale)):.4g} m"
        if draft.max_count is not None:
            fewer = draft.max_count(needed / scale)
            cure += f", or at most {fewer} target{'s' * (fewer != 1)},"
    return (
        f"{draft.label}{at} puts {count} targets {drawn * scale:.5g} m apart, "
        f"and they need {needed:.5g} m: {cure} would do"
    )


def _round_up(value: float) -> float:
    # To four digits, and never down: a size that is said to do must do.
    unit = 10.0 ** (ceil(log10(value)) - 4)
    return ceil(value / unit) * unit
