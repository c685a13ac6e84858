"""Inputs: values that callers give, converted and checked.

All doors of the library use these: definitions of missions, public functions, callbacks.
"""

from datetime import date
from numbers import Number
from typing import Any

import numpy as np
from numpy import ndarray as Array

from dynamics.errors import InputError as InputError
from dynamics.errors import format_value as format_value
from dynamics.errors import join_names as join_names

LARGEST = 1e30  # of a number, whose products are then far from the end of doubles
SMALLEST = 1e-30  # other than 0
LARGEST_COUNT = 10**9
# What a value with units or labels has, and would lose as an array of NumPy.
MARKS = "unit", "units", "columns", "dims", "colnames", "column_names", "iloc"
PLAIN = {int, float, bool, str, type(None)}


def shorten(value: Any) -> str:
    """Write a value as `repr` does, but arrays by their shapes and long tuples by their sizes."""
    if isinstance(value, Array):
        return f"<array of shape {value.shape}>"
    if isinstance(value, tuple) and len(value) > 3 and not hasattr(value, "_fields"):
        return f"<{len(value)} values>"
    return repr(value)


def short_repr(value: Any) -> str:
    """Write a dataclass or a named tuple as `repr` does, its fields by `shorten`."""
    names = getattr(value, "_fields", None) or value.__dataclass_fields__
    parts = (f"{name}={shorten(getattr(value, name))}" for name in names)
    return f"{type(value).__qualname__}({', '.join(parts)})"


def is_marked(value: Any) -> bool:
    """Tell whether a value has units or labels, which an array of NumPy would lose."""
    if isinstance(value, list | tuple):
        return not set(map(type, value)) <= PLAIN and any(map(is_marked, value))
    return type(value) not in PLAIN and any(hasattr(value, mark) for mark in MARKS)


def as_array(value: Any, ndim: int) -> Array:
    """Convert to a read-only array of finite doubles; an `InputError` refuses anything else."""
    array = read_array(value)
    if array.ndim != ndim or array.size == 0:
        wanted = "that is not empty" if array.ndim == ndim else f"with {ndim} axes"
        raise InputError("", f"must be an array {wanted}, got shape {array.shape}")
    check_finite(array := array.astype(float))
    array.flags.writeable = False
    return array


def read_array(value: Any, kinds: str = "iuf") -> Array:
    """Convert to a new array, of any shape.

    Args:
        value: Array, numbers, or nested lists of numbers.
        kinds: Kinds of numbers that are wanted, as `numpy.dtype.kind` has them.

    Raises:
        InputError: It is masked, has rows of several lengths, or numbers of another kind.
    """
    rows = value if isinstance(value, list | tuple) else []
    if any(isinstance(part, np.ma.MaskedArray) for part in (value, *rows)):
        raise InputError("", "must not be a masked array; value.filled(...) is a plain one")
    wanted = {"biuf": "booleans", "iu": "integers", "iufc": "numbers"}.get(kinds, "real numbers")
    if value is None or isinstance(value, str | bytes | bytearray | memoryview | dict | type):
        raise InputError("", f"must be an array of {wanted}, got {format_value(value)}")
    if is_marked(value):
        cure = "its plain numbers in SI units would do"
        raise InputError("", f"has units or labels, which an array loses; {cure}")
    try:
        array = np.array(value, order="C")
    except ValueError as error:
        raise InputError("", "must have rows of one length") from error
    except Exception as error:  # whatever the methods of an object raise that is no array
        raise InputError("", f"must be an array, got {format_value(value)}") from error
    if array.dtype.kind not in kinds and array.size:
        raise InputError("", f"must be an array of {wanted}, got {_name_entries(value, array)}")
    return array


def _name_entries(value: Any, array: Array) -> str:
    """Say of what an array of another kind than wanted is, and what would do instead."""
    if hasattr(value, "toarray"):  # of SciPy
        return "a sparse matrix; its toarray() would do"
    entries = [entry for entry in array.flat if type(entry) not in PLAIN]
    if array.dtype.kind == "M" or any(isinstance(entry, date) for entry in entries):
        return "dates; seconds since the first of them would do"
    if array.dtype.kind != "O" or not entries:
        return f"dtype {array.dtype}"
    cure = "; float(...) of it would do" if isinstance(entries[0], Number) else ""
    return f"{format_value(entries[0])}{' in it' if array.ndim else ''}{cure}"


def check_finite(array: Array) -> None:
    """Refuse an array that is not finite, and say where."""
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InputError("", f"must be finite, got {array[tuple(where)]} at {where}")


def check_symmetric(name: str, matrix: Array) -> None:
    """Refuse matrices, of the edges of graphs, that are not symmetric."""
    if not np.array_equal(matrix, np.swapaxes(matrix, -1, -2)):
        raise InputError(name, "must be symmetric: edges have no direction")


def check_range(value: Any) -> Any:
    """Refuse numbers that are too large or too small to compute with; return all others.

    Entries of lists and arrays may be as small as they like.
    """
    if isinstance(value, int):
        if abs(value) > LARGEST_COUNT:
            raise InputError("", f"must be at most {LARGEST_COUNT:g}, got {format_value(value)}")
    elif isinstance(value, float):
        if np.isfinite(value) and value and not SMALLEST <= abs(value) <= LARGEST:
            limits = f"0, or between {SMALLEST:g} and {LARGEST:g} in size"
            raise InputError("", f"must be {limits}, got {format_value(value)}")
        return value + 0.0  # no −0.0, whose sign would count
    elif isinstance(value, tuple):
        for part in value:
            if not isinstance(part, float) or abs(part) > SMALLEST:
                check_range(part)
    elif isinstance(value, Array) and value.dtype.kind == "f" and value.size:
        check_range(max(float(np.abs(value).max()), SMALLEST))
    return value
