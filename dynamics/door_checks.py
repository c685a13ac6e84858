"""Checks of arguments, made of their annotations for `dynamics.doors`."""

import collections.abc
import inspect
import operator
import os
import re
import types
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from fractions import Fraction
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import annotated_types
import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from dynamics.inputs import LARGEST, InputError, check_range, format_value, join_names, read_array
from dynamics.labels import to_plain
from dynamics.symbols import Symbol, has_symbols
from dynamics.units import Allow, Unit

LIMITS: dict[type, tuple[str, str, Any]] = {
    annotated_types.Gt: ("gt", "above", operator.gt),
    annotated_types.Ge: ("ge", "at least", operator.ge),
    annotated_types.Lt: ("lt", "below", operator.lt),
    annotated_types.Le: ("le", "at most", operator.le),
}
# Kinds of NumPy that arrays may have, by the first type of their annotation, and what they become.
ARRAYS: dict[str, tuple[str, Any, str]] = {
    "bool": ("biuf", bool, "True and False"),
    "int2": ("iu", np.int64, "integers"),
    "complex64": ("iufc", complex, "finite numbers"),
}
LISTS = list, tuple, range, deque, Array
LONGEST_NAME = 255  # of a file [byte]
DIMENSION = re.compile(r"#?(?:(\d+)\*)?(\w+)(?:([+-]\d+))?")  # 3, n, 2*d, T+1


class Wrong(Exception):
    """A value is none of its kind; the text says what it must be: "a finite number"."""


class Sizes:
    """Sizes of axes in a call, by the names that annotations give them."""

    def __init__(self, known: Mapping[str, int], keeps_arrays: bool = False) -> None:
        self.known: dict[str, Any] = dict(known)
        self.keeps_arrays = keeps_arrays  # in an object, whose arrays are not to change

    def fit(self, shape: tuple[int, ...], dims: list[str]) -> bool:
        """Tell whether a shape fits dimensions, and if it does, keep the sizes of their names."""
        sizes = dict(self.known)
        many = next((i for i, dim in enumerate(dims) if _is_many(dim)), None)
        if many is not None:
            end = len(shape) - (len(dims) - many - 1)
            if end < many or not _fit_many(shape[many:end], dims[many], sizes):
                return False
            shape, dims = shape[:many] + shape[end:], dims[:many] + dims[many + 1 :]
        pairs = zip(shape, dims, strict=True)
        is_fit = len(shape) == len(dims) and all(_fit_one(*pair, sizes) for pair in pairs)
        if is_fit:
            self.known = sizes
        return is_fit

    def words(self, dims: list[str]) -> str:
        """Write dimensions, and the sizes that are known: (agents, 4)."""
        parts = ["..." if _is_many(dim) else self._word(dim) for dim in dims]
        return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"

    def _word(self, dim: str) -> str:
        factor, name, offset = _parse(dim)
        return str(factor * self.known[name] + offset) if name in self.known else dim


def _is_many(dim: str) -> bool:
    return dim[0] == "*" or dim == "..."


@cache
def _parse(dim: str) -> tuple[int, str, int]:
    factor, name, offset = DIMENSION.fullmatch(dim).groups()  # type: ignore[union-attr]
    return int(factor or 1), name, int(offset or 0)


def _fit_one(size: int, dim: str, sizes: dict[str, Any]) -> bool:
    if dim == "_" or (dim[0] == "#" and size == 1):
        return True
    if dim.isdigit():
        return size == int(dim)
    factor, name, offset = _parse(dim)
    value, remainder = divmod(size - offset, factor)
    return value >= 0 and not remainder and sizes.setdefault(name, value) == value


def _fit_many(shape: tuple[int, ...], dim: str, sizes: dict[str, Any]) -> bool:
    if dim == "...":
        return True
    name = "*" + dim.lstrip("*#")  # not to be mistaken for the size of one axis
    known = sizes.setdefault(name, shape)
    if "#" not in dim:
        return bool(known == shape)
    try:
        sizes[name] = np.broadcast_shapes(known, shape)
    except ValueError:
        return False
    return True


class NumberRule(NamedTuple):
    """Numbers that an annotation allows besides its type."""

    allow: Allow = Allow()
    limits: tuple[Any, ...] = ()
    unit: str = ""  # suffix of the SI unit

    def with_marks(self, marks: tuple[Any, ...]) -> "NumberRule":
        """Add the marks of an annotation."""
        allow = next((mark for mark in marks if isinstance(mark, Allow)), self.allow)
        limits = (*self.limits, *(mark for mark in marks if type(mark) in LIMITS))
        unit = next((mark.suffix for mark in marks if isinstance(mark, Unit)), self.unit)
        return NumberRule(allow, limits, unit)

    def words(self) -> str:
        """Write the limits: " above 0 and at most 1"."""
        bounds = [(LIMITS[type(mark)], mark) for mark in self.limits]
        return " and".join(f" {word} {getattr(mark, key):g}" for (key, word, _), mark in bounds)

    def admit(self, value: int | float | Array) -> bool:
        """Tell whether a number, or all of an array, keep the limits; NaN does where allowed."""
        if not isinstance(value, int):  # which may be of any size
            value = np.asarray(value)
            value = value[~np.isnan(value)] if self.allow.nan else value
            if not (~np.isnan(value) if self.allow.infinite else np.isfinite(value)).all():
                return False
        bounds = [(LIMITS[type(mark)], mark) for mark in self.limits]
        return all(np.all(test(value, getattr(mark, key))) for (key, _, test), mark in bounds)


Check = Callable[[Any, Sizes], Any]  # converts a value, or raises `Wrong` or an `InputError`
FINITE = NumberRule()


def check_entry(key: str, check: Check, value: Any, sizes: Sizes) -> Any:
    """Check a value; an error of it has its key."""
    try:
        return check(value, sizes)
    except Wrong as wrong:
        is_text = isinstance(value, str) and "a list" in str(wrong)
        cure = f"; [{format_value(value)}] would do" if is_text else ""
        raise InputError(key, f"must be {wrong}, got {describe(value)}{cure}") from None
    except InputError as error:
        raise error.inside(key) from error.__cause__


@cache
def checks_of(function: Any) -> dict[str, Check]:
    """Make the checks of a function's arguments, by name."""
    hints, checks = _read_hints(function), dict[str, Check]()
    for name, parameter in inspect.signature(function).parameters.items():
        default = parameter.default
        is_infinite = isinstance(default, float) and bool(np.isinf(default))
        checks[name] = make_check(hints.get(name, Any), NumberRule(Allow(infinite=is_infinite)))
    return checks


def _read_hints(function: Any) -> dict[str, Any]:
    """Evaluate the annotations; one that is imported for type checkers alone stays text."""
    hints, known = dict[str, Any](function.__annotations__), inspect.unwrap(function).__globals__
    for name, hint in hints.items():
        alone = types.SimpleNamespace(__annotations__={name: hint})
        with suppress(NameError):
            hints |= get_type_hints(alone, known, include_extras=True)
    return hints


def take_all(value: Any, sizes: Sizes) -> Any:
    """Take every value as it is."""
    return value


def make_check(hint: Any, numbers: NumberRule = FINITE) -> Check:
    """Make the check of an annotation."""
    origin, parts = get_origin(hint), get_args(hint)
    kind = origin or hint
    if isinstance(hint, str):
        is_name = hint.replace(".", "").isidentifier()
        return _check_class(hint.rpartition(".")[2]) if is_name else take_all
    if origin is Annotated:
        return make_check(parts[0], numbers.with_marks(parts[1:]))
    if hint == ArrayLike:
        return _simple("numbers", _read_numbers)
    if hasattr(hint, "dim_str"):
        is_any = not isinstance(hint.dtypes, list | tuple)
        return _check_class(Array) if is_any else _check_array(hint, numbers)
    if origin in (Union, types.UnionType):
        # A path may be text, which no other text is to be taken for.
        skipped = {type(None), Symbol, *([str] if Path in parts else [])}
        checks = [make_check(part, numbers) for part in parts if part not in skipped]
        return take_all if take_all in checks else _check_union(checks, parts)
    if origin is Literal:
        return _check_literal(parts)
    if hint in (float, int):
        return _check_number(hint, numbers)
    if kind is collections.abc.Callable:
        return _check_function(parts[-1] if parts else None)
    if kind in PLAIN:
        return _simple(*PLAIN[kind])
    if origin in (tuple, list, collections.abc.Sequence, collections.abc.Iterable):
        is_row = origin is tuple and parts[-1] is not ...
        checks = [make_check(part, numbers) for part in parts if part is not ...]
        return _check_list(checks, len(parts) if is_row else None)
    if origin in (dict, collections.abc.Mapping):
        return _check_table(*[make_check(part, numbers) for part in parts])
    is_class = isinstance(kind, type) and kind not in (object, Any)
    return _check_class(kind) if is_class else take_all


def _simple(wanted: str, convert: Callable[[Any], Any]) -> Check:
    """Make a check of a conversion that returns None for what it does not take."""

    def check(value: Any, sizes: Sizes) -> Any:
        if (converted := convert(value)) is None:
            raise Wrong(wanted)
        return converted

    return check


def _as_item(value: Any) -> Any:
    """Return a number of NumPy as one of Python."""
    is_numpy = isinstance(value, np.generic) or (type(value) is Array and value.ndim == 0)
    return value.item() if is_numpy else value


def _check_number(kind: type, numbers: NumberRule) -> Check:
    words = {int: "an integer", float: "a number" if numbers.allow.infinite else "a finite number"}
    is_positive = any(getattr(mark, "gt", None) == 0 for mark in numbers.limits)
    is_bounded = any(LIMITS[type(mark)][0] in ("lt", "le") for mark in numbers.limits)

    def convert(value: Any) -> Any:
        if isinstance(value, list | tuple | Mapping):  # whose labels name no number
            return None
        number = _as_item(to_plain(value, numbers.unit))
        is_kind = isinstance(number, int if kind is int else int | float | Fraction)
        if isinstance(number, bool) or not is_kind:
            return None
        if kind is float and not isinstance(number, float) and abs(number) > LARGEST:
            return None
        number = kind(number)
        if not numbers.admit(number):
            return None
        is_checked = not is_bounded and (is_positive or abs(number) > 1)
        return check_range(number) if is_checked else number

    return _simple(words[kind] + numbers.words(), convert)


def _is_path(value: Any) -> bool:
    if not isinstance(value, str | PathLike) or value == "":
        return False
    with suppress(ValueError):  # no file has a name with half a character, or 0, in it
        names = os.fsencode(value).split(b"/")
        return not any(b"\0" in name for name in names) and max(map(len, names)) <= LONGEST_NAME
    return False


def _is_late(function: Any) -> bool:
    """Tell whether a function runs no line when it is called, as it yields or is async."""
    called = function if inspect.isroutine(function) else type(function).__call__
    return inspect.isgeneratorfunction(called) or inspect.iscoroutinefunction(called)


def _check_function(returned: Any) -> Check:
    """Make the check of a function by the annotation of what it returns."""
    if get_origin(returned) is collections.abc.Iterator:
        return _simple("a function", lambda value: value if callable(value) else None)
    wanted = "a function that returns, without yield or async"
    return _simple(wanted, lambda v: v if callable(v) and not _is_late(v) else None)


PLAIN: dict[Any, tuple[str, Callable[[Any], Any]]] = {
    bool: ("True or False", lambda v: bool(v) if isinstance(v, bool | np.bool_) else None),
    str: ("text", lambda v: str(v) if isinstance(v, str) else None),
    Path: ("a path", lambda v: v if _is_path(v) else None),
}


def _check_class(kind: type | str) -> Check:
    """Make the check of a class, or of the name of one that is not imported."""
    name = kind if isinstance(kind, str) else kind.__name__

    def check(value: Any, sizes: Sizes) -> Any:
        names = [base.__name__ for base in type(value).__mro__]
        if not (name in names if isinstance(kind, str) else isinstance(value, kind)):
            raise Wrong(f"{'an' if name[0] in 'AEIOU' else 'a'} {name}")
        known = {} if isinstance(value, type) else getattr(value, "array_sizes", {})
        for axis, size in known.items():
            if not axis.startswith("own_") and sizes.known.setdefault(axis, size) != size:
                raise InputError(axis, f"must be {sizes.known[axis]} as of the others, got {size}")
        return value

    return check


def _check_literal(values: tuple[Any, ...]) -> Check:
    options = [(type(value), value) for value in values]

    def convert(value: Any) -> Any:
        value = _as_item(value)
        if isinstance(value, float):  # a norm, as NumPy's take it
            value = "inf" if value == np.inf else int(value) if value.is_integer() else value
        return value if isinstance(value, str | int) and (type(value), value) in options else None

    return _simple(join_names(map(format_value, values)), convert)


def _check_union(checks: list[Check], kinds: tuple[Any, ...]) -> Check:
    def check_any(value: Any, sizes: Sizes) -> Any:
        if type(value) in kinds and isinstance(value, Symbol | None):
            return value
        for check in checks:
            try:
                return check(value, sizes)
            except Wrong:
                continue
            except InputError as error:
                if error.key or len(checks) == 1:
                    raise  # of an entry: the kind is right
        raise Wrong(join_names(dict.fromkeys(_words(check, sizes) for check in checks)))

    return check_any


def _words(check: Check, sizes: Sizes) -> str:
    """Say what a check wants, which a plain object is not."""
    try:
        return str(check(object(), sizes))
    except Wrong as wrong:
        return str(wrong)


def _check_list(checks: list[Check], count: int | None) -> Check:
    """Make the check of a list: of its entries, or of as many as there are checks."""

    def check(value: Any, sizes: Sizes) -> Any:
        is_list = isinstance(value, LISTS) and getattr(value, "ndim", 1) > 0
        if not is_list or count not in (None, len(value)):
            raise Wrong("a list" if count is None else f"{count} values")
        pairs = enumerate(zip(checks * len(value) if count is None else checks, value, strict=True))
        return tuple(check_entry(str(i), entry, part, sizes) for i, (entry, part) in pairs)

    return check


def _check_table(keys: Check = take_all, values: Check = take_all) -> Check:
    def check(value: Any, sizes: Sizes) -> Any:
        if not isinstance(value, Mapping):
            raise Wrong("a dict")
        parts = ((check_entry("", keys, key, sizes), part) for key, part in value.items())
        return {key: check_entry(str(key), values, part, sizes) for key, part in parts}

    return check


def _check_array(hint: Any, numbers: NumberRule) -> Check:
    kinds, dtype, name = ARRAYS.get(hint.dtypes[0], ("iuf", float, "finite numbers"))
    if "complex64" in hint.dtypes:
        kinds = "iufc"
    if kinds == "iuf" and (numbers.allow.nan or numbers.allow.infinite):
        name = "real numbers"
    dims, takes_symbols = hint.dim_str.split(), "object_" in hint.dtypes

    def check(value: Any, sizes: Sizes) -> Any:
        if takes_symbols and has_symbols(value):
            return value
        is_plain = type(value) is Array and value.dtype == dtype and value.flags.c_contiguous
        plain = value if is_plain else to_plain(value, numbers.unit)
        array = value if is_plain else _read_array(plain, kinds, dtype, takes_symbols)
        is_fit = array is not None and sizes.fit(array.shape, dims)
        if not is_fit or (dtype is not bool and not numbers.admit(array)):
            raise Wrong(f"an array of {name}{numbers.words()} of shape {sizes.words(dims)}")
        if array.dtype == float:
            check_range(array[np.isfinite(array)])
        if sizes.keeps_arrays:
            array = array.copy() if array is value and array.flags.writeable else array
            array.flags.writeable = False
        return array

    return check


def _read_array(value: Any, kinds: str, dtype: Any, takes_objects: bool) -> Any:
    if not (hasattr(value, "__len__") or hasattr(value, "__array__")):
        return None
    if takes_objects and type(value) is Array and value.dtype == object:
        value = value.tolist()  # numbers beside symbols
    array = read_array(value, kinds)
    if dtype is float and array.dtype.kind == "c":
        return array
    if dtype is bool and not ((array == 0) | (array == 1)).all():
        return None
    return array.astype(dtype)


def _read_numbers(value: Any) -> Any:
    with suppress(InputError):
        return read_array(value, "biuf")
    return None


def describe(value: Any) -> str:
    """Describe a value in a few words: a number, or the shape of an array and what is odd."""
    if value is None or isinstance(value, complex):
        return str(value)
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, Array) and value.ndim:
        text = f"an array of shape {value.shape}"
        if value.dtype.kind != "f":
            return f"{text} of dtype {value.dtype}"
        for place in np.argwhere(~np.isfinite(value)).tolist():
            return f"{text} with {value[tuple(place)]} at {place}"
        return text
    if (item := _as_item(value)) is not value:
        return describe(item)
    if isinstance(value, list | tuple) and value:
        with suppress(InputError):
            return describe(read_array(value))
    return format_value(value)
