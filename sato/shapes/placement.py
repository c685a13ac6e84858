"""Scale and position of a shape."""

from collections.abc import Callable, Sequence
from math import ceil, isfinite, isinf, log10
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance

Center = Literal["origin", "given"] | Sequence[float]
"""Position of the middle of a shape; "given" leaves it where its own coordinates put it."""

ROUNDING = 1e-12  # relative: rounding never leaves targets closer than the requested spacing


class UnplacedShape(NamedTuple):
    """Targets of a shape, at any scale."""

    label: str  # name of the shape in messages
    points: Float[Array, "count d"]  # in order
    center: Float[Array, " d"]  # the point that is moved to the requested center
    size_name: Literal["height", "radius"] | None  # None where the shape has no size to request
    size: float  # height or radius at this scale
    max_count: Callable[[float], int] | None = None  # targets that fit at a spacing, at this scale
    has_own_size: bool = False  # True where neither spacing nor size need be requested


def place_shape(
    shape: UnplacedShape,
    *,
    spacing: float | None,
    size: float | None,
    minimum_spacing: float,
    center: Center,
) -> Float[Array, "count d"]:
    """Scale a shape to a spacing or to a size, and move it to its center.

    Raises:
        ValueError: Spacing, size or center make no sense, or the targets would be closer than
            `minimum_spacing`.
    """
    _check_size(shape, spacing, size)
    if not (isfinite(minimum_spacing) and minimum_spacing >= 0):
        raise ValueError(f"minimum_spacing must not be negative, got {minimum_spacing} m")
    drawn = min_distance(shape.points)
    if drawn == 0:
        raise ValueError(f"{shape.label} has no room for {len(shape.points)} separate targets")
    scale = 1.0
    if spacing is not None and isinf(drawn):
        # No spacing determines the size of a shape with one target, so it stands in the middle.
        shape = shape._replace(points=shape.center[None])
    elif spacing is not None:
        scale = spacing / drawn * (1 + ROUNDING)
    elif size is not None and shape.size > 0:
        scale = size / shape.size
    if drawn * scale < minimum_spacing * (1 - 1e-9):
        raise ValueError(_too_close_message(shape, drawn, scale, spacing, minimum_spacing))
    position = _resolve_center(center, shape.center * scale)
    return np.asarray((shape.points - shape.center) * scale + position)


def check_count(count: int) -> None:
    """Refuse a shape without targets.

    Raises:
        ValueError: There is less than one target.
    """
    if count < 1:
        raise ValueError(f"a shape needs at least one target, got count = {count}")


def _check_size(shape: UnplacedShape, spacing: float | None, size: float | None) -> None:
    for name, value in (("spacing", spacing), (shape.size_name, size)):
        if value is not None and not (isfinite(value) and value > 0):
            raise ValueError(f"{name} must be a positive number of meters, got {value}")
    if spacing is not None and size is not None:
        raise ValueError(f"give spacing or {shape.size_name}, not both: one determines the other")
    if spacing is None and size is None and shape.size_name and not shape.has_own_size:
        raise ValueError(f"give the spacing of the targets or the {shape.size_name} of the shape")


def _resolve_center(center: Center, given: Float[Array, " d"]) -> Float[Array, " d"]:
    if isinstance(center, str):
        if center not in ("origin", "given"):
            raise ValueError(f'center must be "origin", "given" or a point, got "{center}"')
        return np.zeros_like(given) if center == "origin" else given
    position = np.array(center, dtype=float)
    if position.shape != given.shape or not np.isfinite(position).all():
        raise ValueError(f"center must be {len(given)} finite numbers, got {list(center)}")
    return position


def _too_close_message(
    shape: UnplacedShape, drawn: float, scale: float, spacing: float | None, needed: float
) -> str:
    count = len(shape.points)
    if spacing is not None or shape.size_name is None:
        at, cure = "", f"a spacing of {needed:.4g} m"
    else:
        size = shape.size * scale
        at = f" at a {shape.size_name} of {size:.4g} m"
        cure = f"a {shape.size_name} of {_round_up(size * needed / (drawn * scale)):.4g} m"
        if shape.max_count is not None:
            fewer = shape.max_count(needed / scale)
            cure += f", or at most {fewer} target{'s' * (fewer != 1)},"
    return (
        f"{shape.label}{at} puts {count} targets {drawn * scale:.5g} m apart, "
        f"and they need {needed:.5g} m: {cure} would do"
    )


def _round_up(value: float) -> float:
    # To four digits, and never down: a size that the message offers must be large enough.
    unit = 10.0 ** (ceil(log10(value)) - 4)
    return ceil(value / unit) * unit
