"""Rings and lattices."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Unit
from sato.scenario.definition import Amount, Axes, Coordinates
from sato.shapes.ordering import farthest_point_sampling, golden_ratio_order
from sato.shapes.shape import Drawing, Shape, Size


@dataclass(frozen=True, eq=False, repr=False)
class Ring(Shape):
    """A circle with equal distances; without a normal, in the x-y plane."""

    kind: ClassVar[str] = "ring"
    radius: Annotated[Size | None, Unit("m"), "radius of the circle"] = None
    normal: Annotated[Coordinates | None, "normal of its plane, in space"] = None

    def draw(self, count: Amount, axes: Axes) -> Drawing:
        """Space targets equally on a circle."""
        angle = 2 * pi / count * golden_ratio_order(count)
        circle = np.column_stack([np.cos(angle), np.sin(angle)])
        circle = circle[farthest_point_sampling(circle, count)]
        nodes = circle if self.normal is None else embed_in_plane(circle, self.normal)
        return Drawing(nodes, np.zeros(nodes.shape[1]))


@dataclass(frozen=True, eq=False, repr=False)
class Lattice(Shape):
    """A dense patch: hexagonal and round in the plane, a face-centered cubic ball in space."""

    kind: ClassVar[str] = "lattice"
    kinds: ClassVar[tuple[str, ...]] = ("lattice", "grid")
    radius: Annotated[Size | None, Unit("m"), "radius of the patch"] = None
    flat: Annotated[bool, "in the x-y plane, also where the model moves in space"] = False

    def draw(self, count: Amount, axes: Axes) -> Drawing:
        """Take the innermost nodes of a lattice."""
        nodes = _lattice_nodes(count, 2 if self.flat else axes)
        nodes = nodes[farthest_point_sampling(nodes, count)]
        middle = (nodes.min(axis=0) + nodes.max(axis=0)) / 2
        return Drawing(nodes, middle, float(np.linalg.norm(nodes - middle, axis=1).max()))


def embed_in_plane(points: Float[Array, "k 2"], normal: Sequence[float]) -> Float[Array, "k 3"]:
    """Place a flat shape in a plane through the origin.

    The axes of the shape become the axes after that of the normal: (x, y) for a normal along z,
    (y, z) along x, (z, x) along y.
    """
    n = np.array(normal, dtype=float)
    if n.shape != (3,) or not np.isfinite(n).all() or not n.any():
        raise ValueError(f"a plane's normal must be three finite numbers, not all zero: {normal}")
    n /= np.linalg.norm(n)
    first = np.roll(np.eye(3)[int(np.argmax(np.abs(n)))], 1)  # the axis after the normal's own
    first -= (first @ n) * n
    first /= np.linalg.norm(first)
    return np.asarray(points @ np.stack([first, np.cross(n, first)]))


def _lattice_nodes(count: int, dimension: int) -> Float[Array, "count d"]:
    if dimension == 2:
        basis = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
    else:
        basis = np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]]) / np.sqrt(2)
    cells = 2 + round(1.2 * float(count) ** (1 / dimension))
    steps = np.stack(np.meshgrid(*[np.arange(-cells, cells + 1)] * dimension), axis=-1)
    nodes = steps.reshape(-1, dimension) @ basis
    # Distances are rounded so that nodes at the same distance keep their order.
    by_distance = np.argsort(np.round(np.linalg.norm(nodes, axis=1), 9), kind="stable")
    return np.asarray(nodes[by_distance[:count]][golden_ratio_order(count)])
