"""Rigidity of measurement graphs in the plane or in space, by rank tests.

A guide for drawing graphs, and no condition for gains: gains rotate and scale measured
positions instead of keeping distances. [Lusk2020] requires universal rigidity, which is
sufficient. Less may do: a pyramid with too few edges to be rigid in the plane has horizontal
gains. And rigidity is not sufficient: two levels of three agents that measure only each other
have none. `gain_design` decides whether there are gains.

Rigid: no infinitesimal motion keeps all lengths. Redundantly rigid: rigid after the loss of any
one edge. Globally rigid: no other shape has the same lengths. All three are properties of a
graph at points in general position, where almost all points give the same answer.
"""

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.linalg import null_space

from dynamics.doors import checked
from dynamics.inputs import check_symmetric

RANK_TOLERANCE = 1e-9  # relative: smaller singular values are zeros with rounding errors
Dimension = Literal[2, 3]
Graph = Bool[Array, "n n"]


def rigidity_matrix(points: Float[Array, "n d"], graph: Graph) -> Float[Array, "edges n*d"]:
    """Differentiate half the squared length of each edge with respect to the points.

    The row of edge i–j, i < j, holds p_i − p_j in the columns of i and p_j − p_i in those of j.
    """
    n, d = points.shape
    i, j = np.nonzero(np.triu(graph, 1))
    rows = np.arange(len(i))
    R = np.zeros((len(i), n, d))
    R[rows, i] = points[i] - points[j]
    R[rows, j] = points[j] - points[i]
    return R.reshape(len(i), n * d)


@checked
def is_rigid(graph: Graph, dimension: Dimension, rng: np.random.Generator) -> bool:
    """Return True where the graph is rigid at points in general position."""
    return _is_rigid(graph, dimension, _self_stresses(graph, dimension, rng))


@checked
def is_redundantly_rigid(graph: Graph, dimension: Dimension, rng: np.random.Generator) -> bool:
    """Return True where the graph stays rigid, in general position, without any one edge.

    An edge is redundant if and only if some equilibrium stress loads it: then its row of the
    rigidity matrix is a combination of the others.
    """
    stresses = _self_stresses(graph, dimension, rng)
    loads = np.abs(stresses).max(axis=1, initial=0.0)
    return _is_rigid(graph, dimension, stresses) and bool((loads > RANK_TOLERANCE).all())


@checked
def is_globally_rigid(graph: Graph, dimension: Dimension, rng: np.random.Generator) -> bool:
    """Return True where the lengths fix the shape, in general position, up to congruence.

    That holds if and only if the matrix of a random equilibrium stress has rank n − d − 1
    [Gortler2010]; up to d + 1 points, if and only if the graph is complete.
    """
    n = len(graph)
    if n <= dimension + 1:
        return bool((graph | np.eye(n, dtype=bool)).all())
    stresses = _self_stresses(graph, dimension, rng)
    stress = stresses @ rng.normal(size=stresses.shape[1])
    i, j = np.nonzero(np.triu(graph, 1))
    Ω = np.zeros((n, n))
    Ω[i, j] = Ω[j, i] = -stress
    Ω[np.diag_indices(n)] = -Ω.sum(axis=1)
    return int(np.linalg.matrix_rank(Ω, rtol=RANK_TOLERANCE)) == n - dimension - 1


def _is_rigid(graph: Array, dimension: int, stresses: Array) -> bool:
    # All motions that keep the lengths are of the shape as a whole.
    n = len(graph)
    rank, motions = len(stresses) - stresses.shape[1], dimension * (dimension + 1) // 2
    return bool(rank == (dimension * n - motions if n > dimension else n * (n - 1) // 2))


def _self_stresses(graph: Array, dimension: int, rng: np.random.Generator) -> Array:
    # Columns span the stresses that are in equilibrium at points in general position.
    check_symmetric("graph", graph)
    points = rng.normal(size=(len(graph), dimension))
    stresses: Array = null_space(rigidity_matrix(points, graph).T, rcond=RANK_TOLERANCE)
    return stresses
