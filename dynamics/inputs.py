"""Inputs: values that callers give, converted and checked, and the error that refuses them.

All doors of the library use these: definitions of missions, public functions, callbacks.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy import ndarray as Array

# What a value with units or labels has, and would lose as an array of NumPy.
MARKS = "unit", "units", "columns", "dims", "colnames", "column_names", "iloc"
PLAIN = {int, float, bool, str, type(None)}


class InputError(ValueError):
    """Wrong input: a mission that cannot be flown, or an argument that a function cannot take.

    The message names the key or the argument, and a value that would do.

    Args:
        key: Key of the scenario file, with its tables as far as they are known, or argument.
        reason: What is wrong, the value given, and what would do.
    """

    def __init__(self, key: str, reason: str) -> None:
        super().__init__(f"{key}: {reason}" if key else reason)
        self.key = key
        self.reason = reason

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the arguments, so that worker processes can raise it."""
        return type(self), (self.key, self.reason)

    def inside(self, table: str) -> "InputError":
        """Return the same error of a key inside a table."""
        return InputError(".".join(filter(None, (table, self.key))), self.reason)


def join_names(names: Iterable[Any], last: str = "or") -> str:
    """Join names in a sentence: "a, b or c"."""
    *most, end = [str(name) for name in names]
    return f"{', '.join(most)} {last} {end}" if most else end


def format_value(value: object) -> str:
    """Write a value as TOML does, cut short where it is long."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"' if len(value) <= 40 else f'"{value[:40]}…"'
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, float):
        return f"{value:.1f}" if value.is_integer() and abs(value) < 1e6 else f"{value:.6g}"
    if isinstance(value, int) and abs(value) >= 10**30:
        return "an integer of more than 30 digits"
    return str(value) if isinstance(value, int) else f"an object of type {type(value).__name__}"


def is_marked(value: Any) -> bool:
    """Tell whether a value has units or labels, which an array of NumPy would lose."""
    if isinstance(value, list | tuple):
        return not set(map(type, value)) <= PLAIN and any(map(is_marked, value))
    return type(value) not in PLAIN and any(hasattr(value, mark) for mark in MARKS)


def as_array(value: Any, ndim: int) -> Array:
    """Convert to a read-only array of finite doubles.

    Raises:
        InputError: It is masked, complex or not numeric, has other axes, or is not finite.
    """
    if isinstance(value, np.ma.MaskedArray):
        raise InputError("", "must not be a masked array; value.filled(...) is a plain one")
    if is_marked(value):
        cure = "its plain numbers in SI units would do"
        raise InputError("", f"has units or labels, which an array loses; {cure}")
    try:
        array = np.array(value, order="C")
    except ValueError as error:
        raise InputError("", "must have rows of one length") from error
    if array.dtype.kind not in "iuf":
        raise InputError("", f"must be an array of real numbers, got dtype {array.dtype}")
    if array.ndim != ndim or array.size == 0:
        raise InputError("", f"must be an array with {ndim} axes, got shape {array.shape}")
    array = array.astype(float)
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InputError("", f"must be finite, got {array[tuple(where)]} at {where}")
    array.flags.writeable = False
    return array
