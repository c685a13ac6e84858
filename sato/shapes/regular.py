"""Rings and lattices."""

from collections.abc import Sequence
from math import asin, floor, isfinite, pi, sin

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.shapes.ordering import farthest_point_sampling, golden_ratio_order
from sato.shapes.placement import Center, UnplacedShape, check_count, place_shape


def ring(
    count: int,
    *,
    spacing: float | None = None,
    radius: float | None = None,
    normal: Sequence[float] | None = None,
    minimum_spacing: float = 0.0,
    center: Center = "origin",
) -> Float[Array, "count d"]:
    """Space targets equally on a circle.

    Args:
        count: Number of targets.
        spacing: Straight distance from one target to the next [m]; or
        radius: Radius of the circle [m].
        normal: Normal of the circle's plane, for a ring in space; without it the ring is in 2-D.
        minimum_spacing: Least distance between two targets that is accepted [m].
        center: Position of the middle of the circle.

    Raises:
        ValueError: The targets would be too close.
    """
    check_count(count)
    angle = 2 * pi / count * golden_ratio_order(count)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    circle = circle[farthest_point_sampling(circle, count).indices]
    nodes = circle if normal is None else embed_in_plane(circle, normal)
    shape = UnplacedShape(
        "the ring", nodes, np.zeros(nodes.shape[1]), "radius", 1.0, _max_count_on_circle
    )
    return place_shape(
        shape, spacing=spacing, size=radius, minimum_spacing=minimum_spacing, center=center
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
    """Pack targets as densely as their spacing allows.

    In 2-D they are a round patch of the hexagonal lattice, in 3-D a ball of the face-centered
    cubic lattice.

    Args:
        count: Number of targets.
        dimension: 2 or 3.
        spacing: Distance from a target to its nearest neighbors [m]; or
        radius: Distance of the outermost target from the middle of the bounding box [m].
        minimum_spacing: Least distance between two targets that is accepted [m].
        center: Position of the middle of the bounding box.

    Raises:
        ValueError: The dimension is neither 2 nor 3, or the targets would be too close.
    """
    check_count(count)
    if dimension not in (2, 3):
        raise ValueError(f"a lattice is in 2 or 3 dimensions, got {dimension}")
    nodes = _lattice_nodes(count, dimension)
    nodes = nodes[farthest_point_sampling(nodes, count).indices]
    middle = (nodes.min(axis=0) + nodes.max(axis=0)) / 2
    drawn_radius = float(np.linalg.norm(nodes - middle, axis=1).max())
    shape = UnplacedShape("the lattice", nodes, middle, "radius", drawn_radius)
    return place_shape(
        shape, spacing=spacing, size=radius, minimum_spacing=minimum_spacing, center=center
    )


def embed_in_plane(points: Float[Array, "k 2"], normal: Sequence[float]) -> Float[Array, "k 3"]:
    """Place a flat shape in a plane through the origin.

    The axes of the shape become the axes after that of the normal: (x, y) for a normal along z,
    (y, z) along x, (z, x) along y.

    Raises:
        ValueError: The normal is not three finite numbers, or is zero.
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
    # Neighbors on a circle of radius 1 are a chord of 2 sin(π / count) apart.
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
    # Distances are rounded so that nodes at the same distance keep their order.
    by_distance = np.argsort(np.round(np.linalg.norm(nodes, axis=1), 9), kind="stable")
    return np.asarray(nodes[by_distance[:count]][golden_ratio_order(count)])
