"""CSV files: rows of numbers, in columns that a header names in any order and unit.

Cells are separated by commas, semicolons, tabs or spaces. Empty lines, and lines that begin with
#, are skipped.
"""

import csv
import re
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.labels import (
    ID,
    OTHER_AXES,
    Units,
    example_of,
    knows_name,
    match_columns,
    sort_rows,
)
from dynamics.units import SUFFIXES
from sato import files
from sato.scenario.errors import InputError, join_names

NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf)", re.IGNORECASE | re.ASCII)
BEGIN = re.compile(r"[+-]?\.?\d|nan$|[+-]?inf$", re.IGNORECASE)  # of a number, right or wrong
WITH_COMMA = re.compile(r"[+-]?\d+(,\d+)?(e[+-]?\d+)?", re.IGNORECASE | re.ASCII)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}|[+-]?\d+")  # or with a decimal comma
NAME = re.compile(r"[^\W\d]\w*(\s*[\[(/].*)?")  # one word, perhaps with a unit
WORDS = re.compile(r"[\s,;|]+")
COMMENT = re.compile(r"\s*#")
OTHER_UNIT = re.compile(  # than those of SI, in a comment
    r"\b([hkcdmnµμ]m|(kilo|centi|deci|milli|micro)met(er|re)s?|feet|ft|inch(es)?|yards?|miles?|knots?"
    r"|thousands|(?:(?<=in )|(?<=[\[(]))(ms|milliseconds|minutes|hours|deg(rees)?))\b",
    re.IGNORECASE,
)
OTHER_FRAME = re.compile(  # than x, y and z, in a comment
    r"\b(ned|enu|ecef|eci|j2000|[gi]crf|teme|body[ -](frame|axes)|north|east|down|lat(itude)?"
    r"|lon(gitude)?|polar|spherical|pixels?)\b",
    re.IGNORECASE,
)
_OF = r"(?:[\s:=(>-]+(?:axis|is|in|the|points)\b)*[\s:=(>-]+"
OTHER_LVLH = re.compile(  # than x radial, y along-track and z cross-track, in a comment
    rf"\b(x{_OF}((along|cross|in)[ -]?track|transverse|nadir)"
    rf"|y{_OF}(radial|cross[ -]?track|nadir|zenith)"
    rf"|z{_OF}(radial|(along|in)[ -]?track|transverse|nadir))\b",
    re.IGNORECASE,
)
LABEL = re.compile(r"^(columns?|axes|fields?|header|names?|order|format)\s*[:=]\s*", re.IGNORECASE)

Row = tuple[int, list[str]]  # number of the line, and its cells


class Table(NamedTuple):
    """Columns of numbers in SI units, by name, and the lines that their rows stand in."""

    columns: dict[str, Float[Array, " k"]]
    lines: Int[Array, " k"]


def read_columns(path: Path, content: str, units: Units, counts: Collection[int]) -> Table:
    """Read the columns that a header names; without one they stand in the order of the units.

    Only so many columns need no header as are in the counts. The content names rows in messages.
    """
    names, rows = read_rows(path, content, units)
    width = len(names or rows[0][1])
    if names is None and width not in counts:
        needed = f"{join_names(counts)} columns are needed, or a header such as {','.join(units)}"
        raise ValueError(f"{path}, line {rows[0][0]}: {needed}, got {width}")
    if names is None:
        names = list(units)[:width]
        _refuse_doubtful(path, [cells for _, cells in rows], names)
    try:
        places = match_columns(names, units)
        values, lines = _read_numbers(path, rows, width, units)
        columns = {name: values[:, i] * (factor or 1.0) for name, (i, factor) in places.items()}
        if ID in columns:
            numbers = columns.pop(ID)
            columns = {name: sort_rows(column, numbers) for name, column in columns.items()}
            lines = sort_rows(lines, numbers)
    except InputError as error:
        raise ValueError(f"{path}: {error}") from error
    return Table(columns, lines)


def _refuse_doubtful(path: Path, rows: list[list[str]], names: list[str]) -> None:
    """Refuse rows without a header whose first line, or first column, may be labels."""
    header, count = ",".join(names), len(rows)
    numbered = [list(map(str, range(k, count + k))) for k in range(min(count, 2))]
    first, others = rows[0], [cell for cells in rows[1:] for cell in cells]
    if others and first == list(map(str, range(len(first)))) and all("." in c for c in others):
        cure = f"name the columns, {header}, or write {'.0,'.join(first)}.0"
        raise ValueError(f"{path}: {','.join(first)} may be names or a point; {cure}")
    are_distinct = len({tuple(cells[1:]) for cells in rows}) == len(rows)  # as points x,y
    # In the format of `numpy.savetxt`, 0 is 0.000000000000000000e+00.
    counts = [re.sub(r"\.0+e", "e", cells[0]) for cells in rows]
    counts = [f"{float(cell):g}" if re.fullmatch(r"\d+e[+-]\d+", cell) else cell for cell in counts]
    if header == "x,y,z" and are_distinct and counts in numbered:
        begin, cure = ", ".join([*counts, "1"][:2]), "name the columns, id,x,y or x,y,z"
        reason = f"the first column, {begin}, …, may number the rows or be x"
        raise ValueError(f"{path}: {reason}; {cure}")


def _read_numbers(
    path: Path, rows: list[Row], width: int, units: Units
) -> tuple[Float[Array, "k c"], Int[Array, " k"]]:
    for line, cells in rows:
        where = f"{path}, line {line}"
        if len(cells) != width:
            raise ValueError(f"{where}: {width} columns are needed, got {len(cells)}")
        if not all(map(NUMBER.fullmatch, cells)):
            hint = f"a first line may name the columns, {','.join(units)}, as {example_of(units)}"
            raise ValueError(f"{where}: not numbers: {', '.join(cells)} ({hint})")
    values = np.array([cells for _, cells in rows]).astype(float)
    return values, np.array([line for line, _ in rows])


def read_rows(path: Path, content: str, units: Units) -> tuple[list[str] | None, list[Row]]:
    """Read the names of a header, None where there is none, and the cells of all rows.

    A header is a first line without a number, or a comment above the rows that names columns.
    """
    try:
        text = files.read_text(path)
    except UnicodeDecodeError as error:
        reason = "it is no text in UTF-8; a text saved as UTF-8 would do"
        raise ValueError(f"{path} cannot be read as a list of {content}: {reason}") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise ValueError(f"{path} cannot be read as a list of {content}: {reason}") from error
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip(" \t,;")]
    told = re.fullmatch(r"\s*sep=(.)\s*", lines[0][1], re.IGNORECASE) if lines else None
    written = [(n, line) for n, line in lines[bool(told) :] if not COMMENT.match(line)]
    first = written[0][1] if written else ""
    between = told[1] if told else next((mark for mark in ";\t," if mark in first), " ")
    rows = [(n, _split(line, between)) for n, line in written]
    is_header = bool(rows) and not any(map(BEGIN.match, rows[0][1]))
    names = rows.pop(0)[1] if is_header else None
    if not rows:
        raise ValueError(f"{path} lists no {content}")
    width = len(names or rows[0][1])
    notes = [(n, line.lstrip("# \t")) for n, line in lines if COMMENT.match(line)]
    try:
        for n, note in notes:
            noted = _find_names(note, between, width, units) if n < rows[0][0] else None
            meanings = [_find_meaning(header, units) for header in (names, noted)]
            if None not in meanings and meanings[0] != meanings[1]:
                raise InputError("", f'two headers disagree; drop the comment "{note}"')
            names = names or noted
            unit = OTHER_UNIT.search(note)
            frame, cure = OTHER_LVLH.search(note), "x is radial here, y along-track, z cross-track"
            if frame is None and not names:
                frame = OTHER_FRAME.search(note)
                cure = "a header with x, y and z says which column is which"
            if frame and {"x", "vx"} & set(units):
                raise InputError("", f'a comment speaks of "{frame[0]}", and {cure}')
            if units and unit and not any(re.search(r"[_\[(/]", name) for name in names or ()):
                cure = "numbers without one are in SI; columns are named as in x_mm or vx_km_h"
                raise InputError("", f'a comment has the unit "{unit[0]}", and {cure}')
        return names, _with_points(rows)
    except InputError as error:
        raise ValueError(f"{path}: {error}") from error


def _find_names(note: str, between: str, width: int, units: Units) -> list[str] | None:
    """Find the names of columns in a comment; None where it has other words."""
    note = LABEL.sub("", note)
    for cells, is_list in ((_split(note, between), between != " "), (WORDS.split(note), False)):
        if len(cells) != width or width == 1 or any(map(BEGIN.match, cells)):
            continue
        if all(cell in SUFFIXES for cell in cells):
            cure = "they stand in the names of the columns, as in x_km"
            raise InputError("", f"units have a line of their own; {cure}")
        is_known = any(knows_name(cell, units) for cell in cells)
        if is_known or all(map((NAME if is_list else OTHER_AXES).fullmatch, cells)):
            return cells
    return None


def _find_meaning(names: list[str] | None, units: Units) -> dict[str, tuple[int, float]] | None:
    """Find the places and units of columns; None where their names are not known."""
    with suppress(InputError):
        places = match_columns(names or [], units).items()
        return {name: (place, factor or 1.0) for name, (place, factor) in places}
    return None


def _split(line: str, between: str) -> list[str]:
    try:
        cells = line.split() if between == " " else next(csv.reader([line], delimiter=between))
    except csv.Error as error:
        raise InputError("", f"a line of the CSV file cannot be read: {error}") from error
    cells = [cell.strip() for cell in cells]
    while len(cells) > 1 and not cells[-1]:  # of a separator at the end
        cells.pop()
    return cells


def _with_points(rows: list[Row]) -> list[Row]:
    # "1,5" may be a number where commas do not separate cells.
    listed = [cell for _, cells in rows for cell in cells]
    if not any("," in cell for cell in listed) or re.search(r"[^\d.,e+-]", "".join(listed), re.I):
        return rows
    if not all(map(WITH_COMMA.fullmatch, listed)) or all(map(THOUSANDS.fullmatch, listed)):
        example = next(cell for cell in listed if "," in cell)
        reason = f"{example} may be a decimal or thousands"
        raise InputError("", f"{reason}; write a decimal point")
    return [(line, [cell.replace(",", ".") for cell in cells]) for line, cells in rows]
