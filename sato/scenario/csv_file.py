"""CSV files: rows of numbers, in columns that a header names in any order and unit.

Cells are separated by commas, semicolons, tabs or spaces. Empty lines, and lines that begin with
#, are skipped.
"""

import csv
import re
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.labels import ID, OTHER_AXES, Units, knows_name, match_columns, sort_rows
from dynamics.units import SUFFIXES
from sato.scenario.errors import InputError, join_names

NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf)", re.IGNORECASE | re.ASCII)
BEGIN = re.compile(r"[+-]?\.?\d|nan$|[+-]?inf$", re.IGNORECASE)  # of a number, right or wrong
WITH_COMMA = re.compile(r"[+-]?\d+(,\d+)?(e[+-]?\d+)?", re.IGNORECASE | re.ASCII)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}|[+-]?\d+")  # or with a decimal comma
NAME = re.compile(r"[^\W\d]\w*(\s*[\[(/].*)?")  # one word, perhaps with a unit
WORDS = re.compile(r"[\s,;|]+")
OTHER_LENGTH = re.compile(r"\b(k|c|m)m\b|\b(feet|ft)\b")  # than the meter, in a comment

Row = tuple[int, list[str]]  # number of the line, and its cells


class Table(NamedTuple):
    """Columns of numbers in SI units, by name, and the lines that their rows stand in."""

    columns: dict[str, Float[Array, " k"]]
    lines: Int[Array, " k"]


def read_columns(path: Path, content: str, units: Units, counts: Collection[int]) -> Table:
    """Read the columns that a header names; without one they stand in the order of the units.

    Args:
        path: File.
        content: Name of the rows in messages.
        units: Unit of each column that there may be, by its name.
        counts: Numbers of columns that need no header.

    Raises:
        ValueError: The file cannot be read, or its columns are not those.
    """
    names, rows = read_rows(path, content, units)
    if names is None and len(rows[0][1]) not in counts:
        header = ",".join(units)
        needed = f"{join_names(counts)} columns are needed, or a header such as {header}"
        raise ValueError(f"{path}, line {rows[0][0]}: {needed}, got {len(rows[0][1])}")
    width = len(names or rows[0][1])
    try:
        places = match_columns(names or list(units)[:width], units)
        values, lines = _read_numbers(path, rows, width, units)
        columns = {name: values[:, i] * (factor or 1.0) for name, (i, factor) in places.items()}
        if ID in columns:
            numbers = columns.pop(ID)
            columns = {name: sort_rows(column, numbers) for name, column in columns.items()}
            lines = sort_rows(lines, numbers)
    except InputError as error:
        raise ValueError(f"{path}: {error}") from error
    return Table(columns, lines)


def _read_numbers(
    path: Path, rows: list[Row], width: int, units: Units
) -> tuple[Float[Array, "k c"], Int[Array, " k"]]:
    for line, cells in rows:
        where = f"{path}, line {line}"
        if len(cells) != width:
            raise ValueError(f"{where}: {width} columns are needed, got {len(cells)}")
        if not all(map(NUMBER.fullmatch, cells)):
            hint = f"a first line may name the columns, {','.join(units)}"
            raise ValueError(f"{where}: not numbers: {', '.join(cells)} ({hint})")
    values = np.array([cells for _, cells in rows]).astype(float)
    return values, np.array([line for line, _ in rows])


def read_rows(path: Path, content: str, units: Units) -> tuple[list[str] | None, list[Row]]:
    """Read the names of a header, None where there is none, and the cells of all rows.

    A header is a first line without a number, or a comment above the rows that names columns.

    Raises:
        ValueError: There is no such file, it is not text, or it has no rows.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError as error:
        raise ValueError(f"there is no file {path}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read as a list of {content}: {error}") from error
    given = [(n, line) for n, line in enumerate(lines, start=1) if line.strip(" \t,;")]
    is_told = bool(given) and re.fullmatch(r"sep=.", given[0][1].strip(), re.IGNORECASE)
    written = [(n, line) for n, line in given[bool(is_told) :] if not _is_comment(line)]
    if not written:
        raise ValueError(f"{path} lists no {content}")
    first = written[0][1]
    between = given[0][1].strip()[-1] if is_told else next((c for c in ";\t," if c in first), " ")
    rows = [(n, _split(line, between)) for n, line in written]
    names, width = None, len(rows[0][1])
    if not any(map(BEGIN.match, rows[0][1])):
        (_, names), *rows = rows
        if not rows:
            raise ValueError(f"{path} lists no {content}")
    numbered = list(map(str, range(width)))
    decimals = [cell for _, cells in rows[1:] for cell in cells]
    if names is None and rows[0][1] == numbered and decimals and all("." in c for c in decimals):
        cure = f"name the columns, {','.join([*units][:width])}, or write {'.0,'.join(numbered)}.0"
        raise ValueError(f"{path}: {','.join(numbered)} may be names or a point; {cure}")
    notes = [line.lstrip("# \t") for n, line in given if n < rows[0][0] and _is_comment(line)]
    for note in notes:
        for cells, is_list in ((_split(note, between), between != " "), (WORDS.split(note), False)):
            if len(cells) != width or width == 1 or any(map(BEGIN.match, cells)):
                continue
            if all(cell in SUFFIXES for cell in cells):
                cure = "they stand in the names of the columns, as in x_km"
                raise ValueError(f"{path}: units have a line of their own; {cure}")
            is_known = any(knows_name(cell, units) for cell in cells)
            is_named = all(map((NAME if is_list else OTHER_AXES).fullmatch, cells))
            if names is None and (is_known or is_named):
                names = cells
        found = OTHER_LENGTH.search(note)
        if units and found and not any(re.search(r"[_\[(/]", name) for name in names or ()):
            cure = f"numbers without a unit are meters; name columns as in x_{found[0]}"
            raise ValueError(f'{path}: a comment has the unit "{found[0]}", and {cure}')
    return names, _with_points(path, rows)


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _split(line: str, between: str) -> list[str]:
    try:
        cells = line.split() if between == " " else next(csv.reader([line], delimiter=between))
    except csv.Error as error:
        raise ValueError(f"a line of the CSV file cannot be read: {error}") from error
    cells = [cell.strip() for cell in cells]
    while len(cells) > 1 and not cells[-1]:  # of a separator at the end
        cells.pop()
    return cells


def _with_points(path: Path, rows: list[Row]) -> list[Row]:
    # "1,5" may be a number where commas do not separate cells.
    listed = [cell for _, cells in rows for cell in cells]
    if not any("," in cell for cell in listed) or re.search(r"[^\d.,e+-]", "".join(listed), re.I):
        return rows
    if not all(map(WITH_COMMA.fullmatch, listed)) or all(map(THOUSANDS.fullmatch, listed)):
        example = next(cell for cell in listed if "," in cell)
        raise ValueError(f"{path}: {example} may be a decimal or thousands; write a decimal point")
    return [(line, [cell.replace(",", ".") for cell in cells]) for line, cells in rows]
