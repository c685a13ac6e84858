"""Formations and graphs as files: CSV of points in metres, CSV of pairs of vertices."""

import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.desired_formation import DesiredFormation
from sato.shapes.formation_library import graph_from_edges, make_formation
from sato.shapes.point_files import data_lines, read_points


def read_formation(path: str | Path) -> DesiredFormation:
    """The formation of a file of points: x, y, z or x, y in metres, a line each.

    Everybody measures everybody; see `with_graph`. The name is that of the file.

    Raises:
        ValueError: The file cannot be read, or its points make no formation.
    """
    path = Path(path)
    points = read_points(path)
    try:
        return make_formation(points, name=path.stem)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_with_graph(formation: DesiredFormation, path: str | Path) -> DesiredFormation:
    """The same points with the graph of a file, see `read_graph`.

    Raises:
        ValueError: The file cannot be read, or its graph does not hold the formation together.
    """
    graph = read_graph(path, len(formation.points))
    try:
        return replace(formation, graph=graph)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_graph(path: str | Path, count: int) -> Bool[Array, "count count"]:
    """The graph of a file of pairs: two vertices a line, counted from 0, who measure each other.

    The order of the two is nothing, nor is a pair that comes twice. A first line may name the
    columns; empty lines and lines that begin with # are skipped.

    Args:
        path: The file.
        count: How many vertices there are.

    Raises:
        ValueError: The file cannot be read, or a line is no pair of them.
    """
    path = Path(path)
    pairs: list[list[int]] = []
    first = True
    for number, line in data_lines(path, "pairs"):
        cells = [cell.strip() for cell in next(csv.reader([line]))]
        titled = first and len(cells) == 2 and all(cell.isalpha() for cell in cells)
        first = False
        if not titled:
            pairs.append(_parse_edge(f"{path}, line {number}", cells, count))
    if not pairs:
        raise ValueError(f"{path} lists no pairs of vertices")
    return graph_from_edges(count, pairs)


def write_points(path: str | Path, points: Float[Array, "n d"]) -> None:
    """Points in two or three coordinates [m], to the last bit."""
    titles = "x_m,y_m,z_m".split(",")[: points.shape[1]]
    _write_csv(Path(path), titles, points.tolist())


def write_graph(path: str | Path, graph: Bool[Array, "n n"]) -> None:
    """Every edge once, the smaller vertex first."""
    _write_csv(Path(path), ["vertex", "neighbour"], np.argwhere(np.triu(graph, 1)).tolist())


def _write_csv(path: Path, titles: list[str], rows: Sequence[Sequence[float]]) -> None:
    lines = [",".join(titles), *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _parse_edge(where: str, cells: list[str], count: int) -> list[int]:
    if len(cells) != 2:
        raise ValueError(f"{where}: a pair of vertices is wanted, got {len(cells)} columns")
    try:
        pair = [int(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(
            f"{where}: vertices are whole numbers, got {', '.join(cells)} "
            "(a first line may name the columns, vertex,neighbour)"
        ) from error
    for vertex in pair:
        if not 0 <= vertex < count:
            raise ValueError(
                f"{where}: there is no vertex {vertex}: the {count} points are numbered from 0 to "
                f"{count - 1}"
            )
    if pair[0] == pair[1]:
        raise ValueError(f"{where}: vertex {pair[0]} cannot be its own neighbour; drop the line")
    return pair
