"""Formations by name, of any points and from files, and their graphs."""

import re
import tomllib
from difflib import get_close_matches
from functools import cache
from math import ceil
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from numpy.random import Generator

from dynamics.doors import checked
from dynamics.inputs import InputError
from problems.desired_formation import DesiredFormation
from sato.scenario.csv_file import read_rows
from sato.scenario.errors import join_names
from sato.shapes.shape import read_states

LIBRARY_FILE = Path(__file__).with_name("formations.toml")
VERTEX = re.compile(  # names of the two columns of a list of edges
    r"(vertex|node|point|agent|vehicle|robot|drone|neighbou?r|source|target|from|to|start|end|"
    r"tail|head|first|second)?[_ ]?(id|index|[a-v]|\d|one|two)?",
    re.IGNORECASE,
)


def formation_names() -> tuple[str, ...]:
    """Return the names of the library, group and formation: "swarm4/Square"."""
    return tuple(_load_library())


@checked
def load_formation(name: str, graph: Literal["own", "complete"] = "own") -> DesiredFormation:
    """Load a formation of the library, with its own graph or the complete one.

    Names are those of `formation_names()`, in any case; the part before or after the slash is
    enough where only one name has it. The own graph of most formations is complete.
    """
    full_name = _match_name(name)
    entry = _load_library()[full_name]
    if sheet := entry.get("sheet"):
        # The last line of the drawing is the nearest and the lowest.
        lines = enumerate(sheet["drawing"].splitlines()[::-1])
        cells = [(x, y) for y, line in lines for x, mark in enumerate(line) if mark == "#"]
        x, y = np.array(cells).T * np.array([[sheet["column_m"]], [sheet["row_m"]]])
        points = np.stack([x, y, sheet["slope"] * y], axis=1)
    else:
        points = np.array(entry["points_m"])
    adjacency = None
    if graph == "own" and "share" in entry:
        rng = np.random.default_rng(entry["seed"])
        adjacency = random_sparse_graph(points, entry["share"], rng)
    elif graph == "own" and "edges" in entry:
        adjacency = graph_from_edges(len(points), np.array(entry["edges"]))
    return make_formation(points, adjacency, full_name)


@checked
def make_formation(
    points: Float[Array, "n d"], graph: Bool[Array, "n n"] | None = None, name: str = ""
) -> DesiredFormation:
    """Make a formation of any points [m], as from `sato.shapes`; flat ones get height 0.

    Its graph is complete where there is no adjacency matrix. The name is for tables and files.
    """
    if points.shape[1] not in (2, 3):
        raise ValueError(f"points have two or three coordinates, got {points.shape[1]}")
    in_space = np.zeros((len(points), 3))
    in_space[:, : points.shape[1]] = points
    if graph is None:
        return DesiredFormation.with_complete_graph(in_space, name)
    return DesiredFormation(in_space, graph, name)


@checked
def read_formation(path: str | Path) -> DesiredFormation:
    """Read a formation from a file of points: x, y, z or x, y in meters, a line each.

    Its graph is complete, and its name is that of the file.
    """
    path = Path(path)
    points, velocities = read_states(path)
    if velocities is not None:
        raise ValueError(f"{path}: has velocities, and these points are at rest; drop its vx")
    try:
        return make_formation(points, name=path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


@cache
def _load_library() -> dict[str, dict[str, Any]]:
    return tomllib.loads(LIBRARY_FILE.read_text(encoding="utf-8"))


def _match_name(name: str) -> str:
    full_names = {known.lower(): known for known in _load_library()}
    given = name.lower()
    if given in full_names:
        return full_names[given]
    matches = [full_names[known] for known in full_names if given in known.split("/")]
    if len(matches) == 1:
        return matches[0]
    parts = {part: known for known in full_names for part in (*known.split("/"), known)}
    close = [full_names[parts[part]] for part in get_close_matches(given, parts, n=3, cutoff=0.5)]
    options = matches or list(dict.fromkeys(close)) or list(_load_library())
    raise ValueError(f'the library has no formation "{name}"; did you mean {join_names(options)}?')


@checked
def graph_from_edges(count: int, edges: Int[Array, "edges 2"]) -> Bool[Array, "n n"]:
    """Return the adjacency matrix of a graph with these edges."""
    i, j = edges.T
    if count < 1 or min([*i, *j, 0]) < 0 or max([*i, *j, 0]) >= count:
        raise InputError("edges", f"must join vertices from 0 on, below count = {count}")
    graph = np.zeros((count, count), dtype=bool)
    graph[i, j] = graph[j, i] = True
    return graph


@checked
def read_graph(path: str | Path, count: int) -> Bool[Array, "count count"]:
    """Read the edges of a graph from a CSV file: two vertices a line, numbered from 0.

    Neither the order of the two matters nor an edge that is repeated. A first line may name the
    two columns, vertex,neighbor or i,j; a first line 0,1 is an edge. The count is that of vertices.
    """
    edges = []
    names, rows = read_rows(Path(path), "pairs of vertices", {})
    wrong = [name for name in names or () if not VERTEX.fullmatch(name)]
    if wrong or len(set(names or "ij")) != 2:
        found = (
            f'column "{wrong[0]}" is none of two vertices' if wrong else "two columns are needed"
        )
        raise ValueError(f"{path}: {found}; a header such as vertex,neighbor would do")
    for number, cells in rows:
        where = f"{path}, line {number}"
        try:
            i, j = (int(cell) for cell in cells)
        except ValueError as error:
            needed = "a pair of whole numbers is needed"
            hint = "a first line may name the columns, vertex,neighbor"
            found = f"got {len(cells)}: {', '.join(cells)}"
            raise ValueError(f"{where}: {needed}, {found} ({hint})") from error
        if outside := [vertex for vertex in (i, j) if not 0 <= vertex < count]:
            numbered = f"the {count} points are numbered from 0 to {count - 1}"
            raise ValueError(f"{where}: there is no vertex {outside[0]}: {numbered}")
        if i == j:
            raise ValueError(f"{where}: vertex {i} cannot be its own neighbor; drop the line")
        edges.append((i, j))
    return graph_from_edges(count, np.array(edges, dtype=int).reshape(-1, 2))


@checked
def random_dense_graph(count: int, removals: int, rng: Generator) -> Bool[Array, "count count"]:
    """Return the complete graph without some random edges.

    As in the trials of [Lusk2020], a removal may repeat another or join a vertex to itself, and
    then removes nothing; there, the number of removals is drawn from 1 to count − 4.
    """
    graph = ~np.eye(count, dtype=bool)
    i, j = rng.integers(count, size=(2, removals))
    graph[i, j] = graph[j, i] = False
    return graph


@checked
def random_sparse_graph(
    points: Float[Array, "n d"], share: float, rng: Generator
) -> Bool[Array, "n n"]:
    """Return a random graph with a share of all n (n − 1) / 2 edges that has stabilizing gains.

    The graph contains a ring in which the two vertices before and the two after each are its
    neighbors; the other edges are drawn. For the triangle of each vertex and the two before it,
    take w with w·p = 0 and w·1 = 0. Then L = Σ w wᴴ is positive semidefinite, and its kernel is
    spanned by p and 1 alone if the two before never have the same p, because their values
    determine all that follow. In the plane this requires that no point is above another; for the
    heights, the ring alternates between low and high points, and fewer than half of the points
    may have the same height, or all of them.
    There are four points or more, and edges enough for the ring.
    """
    n = len(points)
    if n < 4:
        raise ValueError(f"a sparse graph needs at least 4 points, got {n}")
    complete = n * (n - 1) // 2
    height = points[:, 2] if points.shape[1] == 3 else np.zeros(n)
    shuffled = rng.permutation(n)
    upward = shuffled[np.argsort(height[shuffled], kind="stable")]
    ring = np.empty(n, dtype=int)
    ring[::2], ring[1::2] = upward[: (n + 1) // 2], upward[(n + 1) // 2 :]
    graph = np.zeros((n, n), dtype=bool)
    for step in (1, 2):
        after = np.roll(ring, step)
        graph[ring, after] = graph[after, ring] = True
    np.fill_diagonal(graph, False)
    least, edges = int(graph.sum()) // 2, round(share * complete)
    if not least <= edges <= complete:
        found = f"a share of {share:g} of the {complete} edges between {n} points makes {edges}"
        needed = f"{least} to have stabilizing gains and has {complete} at most"
        cure = f"{ceil(1e4 * least / complete) / 1e4:g} to 1 would do"
        raise ValueError(f"{found}, and the graph needs {needed}: {cure}")
    i, j = np.nonzero(np.triu(~graph, 1))
    added = rng.choice(len(i), size=edges - least, replace=False)
    graph[i[added], j[added]] = graph[j[added], i[added]] = True
    return graph
