"""Shapes as values: targets or starts for any number of agents."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from math import isinf
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance as least_distance
from dynamics.units import Length, Unit
from sato.scenario.definition import Coordinates, Definition, Positive
from sato.scenario.errors import InputError, errors_in, round_up

Size = Annotated[Length, Positive]
ROUNDING = 1e-12  # relative: rounding never leaves targets closer than the requested spacing


class Drawing(NamedTuple):
    """Targets of a shape, at any scale."""

    label: str  # name of the shape in messages
    points: Float[Array, "count d"]  # in order
    middle: Float[Array, " d"]  # the point that is moved to the center
    size_name: Literal["height", "radius"] | None = None  # None where no size can be requested
    size: float = 1.0  # height or radius at this scale
    max_count: Callable[[float], int] | None = None  # targets that fit at a spacing, at this scale
    is_absolute: bool = False  # True where size and position are kept unless others are requested


@dataclass(frozen=True, eq=False, repr=False)
class Shape(Definition):
    """Positions for any number of agents; a flat shape lies in the x-y plane of space."""

    center: Annotated[
        Coordinates | None, Unit("m"), "middle of the shape; the origin if absent"
    ] = field(default=None, kw_only=True)
    spacing: Annotated[Size | None, Unit("m"), "least distance of two targets"] = field(
        default=None, kw_only=True
    )

    @abstractmethod
    def draw(self, count: int, axes: int) -> Drawing:
        """Draw the shape at any scale.

        Raises:
            ValueError: It cannot be drawn.
        """

    def place(self, count: int, axes: int, min_distance: float = 0.0) -> Float[Array, "count axes"]:
        """Return positions in the space of the model.

        Raises:
            InputError: The shape does not fit the count, the distance or the model.
        """
        if count < 1:
            raise InputError("", f"a shape needs at least one target, got count = {count}")
        with errors_in(""):
            drawn = self._scale(self.draw(count, axes), min_distance)
        if drawn.shape[1] > axes:
            raise InputError(
                "", f"has {drawn.shape[1]} coordinates per point, and the model has {axes} axes"
            )
        placed = np.tile(center_in(self.center, axes), (count, 1))
        placed[:, : drawn.shape[1]] += drawn
        return placed

    def place_velocities(self, count: int, axes: int) -> Float[Array, "count axes"] | None:
        """Return the velocity at each position, where the shape gives them."""
        return None

    @property
    def uses_files(self) -> bool:
        """True where the shape depends on a file or an installed font."""
        return any(getattr(self, name, None) is not None for name in ("file", "font"))

    def without_files(self, count: int, axes: int) -> Any:
        """Return the same shape with the contents of its files."""
        from sato.shapes.points import Points

        if not self.uses_files:
            return self
        velocities = self.place_velocities(count, axes)
        return Points(self.place(count, axes), velocities, keep_order=True)

    def _scale(self, drawing: Drawing, needed: float) -> Float[Array, "count d"]:
        # Positions about the origin, or where the drawing is absolute and there is no center.
        label, points, middle, size_name, drawn_size, _, is_absolute = drawing
        spacing, size = self.spacing, getattr(self, size_name) if size_name else None
        if spacing is not None and size is not None:
            raise ValueError(f"give spacing or {size_name}, not both: one determines the other")
        if spacing is None and size is None and not is_absolute:
            raise ValueError(f"give the spacing of the targets or the {size_name} of the shape")
        drawn, scale = least_distance(points), 1.0
        if drawn == 0:
            raise ValueError(f"{label} has no room for {len(points)} separate targets")
        if spacing is not None and isinf(drawn):
            # No spacing determines the size of a shape with one target: it stands in the middle.
            points = middle[None]
        elif spacing is not None:
            scale = spacing / drawn * (1 + ROUNDING)
        elif size is not None and drawn_size > 0:
            scale = size / drawn_size
        if drawn * scale < needed * (1 - 1e-9):
            raise ValueError(_too_close_message(drawing, drawn, scale, spacing, needed))
        stays = is_absolute and self.center is None
        position = middle * scale if stays else np.zeros_like(middle)
        return np.asarray((points - middle) * scale + position)


def center_in(given: tuple[float, ...] | None, axes: int) -> Float[Array, " axes"]:
    """Return a center in the space of the model; one in the plane will do in space too.

    Raises:
        InputError: It has the wrong number of coordinates.
    """
    if given is None:
        return np.zeros(axes)
    if len(given) not in (2, axes):
        raise InputError("center_m", f"needs {axes} coordinates, got {len(given)}")
    return np.array([*given, 0.0, 0.0][:axes])


def _too_close_message(
    drawing: Drawing, drawn: float, scale: float, spacing: float | None, needed: float
) -> str:
    count, name = len(drawing.points), drawing.size_name
    if spacing is not None or name is None:
        at, cure = "", f"a spacing of {needed:.4g} m"
    else:
        size = drawing.size * scale
        at = f" at a {name} of {size:.4g} m"
        cure = f"a {name} of {round_up(size * needed / (drawn * scale))} m"
        if drawing.max_count is not None:
            fewer = drawing.max_count(needed / scale)
            cure += f", or at most {fewer} target{'s' * (fewer != 1)},"
    return (
        f"{drawing.label}{at} puts {count} targets {drawn * scale:.5g} m apart, "
        f"and they need {needed:.5g} m: {cure} would do"
    )
