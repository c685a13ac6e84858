"""Shapes as values, and points one by one: targets or starts for any number of agents."""

from abc import abstractmethod
from dataclasses import dataclass
from math import isinf
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.callbacks import Callback, as_kind, as_shape
from dynamics.labels import AXES, STATES, to_plain
from dynamics.trajectory_geometry import min_distance as least_distance
from dynamics.units import Length, Unit
from sato.scenario.csv_file import read_columns
from sato.scenario.definition import (
    Amount,
    Axes,
    Coordinates,
    Definition,
    Matrix,
    NotNegative,
    Positive,
    as_array,
    errors_in,
)
from sato.scenario.errors import InputError, round_up
from sato.shapes.ordering import farthest_point_sampling

Size = Annotated[Length, Positive]
MAX_COORDINATE = 1e9  # largest coordinate whose square is sure not to overflow [m]
ROUNDING = 1e-12  # relative: rounding never leaves targets closer than the requested spacing


class Drawing(NamedTuple):
    """Targets of a shape, at any scale."""

    points: Float[Array, "count d"]  # in order
    middle: Float[Array, " d"]  # the point that is moved to the center
    size: float = 1.0  # height or radius, where the shape has one


def _as_drawing(shape: Any, given: dict[str, Any], value: Any) -> Drawing:
    what = "Drawing(points, middle)"
    points, middle, size = (*as_kind(value, tuple, what), 1.0, 1.0, 1.0)[:3]
    axes = np.shape(points)[1] if isinstance(points, Array) and points.ndim == 2 else given["axes"]
    points, middle = as_shape(points, (given["count"], axes)), as_shape(middle, (axes,))
    return Drawing(points, middle, float(as_shape(size, ())))


def _as_rows(shape: Any, given: dict[str, Any], value: Any) -> Array:
    return as_shape(value, (given["count"], given["axes"]))


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Shape(Definition):
    """Positions for any number of agents; a flat shape lies in the x-y plane of space."""

    callbacks: ClassVar = {
        "draw": Callback("count axes", _as_drawing),
        "place": Callback("count axes min_distance", _as_rows),
        "place_velocities": Callback(
            "count axes", lambda *given: None if given[-1] is None else _as_rows(*given)
        ),
    }
    is_absolute: ClassVar[bool] = False  # keeps size and position unless others are requested

    center: Annotated[Coordinates | None, Unit("m"), "its middle; the origin if absent"] = None
    spacing: Annotated[Size | None, Unit("m"), "least distance of two targets"] = None

    @abstractmethod
    def draw(self, count: Amount, axes: Axes) -> Drawing:
        """Draw the shape at any scale.

        Raises:
            ValueError: It cannot be drawn.
        """

    def place(
        self, count: Amount, axes: Axes, min_distance: Annotated[float, NotNegative] = 0.0
    ) -> Float[Array, "count axes"]:
        """Return positions in the space of the model [m].

        Args:
            count: Number of targets.
            axes: Dimension of space.
            min_distance: Least distance of two targets [m].

        Raises:
            InputError: The shape does not fit the count, the distance or the model.
        """
        with errors_in(""):
            drawn = self._draw_to_scale(count, axes, min_distance)
        d = drawn.shape[1]
        if d > axes:
            raise InputError("", f"has {d} coordinates per point, and the model has {axes} axes")
        placed = np.tile(center_in(self.center, axes), (count, 1))
        placed[:, :d] += drawn
        return placed

    def place_velocities(self, count: Amount, axes: Axes) -> Float[Array, "count axes"] | None:
        """Return the velocity at each position [m/s], where the shape gives them."""
        return None

    @property
    def uses_files(self) -> bool:
        """True where the shape depends on a file or an installed font."""
        return any(getattr(self, name, None) is not None for name in ("file", "font"))

    def without_files(self, count: Amount, axes: Axes) -> Any:
        """Return the same shape with the contents of its files."""
        if not self.uses_files:
            return self
        return Points(self.place(count, axes), self.place_velocities(count, axes), keep_order=True)

    def _draw_to_scale(self, count: Amount, axes: Axes, needed: float) -> Float[Array, "count d"]:
        # Positions about the origin, or where an absolute shape is drawn if there is no center.
        points, middle, drawn_size = self.draw(count, axes)
        name = next((name for name in ("height", "radius") if hasattr(self, name)), "")
        spacing, size = self.spacing, getattr(self, name, None)
        if spacing is not None and size is not None:
            raise ValueError(f"give spacing or {name}, not both: one determines the other")
        if spacing is None and size is None and not self.is_absolute:
            raise ValueError(f"give the spacing of the targets or the {name} of the shape")
        drawn, scale = least_distance(points), 1.0
        if drawn == 0 and (needed > 0 or spacing is not None or size is not None):
            rows, times = np.unique(points, axis=0, return_counts=True)
            place = ", ".join(f"{x:g}" for x in rows[times.argmax()])
            raise ValueError(f"two of its {len(points)} points are at the same place, [{place}]")
        if spacing is not None and isinf(drawn):
            # No spacing determines the size of a shape with one target: it stands in the middle.
            points = middle[None]
        elif spacing is not None:
            scale = spacing / drawn * (1 + ROUNDING)
        elif size is not None and drawn_size > 0:
            scale = size / drawn_size
        reached = drawn * scale
        if reached < needed * (1 - 1e-9):
            cure = f"a spacing of {round_up(needed)} m"
            if name and spacing is None:
                cure = f"a {name} of {round_up(drawn_size * scale * needed / reached)} m"
            found = f"{len(points)} targets are {reached:.8g} m apart"
            raise ValueError(f"{found}, and they need {needed:.8g} m: {cure} would do")
        stays = self.is_absolute and self.center is None
        return np.asarray((points - middle) * scale + (middle * scale if stays else 0.0))


def center_in(given: tuple[float, ...] | None, axes: int) -> Float[Array, " axes"]:
    """Return a center in the space of the model, or in its plane; refuse other coordinates."""
    given = given or (0.0, 0.0)
    if len(given) not in (2, axes):
        raise InputError("center_m", f"needs {axes} coordinates, got {len(given)}")
    return np.array([*given, 0.0, 0.0][:axes])


@dataclass(frozen=True, eq=False, repr=False)
class Points(Shape):
    """Positions one by one, with velocities or without, as an array or in a file.

    They stay where they are unless a center is given, and as far apart unless a spacing is.
    """

    kind: ClassVar[str] = "points"
    is_absolute: ClassVar[bool] = True
    positions: Annotated[Matrix | None, Unit("m"), "one row a point"] = None
    velocities: Annotated[Matrix | None, Unit("m_s"), "one row a point; at rest if absent"] = None
    keep_order: Annotated[bool, "keep the order; else every prefix keeps the shape"] = False
    file: Annotated[str | None, "CSV file with one point a line"] = None

    def check(self) -> None:
        """Refuse other than one source of positions, and velocities of another shape."""
        p, v = self.positions, self.velocities
        if (self.file is None) == (p is None):
            raise InputError("positions_m", "or a file is needed, and not both")
        if p is not None and p.shape[1] not in (2, 3):
            raise InputError("positions_m", f"needs rows of 2 or 3 coordinates, got {p.shape[1]}")
        if p is not None and v is not None and v.shape != p.shape:
            needed = f"needs the shape of the positions, {p.shape}"
            raise InputError("velocities_m_s", f"{needed}, got {v.shape}")

    @property
    def listed(self) -> Float[Array, "k d"]:
        """All points [m], of the file where there is one."""
        return self._states[0]

    @property
    def _states(self) -> tuple[Float[Array, "k d"], Float[Array, "rows axes"] | None]:
        if self.file is None:
            return np.asarray(self.positions), self.velocities
        with errors_in("file"):
            points, velocities = read_states(Path(self.file))
        if velocities is not None and self.velocities is not None:
            raise InputError("velocities_m_s", "stand in the file too; one of the two is enough")
        return points, self.velocities if velocities is None else velocities

    def draw(self, count: Amount, axes: Axes) -> Drawing:
        """Take the first points of the order."""
        listed = self.listed
        middle = (listed.min(axis=0) + listed.max(axis=0)) / 2
        if self.file is None and not self.spacing and not self.center:
            middle = np.zeros_like(middle)  # the points stay what they are to the last bit
        return Drawing(listed[self._order(listed, count)], middle)

    def place_velocities(self, count: Amount, axes: Axes) -> Float[Array, "count axes"] | None:
        """Return the velocity at each position [m/s], where they are given.

        Raises:
            InputError: There are not as many rows as points, or of another length.
        """
        listed, moving = self._states
        if moving is None:
            return None
        if self.file and self.velocities is not None:
            if len(moving) < count or not self.keep_order or moving.shape[1] != listed.shape[1]:
                needed = f"needs {count} rows of {listed.shape[1]} in the order of the file"
                raise InputError("velocities_m_s", needed)
        rows = moving[self._order(listed, count)]
        return np.pad(rows, ((0, 0), (0, axes - rows.shape[1])))

    def _order(self, listed: Float[Array, "k d"], count: int) -> Int[Array, " count"]:
        if len(listed) < count:
            key, path = ("positions_m", "") if self.file is None else ("file", f"{self.file} ")
            found = f"{path}lists {len(listed)} points"
            raise InputError(key, f"{found}, fewer than the {count} needed")
        return np.arange(count) if self.keep_order else farthest_point_sampling(listed, count)


def as_points(value: Any) -> Any:
    """Convert an array of positions or states to `Points`; leave anything else as it is.

    Rows have 2 or 3 coordinates, or 4 or 6: positions, then velocities. An instant of a run is a
    dataset of `position` and `velocity`.
    """
    if {"position", "velocity"} <= set(getattr(value, "data_vars", ())):
        return Points(value["position"], value["velocity"])
    value = to_plain(value, "m", STATES)
    if not isinstance(value, Array | list | tuple):
        return value
    array = as_array(value, 2)
    columns = array.shape[1]
    if columns not in (2, 3, 4, 6):
        needed = "must have rows of 2 or 3 coordinates, or of 4 or 6 with velocities"
        raise InputError("", f"{needed}, got shape {array.shape}")
    d = columns if columns < 4 else columns // 2
    return Points(array[:, :d], array[:, d:] if columns > 3 else None)


def read_states(path: Path) -> tuple[Float[Array, "k d"], Float[Array, "k d"] | None]:
    """Read the positions [m] of a CSV file, and the velocities [m/s] that it may have.

    A header names the columns, in any order and unit: x, y and z, vx, vy and vz, and the number
    id of each row, by which the rows are sorted. Without one, two or three columns are x, y and z
    in meters.
    """
    columns, lines = read_columns(path, "points", STATES, (2, 3))
    states = np.stack(list(columns.values()), axis=1)
    for line, state in zip(lines, states, strict=True):
        if not np.abs(state).max() <= MAX_COORDINATE:
            found, limit = ", ".join(f"{x:g}" for x in state), f"{MAX_COORDINATE:.0e} m"
            where = f"{path}, line {line}"
            raise ValueError(f"{where}: a coordinate is not finite, or beyond {limit}: {found}")
    d = sum(axis in columns for axis in AXES)
    points = states[:, :d]
    for k in range(len(points)):
        # Points closer than rounding can resolve coincide.
        away = np.abs(points[:k] - points[k]).max(axis=1, initial=0)
        same = np.flatnonzero(away <= 1e-12 * np.abs(points[: k + 1]).max())
        if len(same):
            both = f"lines {lines[same[0]]} and {lines[k]}"
            raise ValueError(f"{path}: {both} are the same point; two agents cannot share it")
    return points, states[:, d:] if states.shape[1] > d else None
