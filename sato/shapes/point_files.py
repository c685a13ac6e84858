"""Points from CSV files."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

MAX_COORDINATE = 1e9  # largest coordinate whose square is sure not to overflow [m]
HEADERS = ("x,y", "x_m,y_m", "x,y,z", "x_m,y_m,z_m")


def read_points(path: Path) -> Float[Array, "k d"]:
    """Read every point of a CSV file with two or three columns of meters, in its order.

    A first line `x,y`, `x,y,z`, `x_m,y_m` or `x_m,y_m,z_m` may name the columns; empty lines and
    lines that begin with # are skipped.

    Raises:
        ValueError: The file cannot be read, a line is not a point, or two points coincide.
    """
    rows = read_rows(path, "points", lambda cells: ",".join(cells).lower() in HEADERS)
    columns = len(rows[0][1])
    listed = np.array([_parse_point(path, number, cells, columns) for number, cells in rows])
    _check_distinct(path, listed, [number for number, _ in rows])
    return listed


def read_rows(
    path: Path, content: str, is_header: Callable[[list[str]], bool]
) -> list[tuple[int, list[str]]]:
    """Read a CSV file without its header, empty lines and comments.

    Args:
        path: The file.
        content: Name of the rows in messages.
        is_header: Tell from its cells whether the first row is a header.

    Returns:
        The number of each line in the file, and its cells.

    Raises:
        ValueError: There is no such file, it is not text, or it has no rows.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise ValueError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read as a list of {content}: {error}") from error
    rows = [
        (number, [cell.strip() for cell in next(csv.reader([line]))])
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if rows and is_header(rows[0][1]):
        del rows[0]
    if not rows:
        raise ValueError(f"{path} lists no {content}")
    return rows


def _parse_point(path: Path, number: int, cells: list[str], columns: int) -> list[float]:
    where = f"{path}, line {number}"
    if columns not in (2, 3):
        raise ValueError(f"{where}: 2 or 3 columns of meters are needed, got {columns}")
    if len(cells) != columns:
        raise ValueError(f"{where}: {columns} columns of meters are needed, got {len(cells)}")
    try:
        point = [float(cell) for cell in cells]
    except ValueError as error:
        raise ValueError(
            f"{where}: not numbers: {', '.join(cells)} "
            "(a first line may name the columns, x_m,y_m or x_m,y_m,z_m)"
        ) from error
    if not np.isfinite(point).all():
        raise ValueError(f"{where}: a coordinate is not finite: {', '.join(cells)}")
    if np.abs(point).max() > MAX_COORDINATE:
        raise ValueError(
            f"{where}: a coordinate is larger than {MAX_COORDINATE:.0e} m: {', '.join(cells)}"
        )
    return point


def _check_distinct(path: Path, listed: Float[Array, "k d"], numbers: list[int]) -> None:
    from scipy.spatial import cKDTree

    # Points closer than rounding can resolve, on the scale of the whole list, coincide.
    pairs = cKDTree(listed).query_pairs(1e-12 * float(np.abs(listed).max()))
    if pairs:
        first, second = min(pairs)
        raise ValueError(
            f"{path}: lines {numbers[first]} and {numbers[second]} are the same point, and two "
            "agents cannot share it"
        )
