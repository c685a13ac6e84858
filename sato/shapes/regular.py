"""Rings and lattices."""

from collections.abc import Sequence
from math import asin, floor, isfinite, pi, sin

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.shapes.ordering import farthest_point_sampling, golden_ratio_order
from sato.shapes.placement import Center, UnplacedShape, check_count, check_size_given, place_shape


def ring(
    count: int,
    *,
    spacing: float | None = None,
    radius: float | None = None,
    normal: Sequence[float] | None = None,
    minimum_spacing: float = 0.0,
    center: Center = "origin",
) -> Float[Array, "count d"]:
    """Targets at equal distances on a circle.

    Args:
        count: How many targets.
        spacing: Straight distance from one target to the next [m]; or
        radius: Of the circle [m].
        normal: Of the circle's plane, for a ring in space; without it the ring is in 2-D.
        minimum_spacing: Refuse targets that stand closer [m].
        centre: Where the middle of the circle goes.

    Raises:
        ValueError: The targets would stand too close.
    """
    check_count(count)
    check_size_given("radius", spacing, radius)
    angle = 2 * pi / count * golden_ratio_order(count)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    circle = circle[farthest_point_sampling(circle, count).indices]
    flat = circle if normal is None else embed_in_plane(circle, normal)
    draft = UnplacedShape(
        "the ring", flat, np.zeros(flat.shape[1]), "radius", 1.0, _max_count_on_circle
    )
    return place_shape(
        draft, spacing=spacing, size=radius, minimum_spacing=minimum_spacing, center=center
    )


def lattice(
    count: int,
    *,
    dimension: int = 2,
    spacing: float | None = None,
    radius: float | None = None,
    minimum_spacing: float = 0.0,
    center: Center = "origin",
) -> Float[Array, "count d"]:
    """Targets packed as densely as their spacing allows.

    In 2-D a round patch of the hexagonal lattice, in 3-D a ball of the face-centred cubic one.

    Args:
        count: How many targets.
        dimension: 2 or 3.
        spacing: Distance from a target to its nearest neighbours [m]; or
        radius: Of the outermost target from the middle of the bounding box [m].
        minimum_spacing: Refuse targets that stand closer [m].
        centre: Where the middle of the bounding box goes.

    Raises:
        ValueError: Neither 2-D nor 3-D, or the targets would stand too close.
    """
    check_count(count)
    check_size_given("radius", spacing, radius)
    if dimension not in (2, 3):
        raise ValueError(f"a lattice is in 2 or 3 dimensions, got {dimension}")
    nodes = _lattice_nodes(count, dimension)
    nodes = nodes[farthest_point_sampling(nodes, count).indices]
    middle = (nodes.min(axis=0) + nodes.max(axis=0)) / 2
    reach = float(np.linalg.norm(nodes - middle, axis=1).max())
    draft = UnplacedShape("the lattice", nodes, middle, "radius", reach)
    return place_shape(
        draft, spacing=spacing, size=radius, minimum_spacing=minimum_spacing, center=center
    )


def embed_in_plane(points: Float[Array, "k 2"], normal: Sequence[float]) -> Float[Array, "k 3"]:
    """Lay a flat shape into a plane through the origin.

    The shape's own axes become those that turn with the normal: (x, y) for a normal along z,
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


def _max_count_on_circle(spacing: float) -> int:
    # Chord 2 sin(π / count) on a circle of radius 1.
    if not isfinite(spacing) or spacing > 2:
        return 1
    count = floor(pi / asin(spacing / 2) + 1)
    return count if 2 * sin(pi / count) >= spacing else count - 1


def _lattice_nodes(count: int, dimension: int) -> Float[Array, "count d"]:
    if dimension == 2:
        basis = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
        cells = 2 + round(1.2 * float(count) ** 0.5)
    else:
        basis = np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]]) / np.sqrt(2)
        cells = 2 + round(1.2 * float(count) ** (1 / 3))
    steps = np.stack(np.meshgrid(*[np.arange(-cells, cells + 1)] * dimension), axis=-1)
    nodes = steps.reshape(-1, dimension) @ basis
    # Rounded, so that nodes at one distance are equal in it and keep their order.
    near = np.argsort(np.round(np.linalg.norm(nodes, axis=1), 9), kind="stable")
    return np.asarray(nodes[near[:count]][golden_ratio_order(count)])
