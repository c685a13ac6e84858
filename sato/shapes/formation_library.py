"""Formations by name, and of any points."""

import tomllib
from collections.abc import Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.desired_formation import DesiredFormation
from sato.shapes.random_points import random_sparse_graph

LIBRARY_FILE = Path(__file__).with_name("formations.toml")


def formation_names() -> tuple[str, ...]:
    """The names of the library, group and formation: "swarm4/Square"."""
    return tuple(_load_library())


def load_formation(name: str, graph: str = "own") -> DesiredFormation:
    """A formation of the library, with its own graph or the complete one.

    Args:
        name: As in `formations()`, in capitals or not; the part before or after the stroke will
            do where it is the only one of its kind.
        graph: "own" or "complete"; the own graph of most is complete.

    Raises:
        ValueError: The library has no such name; the message has those that are close.
    """
    if graph not in ("own", "complete"):
        raise ValueError(f'a formation has its "own" graph or the "complete" one, not "{graph}"')
    meant = _match_name(name)
    entry = _load_library()[meant]
    points = _parse_drawing(**entry["sheet"]) if "sheet" in entry else np.array(entry["points_m"])
    if graph == "complete":
        return DesiredFormation.with_complete_graph(points, meant)
    if "share" in entry:
        rng = np.random.default_rng(entry["seed"])
        return DesiredFormation(points, random_sparse_graph(points, entry["share"], rng), meant)
    if "edges" in entry:
        return DesiredFormation(points, graph_from_edges(len(points), entry["edges"]), meant)
    return DesiredFormation.with_complete_graph(points, meant)


def make_formation(
    points: Float[Array, "n d"], graph: Bool[Array, "n n"] | None = None, name: str = ""
) -> DesiredFormation:
    """A formation of any points, as the shapes of `sato.shapes`; flat ones stand at height 0.

    Args:
        points: In two or three coordinates [m].
        graph: Who measures whom; without it, everybody measures everybody.
        name: For tables and files.

    Raises:
        ValueError: Points or graph make no formation.
    """
    if points.shape[1] not in (2, 3):
        raise ValueError(f"points have two or three coordinates, got {points.shape[1]}")
    stood = np.zeros((len(points), 3))
    stood[:, : points.shape[1]] = points
    return (
        DesiredFormation.with_complete_graph(stood, name)
        if graph is None
        else DesiredFormation(stood, graph, name)
    )


def graph_from_edges(count: int, pairs: Sequence[Sequence[int]]) -> Bool[Array, "n n"]:
    """The graph with these edges."""
    graph = np.zeros((count, count), dtype=bool)
    i, j = np.array(pairs).T
    graph[i, j] = graph[j, i] = True
    return graph


@cache
def _load_library() -> dict[str, dict[str, Any]]:
    return tomllib.loads(LIBRARY_FILE.read_text(encoding="utf-8"))


def _match_name(name: str) -> str:
    spelt = {known.lower(): known for known in _load_library()}
    asked = name.lower()
    if asked in spelt:
        return spelt[asked]
    parts = [spelt[known] for known in spelt if asked in known.split("/")]
    if len(parts) == 1:
        return parts[0]
    halves = {half: known for known in spelt for half in (*known.split("/"), known)}
    close = [spelt[halves[near]] for near in get_close_matches(asked, halves, n=3, cutoff=0.5)]
    some = parts or list(dict.fromkeys(close)) or list(_load_library())
    raise ValueError(
        f'the library has no formation "{name}"; did you mean '
        f"{', '.join(some[:-1])}{' or ' * (len(some) > 1)}{some[-1]}?"
    )


def _parse_drawing(
    *, drawing: str, column_m: float, row_m: float, slope: float
) -> Float[Array, "count 3"]:
    # The last line is nearest and lowest.
    lines = drawing.splitlines()[::-1]
    cells = [(x, y) for y, line in enumerate(lines) for x, mark in enumerate(line) if mark == "#"]
    x, y = np.array(cells).T * np.array([[column_m], [row_m]])
    return np.stack([x, y, slope * y], axis=1)
