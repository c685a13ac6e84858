"""Desired formation: a shape and the graph of relative measurements."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy import ndarray as Array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist, squareform

from dynamics.doors import checked
from dynamics.units import Unit

FLATNESS_TOLERANCE = 0.01  # half the range of heights that counts as flat [m]
MAX_COORDINATE = 1e9  # squares must not overflow, and rounding must stay below a meter [m]
COINCIDENCE_TOLERANCE = 1e-9  # of the extent: points closer than this coincide


@checked
@dataclass(frozen=True, eq=False)
class DesiredFormation:
    """Shape and measurement graph of a formation [Lusk2020, sec. II].

    The shape is defined up to translation, rotation about the vertical and separate
    horizontal and vertical scaling. The gains must therefore have the kernel spanned by
    p = x + jy and 1 horizontally (over the complex numbers), and by z and 1 vertically; in a
    flat formation by 1 alone, and its heights count as equal.

    Args:
        points: Points [m].
        graph: Symmetric, False on the diagonal; True for neighbors.
        name: Name in figures.

    Raises:
        ValueError: Points coincide or are not finite, or the graph is asymmetric,
            disconnected or has a vertex of fewer than two neighbors.
    """

    points: Annotated[Float[Array, "n 3"], Unit("m")]
    graph: Bool[Array, "n n"]
    name: str = ""

    def __post_init__(self) -> None:
        """Refuse invalid points and graphs."""
        _validate_points(self.points)
        _validate_graph(self.graph, len(self.points))

    @classmethod
    def with_complete_graph(
        cls, points: Annotated[Float[Array, "n 3"], Unit("m")], name: str = ""
    ) -> "DesiredFormation":
        """Build a formation in which every agent measures every other one.

        Args:
            points: Points [m].
            name: Name in figures.
        """
        return cls(points, ~np.eye(len(points), dtype=bool), name)

    @property
    def edge_count(self) -> int:
        """Number of edges of the graph."""
        return int(self.graph.sum()) // 2

    @property
    def density(self) -> float:
        """Edges of the graph as a share of those of the complete graph."""
        n = len(self.points)
        return 2 * self.edge_count / (n * (n - 1))

    @property
    def planar_points(self) -> Complex[Array, " n"]:
        """Horizontal coordinates of the points, x + jy [m]."""
        return np.asarray(self.points[:, 0] + 1j * self.points[:, 1])

    @property
    def is_flat(self) -> bool:
        """True where the heights count as equal."""
        return bool(np.ptp(self.points[:, 2]) < 2 * FLATNESS_TOLERANCE)

    @cached_property
    def kernel_xy(self) -> Complex[Array, "n r"]:
        """Orthonormal columns, unit vectors that span p = x + jy and 1; 1 alone for a stack."""
        return _kernel_basis(self.planar_points, self._extent)

    @cached_property
    def kernel_z(self) -> Float[Array, "n r"]:
        """Orthonormal columns, unit vectors that span z and 1; 1 alone for a flat formation."""
        heights = np.zeros(len(self.points)) if self.is_flat else self.points[:, 2]
        return _kernel_basis(heights, self._extent)

    @property
    def _extent(self) -> float:
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))


def _kernel_basis(column: Array, extent: float) -> Array:
    # The centered column is orthogonal to 1; it counts where its norm is not rounding.
    ones = np.full(len(column), len(column) ** -0.5, dtype=column.dtype)
    centered = column - column.mean()
    centered = centered - ones * (ones @ centered)  # once more, for points far from the origin
    size = np.linalg.norm(centered)
    columns = [centered / size, ones] if size > COINCIDENCE_TOLERANCE * extent else [ones]
    return np.stack(columns, axis=1)


def _validate_points(points: Array) -> None:
    if len(points) < 3:
        raise ValueError(f"a formation needs at least 3 points, got {len(points)}")
    near = np.abs(points) <= MAX_COORDINATE
    if not near.all():
        i = int(np.argwhere(~near)[0, 0])
        text = f"coordinates must be finite numbers, at most {MAX_COORDINATE:.0e} m"
        raise ValueError(f"point {i} is {points[i]}: {text}")
    apart = squareform(pdist(points))
    np.fill_diagonal(apart, np.inf)
    if apart.min() <= COINCIDENCE_TOLERANCE * apart[np.isfinite(apart)].max():
        i, j = sorted(np.unravel_index(apart.argmin(), apart.shape))
        raise ValueError(f"points {i} and {j} coincide at {points[i]} m: move or drop one of them")


def _validate_graph(graph: Array, n: int) -> None:
    if graph.shape != (n, n):
        raise ValueError(f"{n} points need a graph of {n} × {n}, got {graph.shape}")
    if graph.diagonal().any():
        i = int(np.argmax(graph.diagonal()))
        raise ValueError(f"vertex {i} is its own neighbor: clear the diagonal of the graph")
    if (graph != graph.T).any():
        i, j = np.argwhere(graph & ~graph.T)[0]
        raise ValueError(f"edge {i}–{j} is missing in the other direction: set {j}–{i} too")
    parts, part = connected_components(graph, directed=False)
    if parts > 1:
        apart = _format_vertices(part == np.bincount(part).argmin())
        raise ValueError(f"no edge joins {apart} to the rest of the graph: add at least one")
    is_sparse = graph.sum(axis=1) < 2
    if is_sparse.any():
        where = _format_vertices(is_sparse)
        raise ValueError(f"too sparse at {where}: every vertex needs at least two neighbors")


def _format_vertices(chosen: Array) -> str:
    vertices = np.flatnonzero(chosen)
    shown = ", ".join(map(str, vertices[:10])) + (", …" if len(vertices) > 10 else "")
    return f"{'vertex' if len(vertices) == 1 else 'vertices'} {shown}"
