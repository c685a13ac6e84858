"""Targets from a file of points."""

import csv
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.shapes.ordering import farthest_point_order
from sato.shapes.placement import Center, UnplacedShape, check_count, place_shape

MAX_COORDINATE = 1e9  # no coordinate is larger: their squares must not overflow [m]
HEADERS = ("x,y", "x_m,y_m", "x,y,z", "x_m,y_m,z_m")


def points(
    path: str | Path,
    count: int | None = None,
    *,
    keep_order: bool = False,
    spacing: float | None = None,
    minimum_spacing: float = 0.0,
    center: Center = "origin",
) -> Float[Array, "count d"]:
    """Targets listed in a CSV file: two or three columns of metres.

    A first line `x,y`, `x,y,z` or `x_m,y_m`, `x_m,y_m,z_m` may name them; empty lines and lines
    that begin with # are skipped.

    Args:
        path: The file.
        count: How many targets, the first in the order; without it, all.
        keep_order: Leave the points in the order of the file, which may not keep the shape in
            every prefix; otherwise they are put in farthest-point order.
        spacing: Scale the points to this least distance between two of the targets [m].
        minimum_spacing: Refuse targets that stand closer [m].
        centre: Where the middle of the bounding box of all points goes; "given" leaves them
            where the file has them.

    Raises:
        ValueError: The file cannot be read, a line is not a point, two points coincide, there
            are too few, or they would stand too close.
    """
    if count is not None:
        check_count(count)
    listed = read_points(Path(path))
    if count is not None and count > len(listed):
        raise ValueError(f"{path} lists {len(listed)} points, fewer than the {count} asked for")
    middle = (listed.min(axis=0) + listed.max(axis=0)) / 2
    chosen = listed if keep_order else listed[farthest_point_order(listed)]
    draft = UnplacedShape(f"the list {path}", chosen[:count], middle, None, 1.0)
    return place_shape(
        draft, spacing=spacing, size=None, minimum_spacing=minimum_spacing, center=center
    )


def read_points(path: Path) -> Float[Array, "k d"]:
    """Every point of the file, where it is and in its order.

    Raises:
        ValueError: The file cannot be read, a line is not a point, or two points coincide.
    """
    rows: list[list[float]] = []
    numbers: list[int] = []
    for number, line in data_lines(path, "points"):
        cells = [cell.strip() for cell in next(csv.reader([line]))]
        if not rows and ",".join(cells).lower() in HEADERS:
            continue
        rows.append(_parse_point(path, number, cells, len(rows[0]) if rows else None))
        numbers.append(number)
    if not rows:
        raise ValueError(f"{path} lists no points")
    listed = np.array(rows)
    _check_distinct(path, listed, numbers)
    return listed


def data_lines(path: Path, what: str) -> list[tuple[int, str]]:
    """Lines of a CSV file and their numbers, without the empty ones and the comments.

    Raises:
        ValueError: There is no such file, or it is not text.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise ValueError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read as a list of {what}: {error}") from error
    return [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]


def _parse_point(path: Path, number: int, cells: list[str], columns: int | None) -> list[float]:
    if len(cells) not in (2, 3) or (columns is not None and len(cells) != columns):
        raise ValueError(
            f"{path}, line {number}: {columns or '2 or 3'} columns of metres are wanted, "
            f"got {len(cells)}"
        )
    try:
        point = [float(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(
            f"{path}, line {number}: not numbers: {', '.join(cells)} "
            "(a first line may name the columns, x_m,y_m or x_m,y_m,z_m)"
        ) from error
    if not np.isfinite(point).all():
        raise ValueError(f"{path}, line {number}: a coordinate is not finite: {', '.join(cells)}")
    if np.abs(point).max() > MAX_COORDINATE:
        raise ValueError(
            f"{path}, line {number}: a coordinate is larger than {MAX_COORDINATE:.0e} m: {', '.join(cells)}"
        )
    return point


def _check_distinct(path: Path, listed: Float[Array, "k d"], numbers: list[int]) -> None:
    from scipy.spatial import cKDTree

    # Closer than rounding can tell apart, on the scale of the whole list.
    twins = cKDTree(listed).query_pairs(1e-12 * float(np.abs(listed).max()))
    if twins:
        first, second = min(twins)
        raise ValueError(
            f"{path}: lines {numbers[first]} and {numbers[second]} are the same point, and two "
            "agents cannot share it"
        )
