"""Formations by name, of any points, and from files."""

import tomllib
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.desired_formation import DesiredFormation
from sato.shapes.graphs import graph_from_edges, random_sparse_graph
from sato.shapes.point_files import read_points

LIBRARY_FILE = Path(__file__).with_name("formations.toml")


def formation_names() -> tuple[str, ...]:
    """Return the names of the library, group and formation: "swarm4/Square"."""
    return tuple(_load_library())


def load_formation(name: str, graph: str = "own") -> DesiredFormation:
    """Load a formation of the library, with its own graph or the complete one.

    Args:
        name: One of `formation_names()`, in any case; the part before or after the slash is
            enough where only one name has it.
        graph: "own" or "complete"; the own graph of most formations is complete.

    Raises:
        ValueError: The library has no such name; the message lists similar ones.
    """
    if graph not in ("own", "complete"):
        raise ValueError(f'a formation has its "own" graph or the "complete" one, not "{graph}"')
    full_name = _match_name(name)
    entry = _load_library()[full_name]
    points = _parse_drawing(**entry["sheet"]) if "sheet" in entry else np.array(entry["points_m"])
    adjacency = None
    if graph == "own" and "share" in entry:
        rng = np.random.default_rng(entry["seed"])
        adjacency = random_sparse_graph(points, entry["share"], rng)
    elif graph == "own" and "edges" in entry:
        adjacency = graph_from_edges(len(points), entry["edges"])
    return make_formation(points, adjacency, full_name)


def make_formation(
    points: Float[Array, "n d"], graph: Bool[Array, "n n"] | None = None, name: str = ""
) -> DesiredFormation:
    """Make a formation of any points; flat ones get height 0.

    Args:
        points: Positions in two or three coordinates [m], as from the shapes of `sato.shapes`.
        graph: Adjacency matrix; the complete graph without it.
        name: Name for tables and files.

    Raises:
        ValueError: Points or graph make no formation.
    """
    if points.shape[1] not in (2, 3):
        raise ValueError(f"points have two or three coordinates, got {points.shape[1]}")
    in_space = np.zeros((len(points), 3))
    in_space[:, : points.shape[1]] = points
    if graph is None:
        return DesiredFormation.with_complete_graph(in_space, name)
    return DesiredFormation(in_space, graph, name)


def read_formation(path: str | Path) -> DesiredFormation:
    """Read a formation from a file of points: x, y, z or x, y in meters, a line each.

    Its graph is complete, and its name is that of the file.

    Raises:
        ValueError: The file cannot be read, or its points make no formation.
    """
    path = Path(path)
    points = read_points(path)
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
    raise ValueError(
        f'the library has no formation "{name}"; did you mean '
        f"{', '.join(options[:-1])}{' or ' * (len(options) > 1)}{options[-1]}?"
    )


def _parse_drawing(
    *, drawing: str, column_m: float, row_m: float, slope: float
) -> Float[Array, "count 3"]:
    # The last line of the drawing is the nearest and the lowest.
    lines = drawing.splitlines()[::-1]
    cells = [(x, y) for y, line in enumerate(lines) for x, mark in enumerate(line) if mark == "#"]
    x, y = np.array(cells).T * np.array([[column_m], [row_m]])
    return np.stack([x, y, slope * y], axis=1)
