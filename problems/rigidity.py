"""Whether distances along the edges hold a formation together, in the plane or in space.

Help for who draws a graph, and no condition for gains: these turn and scale what they see
instead of keeping distances. [Lusk2020] asks for universal rigidity, which is enough. Less may
do: a pyramid with too few edges to be rigid even from above has gains in the plane. And to be
rigid is not enough: two storeys of three that see only each other have none. Whether there are
gains is answered by designing them.

Three questions, each harder than the one before. Rigid: no small motion keeps all lengths.
Redundantly rigid: nor does one if any one edge is lost. Globally rigid: no other shape at
all has the same lengths. Of a graph they are asked at points in general position, where
almost all points give the same answer; a special position, as flat or symmetric, may move
where others do not, and `flexes` tells how.
"""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.linalg import null_space

RANK_TOLERANCE = 1e-9  # relative: singular values below are zeros, rounded
Dimension = Literal[2, 3]


def rigidity_matrix(
    points: Float[Array, "n d"], graph: Bool[Array, "n n"]
) -> Float[Array, "edges n*d"]:
    """How fast half the squared length of each edge changes with the points.

    The row of edge i–j holds p_i − p_j at the columns of i and p_j − p_i at those of j; rows
    are in the order of `edges`.
    """
    n, d = points.shape
    i, j = edges(graph)
    rows = np.arange(len(i))
    R = np.zeros((len(i), n, d))
    R[rows, i] = points[i] - points[j]
    R[rows, j] = points[j] - points[i]
    return R.reshape(len(i), n * d)


def edges(graph: Bool[Array, "n n"]) -> tuple[Array, Array]:
    """The two ends of every edge, the lower number first."""
    i, j = np.nonzero(np.triu(graph, 1))
    return i, j


def infinitesimal_flexes(
    points: Float[Array, "n d"], graph: Bool[Array, "n n"]
) -> Float[Array, "flexes n d"]:
    """The ways in which the points can start to move with all lengths kept.

    Motions of the shape as a whole are left out: those given are orthogonal to them and to
    each other. A flat shape of n points has at least n − 3 of them in space, whatever its
    graph, since nothing holds its points in the plane at first order.
    """
    n, d = points.shape
    shape = (points - points.mean(axis=0)) / max(float(np.ptp(points, axis=0).max()), 1e-300)
    shifts = np.tile(np.eye(d), n)
    turns = np.zeros((d * (d - 1) // 2, n, d))
    for k, (a, b) in enumerate(zip(*np.triu_indices(d, 1), strict=True)):
        turns[k, :, a], turns[k, :, b] = -shape[:, b], shape[:, a]
    held = np.vstack([rigidity_matrix(shape, graph), shifts, turns.reshape(len(turns), -1)])
    return np.ascontiguousarray(null_space(held, rcond=RANK_TOLERANCE).T).reshape(-1, n, d)


def is_infinitesimally_rigid(points: Float[Array, "n d"], graph: Bool[Array, "n n"]) -> bool:
    """Whether the shape, where it is, cannot start to move with all lengths kept."""
    return len(infinitesimal_flexes(points, graph)) == 0


def is_rigid(graph: Bool[Array, "n n"], dimension: Dimension, rng: np.random.Generator) -> bool:
    """Whether the graph is rigid at points in general position."""
    return is_infinitesimally_rigid(_generic_points(graph, dimension, rng), graph)


def is_redundantly_rigid(
    graph: Bool[Array, "n n"], dimension: Dimension, rng: np.random.Generator
) -> bool:
    """Whether the graph stays rigid, in general position, when any one of its edges is lost.

    An edge can be spared if and only if some stress of the edges, in equilibrium at every
    point, loads it: then the row of the edge is a combination of the others.
    """
    points = _generic_points(graph, dimension, rng)
    loads = np.abs(_self_stresses(points, graph)).max(axis=1, initial=0.0)
    return is_infinitesimally_rigid(points, graph) and bool((loads > RANK_TOLERANCE).all())


def is_globally_rigid(
    graph: Bool[Array, "n n"], dimension: Dimension, rng: np.random.Generator
) -> bool:
    """Whether its lengths fix the shape, in general position, up to motions and mirroring.

    So it is if and only if a stress of the edges at random has a matrix of rank n − d − 1
    [Gortler2010]; up to d + 1 points, if the graph is complete.
    """
    n = len(graph)
    if n <= dimension + 1:
        return bool((graph | np.eye(n, dtype=bool)).all())
    stresses = _self_stresses(_generic_points(graph, dimension, rng), graph)
    load = stresses @ rng.normal(size=stresses.shape[1])
    i, j = edges(graph)
    Ω = np.zeros((n, n))
    Ω[i, j] = Ω[j, i] = -load
    Ω[np.diag_indices(n)] = -Ω.sum(axis=1)
    return int(np.linalg.matrix_rank(Ω, rtol=RANK_TOLERANCE)) == n - dimension - 1


def _generic_points(graph: Array, dimension: int, rng: np.random.Generator) -> Array:
    return rng.normal(size=(len(graph), dimension))


def _self_stresses(points: Array, graph: Array) -> Array:
    # Columns span the loads of the edges that are in equilibrium at every point.
    loads: Array = null_space(rigidity_matrix(points, graph).T, rcond=RANK_TOLERANCE)
    return loads
