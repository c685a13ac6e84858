"""Shapes of a scenario file: what to ask of `sato.shapes`."""

from abc import ABC, abstractmethod
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import Field, PositiveFloat

from sato import shapes
from sato.former.refusal import Refusal
from sato.former.units import Table
from sato.shapes.placement import UnplacedShape, place_shape


class Shape(Table, ABC):
    """Somewhere to be, for any number of agents.

    A flat shape lies in the x–y plane of a model in space.
    """

    centre_m: list[float] | None = None  # where the middle goes; the origin without it

    @abstractmethod
    def draw(self, count: int, axes: int, least: float) -> Float[Array, "count d"]:
        """Positions about the origin, at least so far apart; ValueError where there is no room."""

    def place(self, count: int, axes: int, least: float) -> Float[Array, "count axes"]:
        """Positions in the space of the model.

        Raises:
            Refusal: The shape does not fit the count, the distance or the model.
        """
        try:
            drawn = self.draw(count, axes, least)
        except ValueError as error:
            raise Refusal("", str(error)) from error
        if drawn.shape[1] > axes:
            raise Refusal(
                "", f"has {drawn.shape[1]} coordinates a point, and the model moves in {axes}"
            )
        middle = centre(self.centre_m, axes)
        placed = np.tile(middle, (count, 1))
        placed[:, : drawn.shape[1]] += drawn
        return placed

    @property
    def outside(self) -> bool:
        """Whether the shape rests on something outside the scenario: a file, an installed font."""
        return False

    def portable(self, count: int, axes: int) -> "Shape":
        """The same shape without what lies outside."""
        if not self.outside:
            return self
        listed = self.place(count, axes, 0.0).tolist()
        return Points(kind="points", positions_m=listed, keep_order=True)


class Text(Shape):
    """A line of text."""

    kind: Literal["text"]
    text: str
    font: str | None = None
    spacing_m: PositiveFloat | None = None
    height_m: PositiveFloat | None = None

    def draw(self, count: int, axes: int, least: float) -> Float[Array, "count d"]:
        """Letters."""
        return shapes.text(
            self.text,
            count,
            spacing=self.spacing_m,
            height=self.height_m,
            font=self.font,
            minimum_spacing=least,
        )

    @property
    def outside(self) -> bool:
        """Only the fonts that are taken when none is named are installed everywhere."""
        return self.font is not None


class Ring(Shape):
    """A circle."""

    kind: Literal["ring"]
    radius_m: PositiveFloat | None = None
    spacing_m: PositiveFloat | None = None
    normal: list[float] | None = None  # of its plane, in space

    def draw(self, count: int, axes: int, least: float) -> Float[Array, "count d"]:
        """Equal distances on a circle."""
        return shapes.ring(
            count,
            spacing=self.spacing_m,
            radius=self.radius_m,
            normal=self.normal,
            minimum_spacing=least,
        )


class Lattice(Shape):
    """A dense patch: hexagonal in the plane, a ball in space."""

    kind: Literal["lattice", "grid"]
    spacing_m: PositiveFloat | None = None
    radius_m: PositiveFloat | None = None
    flat: bool = False  # in the plane, where the model moves in space

    def draw(self, count: int, axes: int, least: float) -> Float[Array, "count d"]:
        """Nodes of a lattice."""
        return shapes.lattice(
            count,
            dimension=2 if self.flat else axes,
            spacing=self.spacing_m,
            radius=self.radius_m,
            minimum_spacing=least,
        )


class Polygon(Shape):
    """An area with corners; it stays where its vertices put it, unless a centre is given."""

    kind: Literal["polygon"]
    vertices_m: list[list[float]]
    spacing_m: PositiveFloat | None = None
    height_m: PositiveFloat | None = None

    def draw(self, count: int, axes: int, least: float) -> Float[Array, "count d"]:
        """Targets that fill the polygon."""
        return shapes.polygon(
            self.vertices_m,
            count,
            spacing=self.spacing_m,
            height=self.height_m,
            minimum_spacing=least,
            center="given" if self.centre_m is None else "origin",
        )


class Picture(Shape):
    """What is painted on a picture."""

    kind: Literal["picture"]
    file: str
    spacing_m: PositiveFloat | None = None
    height_m: PositiveFloat | None = None
    invert: bool = False

    def draw(self, count: int, axes: int, least: float) -> Float[Array, "count d"]:
        """Targets that fill what is dark or opaque."""
        return shapes.picture(
            self.file,
            count,
            spacing=self.spacing_m,
            height=self.height_m,
            invert=self.invert,
            minimum_spacing=least,
        )

    @property
    def outside(self) -> bool:
        """A picture is a file."""
        return True


class Points(Shape):
    """Points of a list, or of a file with one point a line."""

    kind: Literal["points"]
    file: str | None = None
    positions_m: list[list[float]] | None = None
    keep_order: bool = False  # else every prefix is made to keep the shape
    spacing_m: PositiveFloat | None = None

    def draw(self, count: int, axes: int, least: float) -> Float[Array, "count d"]:
        """The first points of the order."""
        where: Literal["given", "origin"] = "given" if self.centre_m is None else "origin"
        if self.file is not None and self.positions_m is None:
            return shapes.points(
                self.file,
                count,
                keep_order=self.keep_order,
                spacing=self.spacing_m,
                minimum_spacing=least,
                center=where,
            )
        if self.file is not None or self.positions_m is None:
            raise ValueError("give a file or positions_m, one of them")
        listed = rows(self.positions_m, "positions_m")
        if len(listed) < count:
            raise ValueError(f"lists {len(listed)} points, fewer than the {count} asked for")
        middle = (listed.min(axis=0) + listed.max(axis=0)) / 2
        chosen = listed if self.keep_order else listed[shapes.farthest_point_order(listed)]
        placed = place_shape(
            UnplacedShape("the list of points", chosen[:count], middle, None, 1.0),
            spacing=self.spacing_m,
            size=None,
            minimum_spacing=least,
            center=where,
        )
        # Scaled by nothing and moved nowhere, they stay what they are to the last bit.
        return placed if self.spacing_m or self.centre_m else chosen[:count]

    @property
    def outside(self) -> bool:
        """A list may be a file."""
        return self.file is not None


AnyShape = Annotated[
    Text | Ring | Lattice | Polygon | Picture | Points, Field(discriminator="kind")
]


def centre(given: list[float] | None, axes: int) -> Float[Array, " axes"]:
    """Where the middle goes; a centre in the plane will do in space too.

    Raises:
        Refusal: It has the wrong number of coordinates.
    """
    if given is None:
        return np.zeros(axes)
    if len(given) not in (2, axes):
        raise Refusal("centre_m", f"needs {axes} coordinates, got {len(given)}")
    return np.array([*given, 0.0, 0.0][:axes])


def rows(table: list[list[float]], what: str) -> Float[Array, "k d"]:
    """A list of points as an array.

    Raises:
        ValueError: It is empty, or its rows differ in length or are not in 2-D or 3-D.
    """
    lengths = {len(row) for row in table}
    if len(lengths) != 1 or not lengths <= {2, 3}:
        raise ValueError(f"{what} needs rows of 2 or 3 coordinates, all of one length")
    return np.array(table, dtype=float)
