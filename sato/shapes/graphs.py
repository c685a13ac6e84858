"""Graphs of a formation: from edges, from files and at random."""

from collections.abc import Sequence
from math import ceil
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.shapes.point_files import read_rows

RING_NEIGHBORS = 4  # neighbors of every vertex in the ring that connects a sparse graph


def graph_from_edges(count: int, edges: Sequence[Sequence[int]]) -> Bool[Array, "n n"]:
    """Return the adjacency matrix of a graph with these edges."""
    graph = np.zeros((count, count), dtype=bool)
    i, j = np.array(edges).T
    graph[i, j] = graph[j, i] = True
    return graph


def read_graph(path: str | Path, count: int) -> Bool[Array, "count count"]:
    """Read the edges of a graph from a CSV file: two vertices a line, numbered from 0.

    Neither the order of the two matters nor an edge that is repeated. A first line may name the
    columns; empty lines and lines that begin with # are skipped.

    Args:
        path: The file.
        count: Number of vertices.

    Raises:
        ValueError: The file cannot be read, or a line is not an edge between two of the vertices.
    """
    path = Path(path)
    rows = read_rows(
        path, "pairs of vertices", lambda cells: len(cells) == 2 and all(map(str.isalpha, cells))
    )
    return graph_from_edges(
        count, [_parse_edge(f"{path}, line {number}", cells, count) for number, cells in rows]
    )


def random_dense_graph(
    count: int, removals: int, rng: np.random.Generator
) -> Bool[Array, "count count"]:
    """Return the complete graph without some random edges.

    As in the trials of [Lusk2020], a removal may repeat another or join a vertex to itself, and
    then removes nothing; there, the number of removals is drawn from 1 to count − 4.
    """
    graph = ~np.eye(count, dtype=bool)
    i, j = rng.integers(count, size=(2, removals))
    graph[i, j] = graph[j, i] = False
    return graph


def random_sparse_graph(
    points: Float[Array, "n d"], share: float, rng: np.random.Generator
) -> Bool[Array, "n n"]:
    """Return a random graph with a share of all edges that has stabilizing gains.

    The graph contains a ring in which the two vertices before and the two after each are its
    neighbors; the other edges are drawn. For the triangle of each vertex and the two before it,
    take w with w·p = 0 and w·1 = 0. Then L = Σ w wᴴ is positive semidefinite, and its kernel is
    spanned by p and 1 alone if the two before never have the same p, because their values
    determine all that follow. In the plane this requires that no point is above another; for the
    heights, the ring alternates between low and high points, and fewer than half of the points
    may have the same height, or all of them.

    Args:
        points: Points of the formation, at least four [m].
        share: Share of the n (n − 1) / 2 edges of the complete graph.
        rng: Generator for the ring and the other edges.

    Raises:
        ValueError: The share is more than all edges or less than the ring.
    """
    n = len(points)
    if n < 4:
        raise ValueError(f"a sparse graph needs at least 4 points, got {n}")
    complete = n * (n - 1) // 2
    graph = _ring_graph(points, rng)
    least, edges = int(graph.sum()) // 2, round(share * complete)
    if not least <= edges <= complete:
        raise ValueError(
            f"a share of {share:g} of the {complete} edges between {n} points makes {edges}, and "
            f"the graph needs {least} to have stabilizing gains and has {complete} at most: "
            f"{ceil(1e4 * least / complete) / 1e4:g} to 1 would do"
        )
    i, j = np.nonzero(np.triu(~graph, 1))
    added = rng.choice(len(i), size=edges - least, replace=False)
    graph[i[added], j[added]] = graph[j[added], i[added]] = True
    return graph


def _ring_graph(points: Float[Array, "n d"], rng: np.random.Generator) -> Bool[Array, "n n"]:
    n = len(points)
    height = points[:, 2] if points.shape[1] == 3 else np.zeros(n)
    shuffled = rng.permutation(n)
    upward = shuffled[np.argsort(height[shuffled], kind="stable")]
    ring = np.empty(n, dtype=int)
    ring[::2], ring[1::2] = upward[: (n + 1) // 2], upward[(n + 1) // 2 :]
    graph = np.zeros((n, n), dtype=bool)
    for step in range(1, RING_NEIGHBORS // 2 + 1):
        after = np.roll(ring, step)
        graph[ring, after] = graph[after, ring] = True
    return graph & ~np.eye(n, dtype=bool)


def _parse_edge(where: str, cells: list[str], count: int) -> list[int]:
    if len(cells) != 2:
        raise ValueError(f"{where}: a pair of vertices is needed, got {len(cells)} columns")
    try:
        edge = [int(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(
            f"{where}: vertices are whole numbers, got {', '.join(cells)} "
            "(a first line may name the columns, vertex,neighbor)"
        ) from error
    for vertex in edge:
        if not 0 <= vertex < count:
            raise ValueError(
                f"{where}: there is no vertex {vertex}: the {count} points are numbered from 0 to "
                f"{count - 1}"
            )
    if edge[0] == edge[1]:
        raise ValueError(f"{where}: vertex {edge[0]} cannot be its own neighbor; drop the line")
    return edge
