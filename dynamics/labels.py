"""Labels of rows, columns and axes, put into the order of this library and into SI units.

Names are obeyed, or refused with an `InputError`: of columns in a file; of tables of pandas,
polars, pyarrow and astropy; of arrays of xarray; of structured arrays, dicts and lists of dicts.
No package is imported: an object is known by its attributes.
"""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy import ndarray as Array

from dynamics.inputs import PLAIN, InputError, as_array, join_names
from dynamics.quantities import to_si
from dynamics.units import SUFFIXES, split_unit

Units = Mapping[str, str]  # unit of each column, by its name in this library
AXES = ("x", "y", "z")
EXAMPLES = {"m": "km", "s": "ms"}  # of other units
STATES: Units = dict.fromkeys(AXES, "m") | {f"v{axis}": "m_s" for axis in AXES}
ID = "id"  # number of a row, by which rows are sorted
_BODY = "agent|vehicle|drone|robot|uav|spacecraft|satellite|point|target"
NAMES = {  # velocities first: "x_dot" is no x in the unit "dot"
    "v{}": r"(?:v|vel|velocity)[_ .]?([xyz])|([xyz])[_ .]?(?:dot|vel|velocity)",
    "{}": r"(?:(?:p|pos|position)[_ .]?)?([xyz])(?:[_ .]?(?:pos|position))?",
    "t": r"t|time|timestamp",
    # Pandas writes an index without a name in front, under an empty name.
    ID: rf"(?:(?:{_BODY})[_ .]?)?(?:id|index|idx|number|no)|{_BODY}|unnamed: 0|",
}
AXIS_DIMENSION = re.compile(
    r"ax[ie]s|coord(inate)?s?|components?|xyz?|space|other|neighbor", re.IGNORECASE
)
ROW_DIMENSION = re.compile(
    rf"({_BODY}|row|index|id|number|vertex|corner|obstacle)s?|vertices|dim_\d+", re.IGNORECASE
)
BODY_DIMENSION = re.compile(rf"(?:{_BODY})s?", re.IGNORECASE)
ROW_IN_TIME = re.compile(f"{ROW_DIMENSION.pattern}|time|instant", re.IGNORECASE)  # of a stick
OTHER_AXES = re.compile(
    r"(north|east|lat|lon|alt)\w*|down|up|radial|along.*|cross.*|[nedurtswh]", re.IGNORECASE
)
TABLES = "names", "column_names", "colnames", "columns"  # of a dtype, pyarrow, astropy, polars
OTHER_SUFFIX = re.compile("_(ft|feet|inch|inches|yards?|miles?|kn|knots|kts|kmh|mph)$")
TWO_UNITS = "has a unit in its name and in its attrs; drop one"
VALUES = "its values in the order of this library"
WORDS = {"meter": "m", "metre": "m", "kilometer": "km", "kilometre": "km", "second": "s"}


def match_columns(names: Sequence[Any], units: Units) -> dict[str, tuple[int, float | None]]:
    """Find the places of columns by their names, in the order of the units.

    Positions are x and y, or x, y and z; all coordinates have a velocity, or none.
    The unit of a name is returned in SI units, None where it has none.
    """
    places: dict[str, tuple[int, float | None]] = {}
    for index, given in enumerate(names):
        meaning, factor = _parse_name(given, index, units)
        if meaning in places:
            first = names[places[meaning][0]]
            raise InputError("", f'columns "{first}" and "{given}" are the same; drop one')
        places[meaning] = index, factor
    axes = AXES[: 3 if {"z", "vz"} & set(places) else 2]
    needed = [name for name in units if name == "t"]
    for prefix in ("", "v"):
        columns = [prefix + axis for axis in axes if prefix + axis in units]
        is_optional = prefix == "v" and "x" in units
        needed += columns if not is_optional or any(name in places for name in columns) else []
    if absent := [name for name in needed if name not in places]:
        given = join_names(map(str, names), "and")
        raise InputError("", f'column "{absent[0]}" is missing; there are {given}')
    return {name: places[name] for name in (ID, *units) if name in places}


def knows_name(name: str, units: Units) -> bool:
    """Tell whether a name is that of a column."""
    with suppress(InputError):
        return bool(name) and _parse_name(name, 0, units) is not None
    return False


def parse_unit(text: str, unit: str) -> float:
    """Return the size in SI units of a unit, spelled as in "km", "mm/s" or "m s-1"."""
    spelled = re.sub(r"\^|\*\*", "", text.strip()).replace("²", "2")
    spelled = re.sub(r"(?<=[\s·.*_][sh])(-1|⁻¹)$", "", spelled)
    suffix = re.sub(r"[\s/·.*]+", "_", spelled)
    suffix = WORDS.get(suffix.removesuffix("s"), suffix)
    quantity = SUFFIXES[unit].quantity if unit else ""
    if suffix not in SUFFIXES or SUFFIXES[suffix].quantity != quantity:
        known = [one.symbol for one in SUFFIXES.values() if one.quantity == quantity]
        cure = join_names(known) if unit else "numbers without a unit in their labels or attrs"
        raise InputError("", f'has the unit "{text}"; {cure} would do')
    return SUFFIXES[suffix].factor


def sort_rows(rows: Array, numbers: Array) -> Array:
    """Return rows in the order of their numbers, which are whole, each once."""
    whole, times = np.unique(numbers, return_counts=True)
    if (whole % 1).any() or (times > 1).any():
        wrong = whole[np.argmax((whole % 1 != 0) | (times > 1))]
        reason = f'column "{ID}" must number the rows, and has {wrong:g} {times.max()} times'
        raise InputError("", f"{reason}; without it rows keep their order")
    return np.asarray(rows[np.argsort(numbers, kind="stable")])


def to_plain(value: Any, unit: str, units: Units | None = None) -> Any:
    """Return the plain numbers of a value with labels or units, in SI units.

    A value without is returned as it is. The unit is a suffix, "" for none; the units are those of
    the columns of a table, if they are not the axes alone.
    """
    if type(value) in PLAIN:
        return value
    try:
        return _read_labels(value, unit, units)
    except InputError:
        raise
    except Exception as error:  # of an object of another package, which only looks like a table
        reason = f"must be numbers or a table of them, got an object of type {type(value).__name__}"
        raise InputError("", reason) from error


def _read_labels(value: Any, unit: str, units: Units | None) -> Any:
    if hasattr(value, "isel"):
        value = _sort_labels(value, ROW_IN_TIME if unit == "m_s" else ROW_DIMENSION)
    elif hasattr(value, "sort_index") and hasattr(value, "to_frame"):
        value = _sort_series(value)
    name = getattr(value, "name", None)
    spelled = _unit_in(name) if isinstance(name, str) else None  # of pandas and xarray
    if spelled is not None and _find_declared(value) is not None:
        raise InputError("", TWO_UNITS)
    if (table := _split_table(value)) is not None:
        is_moving = unit == "m_s" and any("v" in str(name) for name in table[0])
        names = [f"v{axis}" if is_moving else axis for axis in AXES]
        return _stack(*table, units or dict.fromkeys(names, unit))
    numbers, has_unit = _strip(value, unit)
    if unit and not has_unit and spelled is not None:
        numbers = np.asarray(numbers) * parse_unit(spelled, unit)
    if has_unit and units is not None and np.shape(numbers)[-1:] > (len(AXES),):
        cure = "plain numbers, in m and m/s, would do"
        raise InputError("", f"has one unit for positions and velocities; {cure}")
    return numbers


def _unit_in(name: str) -> str | None:
    """Return the unit in a name, as in "R [cm]" or "R_cm"; None where there is none."""
    match = re.search(r"[\[(]([^\[\]()]*)[\])]\s*$", name) or OTHER_SUFFIX.search(name)
    return match[1] if match else split_unit(name)[1]


def _parse_name(given: Any, index: int, units: Units) -> tuple[str, float | None]:
    whole = "_".join(map(str, given)) if isinstance(given, tuple) else str(given)
    plain = re.sub(r"[\[\]()\"']", " ", whole).strip()
    for pattern, spelled in NAMES.items():
        match = re.fullmatch(rf"(?:{spelled})(?:[\s_/,]+(.*))?", plain, re.IGNORECASE)
        if match is None or (not plain and index):
            continue
        *axes, unit = match.groups()
        name = pattern.format(next(filter(None, axes), "").lower())
        if name == ID and not unit:
            return name, None
        if name not in units:
            break
        try:
            unit = unit.lower() if unit and whole.isupper() else unit
            return name, parse_unit(unit, units[name]) if unit else None
        except InputError as error:
            raise InputError("", f'column "{given}" {error}') from error
    is_other = OTHER_AXES.fullmatch(plain.split("_")[0])
    reason = "is of other axes than those of a mission" if is_other else "is not known"
    known = f"{join_names((ID, *units), 'and')} are read, as {example_of(units)}"
    raise InputError("", f'column "{given}" {reason}; {known}; rename it, or leave it out')


def check_vehicle_labels(value: Any) -> None:
    """Refuse numbers of vehicles that have names, or the dimension of anything else."""
    names = list(map(str, _as_row(value) or ()))
    if hasattr(value, "isel"):
        names = [str(dim) for dim in value.dims if not ROW_DIMENSION.fullmatch(str(dim))]
    if names:
        reason = f"is a number or one a vehicle, and has the labels {join_names(names, 'and')}"
        raise InputError("", f"{reason}; a list would do, or for axes an argument of axes")


def check_axis_labels(value: Any) -> None:
    """Refuse numbers of axes that have the dimension of vehicles."""
    dims = [str(dim) for dim in value.dims] if hasattr(value, "isel") else []
    if any(map(BODY_DIMENSION.fullmatch, dims)):
        raise InputError("", f'has the dimension {dims[0]}, and an entry an axis; "axis" would do')


def check_pair_labels(matrix: Any, rows: Any) -> None:
    """Refuse a matrix whose labels are in another order than those of the rows that it pairs.

    Labels are those of pandas or xarray; those that count from 0 say nothing of the order.
    """
    given = [axis for axis in _labels_of(matrix) if not _counts(axis)]
    known = [axis for axis in _labels_of_rows(rows) if not _counts(axis)]
    known = known or [axis for axis in given[:1] if _is_in_order(axis)]
    wanted = [axis.tolist() if _is_text(axis) else sorted(axis.tolist()) for axis in known]
    if any(axis.tolist() not in wanted for axis in given):
        cure = "a table with labels in the order of the points would do"
        raise InputError("", f"has rows or columns labeled in another order; {cure}")


def _labels_of(value: Any) -> list[Any]:
    """Return the labels of the axes of a table of pandas, or of an array of xarray."""
    if hasattr(value, "iloc"):
        return [value.index, *([value.columns] if hasattr(value, "columns") else [])]
    return [value.indexes[d] for d in getattr(value, "dims", ()) if d in value.coords]


def _labels_of_rows(value: Any) -> list[Any]:
    if hasattr(value, "iloc"):
        labels = _labels_of(value)
        return labels[1:] if _names_axes(labels[0]) else labels[:1]
    if not hasattr(value, "isel"):
        return []
    axes = [dim for dim in value.dims if AXIS_DIMENSION.fullmatch(str(dim))] + _text_axes(value)
    return [value.indexes[dim] for dim in value.dims if dim in value.coords and dim not in axes]


def _counts(labels: Any) -> bool:
    return bool(labels.tolist() == list(range(len(labels))))


def example_of(units: Units) -> str:
    """Name a column without and with a unit, as an example."""
    name, unit = next(iter(units.items()), ("x", "m"))
    return name if not unit else f"{name} or {name}_{EXAMPLES.get(unit, unit)}"


def _split_table(value: Any) -> tuple[list[Any], list[Any]] | None:
    """Split a table, or a row of one, into names and columns; None where it has no names."""
    rows: list[Any] = [_as_row(row) for row in value] if isinstance(value, list | tuple) else []
    if rows and None not in rows:
        if any(set(row) != set(rows[0]) for row in rows):
            raise InputError("", "must have rows of the same names")
        return list(rows[0]), [[row[name] for row in rows] for name in rows[0]]
    if (row := _as_row(value)) is not None:
        return list(row), list(row.values())
    if hasattr(value, "isel"):  # of xarray
        named = _text_axes(value)
        labels = value[named[0]].values.tolist() if named else []
        return (labels, [value.isel({named[0]: i}) for i in range(len(labels))]) if named else None
    if hasattr(value, "iloc") and hasattr(value, "index"):  # of pandas
        return _split_frame(value)
    listed = getattr(value, "dtype", None), value, value, value
    marked = (getattr(one, mark, None) for one, mark in zip(listed, TABLES, strict=True))
    names = next((list(names) for names in marked if names and not callable(names)), None)
    return None if names is None else (names, [value[name] for name in names])


def _as_row(value: Any) -> dict[Any, Any] | None:
    """Return a row, or a table, with names as a dict; None for anything else."""
    is_series = hasattr(value, "iloc") and hasattr(value, "to_frame") and _is_text(value.index)
    if hasattr(value, "_asdict"):  # a named tuple
        return dict(value._asdict())
    return dict(value) if is_series or isinstance(value, Mapping) else None


def _is_text(labels: Any) -> bool:
    return any(isinstance(label, str | tuple) for label in np.asarray(labels).tolist())


def _text_axes(value: Any) -> list[Any]:
    """Return the dimensions of an array of xarray whose labels are names, but for those of rows."""
    named = [dim for dim in value.dims if _is_text(value[dim])]
    bodies = [dim for dim in named if BODY_DIMENSION.fullmatch(str(dim))]
    return [dim for dim in named if dim not in bodies or _names_axes(value[dim])]


def _names_axes(labels: Any) -> bool:
    return all(knows_name(str(label), STATES) for label in np.asarray(labels).tolist())


def _split_frame(value: Any) -> tuple[list[Any], list[Any]] | None:
    is_frame = hasattr(value, "columns")
    if is_frame and _is_text(value.index) and not _is_text(value.columns):
        value = value.T
    index = value.index
    if index.nlevels > 1 or (is_frame and index.dtype.kind == "M"):
        raise InputError("", "has an index of times, or levels; reset_index(drop=True) has none")
    is_named = is_frame and index.name is not None
    if not (is_named or _is_in_order(index)):
        raise InputError("", "has an index out of order; reset_index(drop=True) keeps this order")
    names = list(value.columns) if is_frame else [0]
    columns = [value.iloc[:, i] for i in range(len(names))] if is_frame else [value]
    if names == list(range(len(names))) and not is_named:
        return None
    return ([index.name, *names], [index, *columns]) if is_named else (names, columns)


def _is_in_order(index: Any) -> bool:
    """Return True for increasing numbers, and for texts that do not end in numbers out of order."""
    if not _is_text(index):
        return bool(index.is_monotonic_increasing)
    endings = [re.search(r"\d+$", str(label)) for label in index]  # agent0, agent1, …
    numbers = [int(ending[0]) for ending in endings if ending]
    return len(numbers) < len(index) or numbers == sorted(numbers)


def _sort_series(value: Any) -> Any:
    """Sort a column of pandas by the numbers of its rows, where its index has such a name."""
    name = str(value.index.name or "-")
    if not re.fullmatch(NAMES[ID], name, re.IGNORECASE) or _is_text(value.index):
        return value
    if value.index.has_duplicates:
        raise InputError("", f'has labels of "{name}" that are repeated')
    return value.sort_index()


def _sort_labels(value: Any, rows_known: re.Pattern[str]) -> Any:
    """Sort an array of xarray by its numbered labels, and put its axes last."""
    numbered = [dim for dim in value.dims if dim in value.coords and not _is_text(value[dim])]
    if repeated := [dim for dim in numbered if len(np.unique(value[dim])) < value.sizes[dim]]:
        raise InputError("", f'has labels of "{repeated[0]}" that are repeated')
    value = value.sortby(numbered) if numbered else value
    names = _text_axes(value)
    for dim in [dim for dim in value.dims if dim in value.coords and dim not in names]:
        if not _is_in_order(value.indexes[dim]):
            reason = f'has labels of "{dim}" out of order'
            raise InputError("", f'{reason}; drop_vars("{dim}") keeps this order')
    is_dataset = isinstance(value, Mapping)
    if len(value.dims) < 2 and not is_dataset:
        return value
    axes = [dim for dim in value.dims if AXIS_DIMENSION.fullmatch(str(dim))]
    axes = axes or ([] if is_dataset else names)
    is_plain = all(str(dim).startswith("dim_") for dim in value.dims)
    rows = [str(dim) for dim in value.dims if dim not in axes]
    is_known = len(axes) + is_dataset == len(rows) == 1 and all(map(rows_known.fullmatch, rows))
    if not (is_known or is_plain):
        dims = join_names(map(str, value.dims), "and")
        cure = '"agent" or "row"' if is_dataset else '"agent" or "row", and "axis",'
        if len(value.dims) > 2:
            is_run = "time" in value.dims
            cure = f"an instant of it, as value.isel(time=-1), or {VALUES}" if is_run else VALUES
        raise InputError("", f"has dimensions {dims}; {cure} would do")
    return value.transpose(..., *axes)


def _stack(names: list[Any], columns: list[Any], units: Units) -> Array:
    read = {}
    for name, (place, factor) in match_columns(names, units).items():
        try:
            numbers, has_unit = _strip(columns[place], units.get(name, ""))
            array = as_array(numbers, np.ndim(numbers))
            if factor is not None and _find_declared(columns[place]) is not None:
                raise InputError("", TWO_UNITS)
        except InputError as error:
            raise InputError("", f'column "{names[place]}" {error}') from error
        read[name] = array * (1.0 if factor is None or has_unit else factor)
    if len({array.shape for array in read.values()}) > 1:
        raise InputError("", "has columns of different lengths")
    numbers = read.pop(ID, None)
    rows = np.stack(list(read.values()), axis=-1)
    return rows if numbers is None or rows.ndim == 1 else sort_rows(rows, numbers)


def _strip(value: Any, unit: str) -> tuple[Any, bool]:
    """Return the numbers of a quantity, a column or an array, and True if it had a unit."""
    plain = value
    if hasattr(value, "isel"):
        plain = value.data
    elif hasattr(value, "to_numpy"):
        plain = value.to_numpy()
    elif hasattr(value, "quantity"):  # a column of astropy
        if np.ma.is_masked(value):
            raise InputError("", "has masked rows; drop or fill them")
        plain = np.asarray(value) if value.unit is None else value.quantity
    numbers = to_si(plain, unit)
    declared = _find_declared(value)
    if declared is None or numbers is not plain:
        return numbers, numbers is not plain
    return np.asarray(numbers) * parse_unit(str(declared), unit), True


def _find_declared(value: Any) -> Any:
    attrs = getattr(value, "attrs", {})
    return attrs.get("units", attrs.get("unit"))
