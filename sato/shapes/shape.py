"""Shapes as values: targets or starts that draw themselves for any number of agents."""

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Length, Unit
from sato import shapes
from sato.scenario.definition import (
    Coordinates,
    Definition,
    Matrix,
    Positive,
    as_array,
)
from sato.scenario.errors import InputError
from sato.shapes.placement import UnplacedShape, place_shape

Spacing = Annotated[Length, Positive]


@dataclass(frozen=True, eq=False, repr=False)
class Shape(Definition):
    """Positions for any number of agents; a flat shape lies in the x–y plane of space."""

    center: Annotated[
        Coordinates | None, Unit("m"), "middle of the shape; the origin if absent"
    ] = field(default=None, kw_only=True)

    @abstractmethod
    def draw(self, count: int, axes: int, min_distance: float) -> Float[Array, "count d"]:
        """Return positions about the origin.

        Raises:
            ValueError: They would be closer than the least distance.
        """

    def place(self, count: int, axes: int, min_distance: float) -> Float[Array, "count axes"]:
        """Return positions in the space of the model.

        Raises:
            InputError: The shape does not fit the count, the distance or the model.
        """
        try:
            drawn = self.draw(count, axes, min_distance)
        except InputError:
            raise
        except ValueError as error:
            raise InputError("", str(error)) from error
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
        return False

    def without_files(self, count: int, axes: int) -> Any:
        """Return the same shape with the contents of its files."""
        if not self.uses_files:
            return self
        velocities = self.place_velocities(count, axes)
        return Points(self.place(count, axes, 0.0), velocities, keep_order=True)


@dataclass(frozen=True, eq=False, repr=False)
class Text(Shape):
    """A line of text."""

    kind: ClassVar[str] = "text"
    text: Annotated[str, "text, in one line"]
    font: Annotated[str | None, "name or file of a font"] = None
    spacing: Annotated[Spacing | None, Unit("m"), "least distance of two targets"] = None
    height: Annotated[Spacing | None, Unit("m"), "height of the text"] = None

    def draw(self, count: int, axes: int, min_distance: float) -> Float[Array, "count d"]:
        """Fill the outlines of the letters."""
        return shapes.text(
            self.text,
            count,
            spacing=self.spacing,
            height=self.height,
            font=self.font,
            minimum_spacing=min_distance,
        )

    @property
    def uses_files(self) -> bool:
        """True for a font that may not be installed elsewhere."""
        return self.font is not None


@dataclass(frozen=True, eq=False, repr=False)
class Ring(Shape):
    """A circle with equal distances."""

    kind: ClassVar[str] = "ring"
    radius: Annotated[Spacing | None, Unit("m"), "radius of the circle"] = None
    spacing: Annotated[Spacing | None, Unit("m"), "distance of neighbors on the circle"] = None
    normal: Annotated[Coordinates | None, "normal of its plane, in space"] = None

    def draw(self, count: int, axes: int, min_distance: float) -> Float[Array, "count d"]:
        """Space targets equally on a circle."""
        return shapes.ring(
            count,
            spacing=self.spacing,
            radius=self.radius,
            normal=self.normal,
            minimum_spacing=min_distance,
        )


@dataclass(frozen=True, eq=False, repr=False)
class Lattice(Shape):
    """A dense patch: hexagonal in the plane, face-centered cubic in space."""

    kind: ClassVar[str] = "lattice"
    kinds: ClassVar[tuple[str, ...]] = ("lattice", "grid")
    spacing: Annotated[Spacing | None, Unit("m"), "distance of neighbors"] = None
    radius: Annotated[Spacing | None, Unit("m"), "radius of the patch"] = None
    flat: Annotated[bool, "in the x-y plane, also where the model moves in space"] = False

    def draw(self, count: int, axes: int, min_distance: float) -> Float[Array, "count d"]:
        """Take the nodes of a lattice."""
        return shapes.lattice(
            count,
            dimension=2 if self.flat else axes,
            spacing=self.spacing,
            radius=self.radius,
            minimum_spacing=min_distance,
        )


@dataclass(frozen=True, eq=False, repr=False)
class Polygon(Shape):
    """An area with corners; it stays where its vertices are unless a center is given."""

    kind: ClassVar[str] = "polygon"
    vertices: Annotated[Matrix, Unit("m"), "corners, in order"]
    spacing: Annotated[Spacing | None, Unit("m"), "least distance of two targets"] = None
    height: Annotated[Spacing | None, Unit("m"), "height of the polygon"] = None

    def draw(self, count: int, axes: int, min_distance: float) -> Float[Array, "count d"]:
        """Fill the polygon."""
        return shapes.polygon(
            self.vertices.tolist(),
            count,
            spacing=self.spacing,
            height=self.height,
            minimum_spacing=min_distance,
            center="given" if self.center is None else "origin",
        )


@dataclass(frozen=True, eq=False, repr=False)
class Picture(Shape):
    """The dark or opaque part of a picture."""

    kind: ClassVar[str] = "picture"
    file: Annotated[str, "file of the picture"]
    spacing: Annotated[Spacing | None, Unit("m"), "least distance of two targets"] = None
    height: Annotated[Spacing | None, Unit("m"), "height of the picture"] = None
    invert: Annotated[bool, "fill the bright part"] = False

    def draw(self, count: int, axes: int, min_distance: float) -> Float[Array, "count d"]:
        """Fill the dark or opaque part."""
        return shapes.picture(
            self.file,
            count,
            spacing=self.spacing,
            height=self.height,
            invert=self.invert,
            minimum_spacing=min_distance,
        )

    @property
    def uses_files(self) -> bool:
        """True: a picture is a file."""
        return True


@dataclass(frozen=True, eq=False, repr=False)
class Points(Shape):
    """Positions one by one, with velocities or without, as an array or in a file."""

    kind: ClassVar[str] = "points"
    positions: Annotated[Matrix | None, Unit("m"), "one row a point"] = None
    velocities: Annotated[Matrix | None, Unit("m_s"), "one row a point; at rest if absent"] = None
    keep_order: Annotated[bool, "keep the order; else every prefix is made to keep the shape"] = (
        False
    )
    spacing: Annotated[Spacing | None, Unit("m"), "scale to this least distance of two"] = None
    file: Annotated[str | None, "CSV file with one point a line"] = None

    def check(self) -> None:
        """Refuse other than one source of positions, and velocities of another shape."""
        if (self.file is None) == (self.positions is None):
            raise InputError("positions_m", "or a file is needed, and not both")
        if self.positions is not None:
            if self.positions.shape[1] not in (2, 3):
                raise InputError(
                    "positions_m",
                    f"needs rows of 2 or 3 coordinates, got {self.positions.shape[1]}",
                )
            v = self.velocities
            if v is not None and v.shape != self.positions.shape:
                raise InputError(
                    "velocities_m_s",
                    f"needs the shape of the positions, {self.positions.shape}, got {v.shape}",
                )

    def draw(self, count: int, axes: int, min_distance: float) -> Float[Array, "count d"]:
        """Take the first points of the order."""
        where: Literal["given", "origin"] = "given" if self.center is None else "origin"
        if self.file is not None:
            return shapes.points(
                self.file,
                count,
                keep_order=self.keep_order,
                spacing=self.spacing,
                minimum_spacing=min_distance,
                center=where,
            )
        listed = np.asarray(self.positions)
        chosen = listed[self._order(count)]
        middle = (listed.min(axis=0) + listed.max(axis=0)) / 2
        placed = place_shape(
            UnplacedShape("the list of points", chosen, middle, None, 1.0),
            spacing=self.spacing,
            size=None,
            minimum_spacing=min_distance,
            center=where,
        )
        # Points that are neither scaled nor moved stay what they are to the last bit.
        return placed if self.spacing or self.center else chosen

    def place_velocities(self, count: int, axes: int) -> Float[Array, "count axes"] | None:
        """Return the velocity at each position, where they are given."""
        if self.velocities is None:
            return None
        if self.file is not None:
            order: Any = slice(count)
            if len(self.velocities) < count or not self.keep_order:
                raise InputError("velocities_m_s", f"needs {count} rows in the order of the file")
        else:
            order = self._order(count)
        placed = np.zeros((count, axes))
        placed[:, : self.velocities.shape[1]] = self.velocities[order]
        return placed

    @property
    def uses_files(self) -> bool:
        """True where the points are in a file."""
        return self.file is not None

    def _order(self, count: int) -> Any:
        listed = np.asarray(self.positions)
        if len(listed) < count:
            raise InputError(
                "positions_m", f"lists {len(listed)} points, fewer than the {count} asked for"
            )
        return slice(count) if self.keep_order else shapes.farthest_point_order(listed)[:count]


def as_points(value: Any) -> Any:
    """Convert an array of positions or states to `Points`; leave anything else as it is.

    Args:
        value: Rows of 2 or 3 coordinates, or of 4 or 6: positions, then velocities.

    Raises:
        InputError: It is an array of another shape.
    """
    if not isinstance(value, Array | list | tuple):
        return value
    array = as_array(value, 2)
    columns = array.shape[1]
    if columns not in (2, 3, 4, 6):
        raise InputError(
            "",
            "must have rows of 2 or 3 coordinates, or of 4 or 6 with velocities, got shape "
            f"{array.shape}",
        )
    d = columns if columns < 4 else columns // 2
    return Points(array[:, :d], array[:, d:] if columns > 3 else None)


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
