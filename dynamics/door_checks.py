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
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

import annotated_types
import numpy as np
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from dynamics.doors import Allow
from dynamics.inputs import (
    LARGEST,
    InputError,
    check_range,
    format_value,
    join_names,
    read_array,
)
from dynamics.labels import to_plain
from dynamics.symbols import Symbol, is_symbolic
from dynamics.units import Unit

LIMITS: dict[type, tuple[str, str, Any]] = {
    annotated_types.Gt: ("gt", "above", operator.gt),
    annotated_types.Ge: ("ge", "at least", operator.ge),
    annotated_types.Lt: ("lt", "below", operator.lt),
    annotated_types.Le: ("le", "at most", operator.le),
}
UPPER = annotated_types.Lt, annotated_types.Le
# Kinds of NumPy that arrays may have, by the first type of their annotation, and what they become.
ARRAYS: dict[str, tuple[str, Any, str]] = {
    "bool": ("biu", bool, "True and False"),
    "int2": ("iu", np.int64, "integers"),
    "complex64": ("iufc", complex, "finite numbers"),
}
LONGEST_NAME = 255  # of a file [byte]
DIMENSION = re.compile(r"(?:(\d+)\*)?(\w+)(?:([+-])(\d+))?")  # 3, n, 2*d, T+1


class Sizes:
    """Sizes of axes in a call, by the names that annotations give them."""

    def __init__(self, known: Mapping[str, int], keeps_arrays: bool = False) -> None:
        self.known: dict[str, Any] = dict(known)
        self.keeps_arrays = keeps_arrays  # in an object, whose arrays are not to change

    def fit(self, shape: tuple[int, ...], dims: list[str]) -> bool:
        """Tell whether a shape fits dimensions, and if it does, keep the sizes of their names."""
        found = dict(self.known)
        many = next((i for i, dim in enumerate(dims) if "*" == dim[0] or "..." in dim), None)
        if many is not None:
            end = len(shape) - (len(dims) - many - 1)
            if end < many or not _fit_many(shape[many:end], dims[many], found):
                return False
            shape, dims = shape[:many] + shape[end:], dims[:many] + dims[many + 1 :]
        if len(shape) != len(dims):
            return False
        is_fit = all(_fit_one(size, dim, found) for size, dim in zip(shape, dims, strict=True))
        if is_fit:
            self.known = found
        return is_fit

    def words(self, dims: list[str]) -> str:
        """Write dimensions, and the sizes that are known: (agents, 4)."""
        parts = [self._word(dim) for dim in dims]
        return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"

    def _word(self, dim: str) -> str:
        if dim[0] == "*" or "..." in dim:
            return "..."
        factor, name, sign, offset = _parse(dim)
        if name not in self.known:
            return dim
        return str(factor * self.known[name] + (int(f"{sign}{offset}") if sign else 0))


@cache
def _parse(dim: str) -> tuple[int, str, str, str]:
    factor, name, sign, offset = DIMENSION.fullmatch(dim.strip("#{}")).groups()  # type: ignore
    return int(factor or 1), name, sign or "", offset or ""


def _fit_one(size: int, dim: str, found: dict[str, Any]) -> bool:
    if dim == "_" or (dim[0] == "#" and size == 1):
        return True
    if dim.isdigit():
        return size == int(dim)
    factor, name, sign, offset = _parse(dim)
    value, remainder = divmod(size - (int(f"{sign}{offset}") if sign else 0), factor)
    return value >= 0 and not remainder and found.setdefault(name, value) == value


def _fit_many(shape: tuple[int, ...], dim: str, found: dict[str, Any]) -> bool:
    if dim == "...":
        return True
    name = "*" + dim.lstrip("*#")  # not to be mistaken for the size of one axis
    known = found.setdefault(name, shape)
    if "#" not in dim:
        return bool(known == shape)
    try:
        found[name] = np.broadcast_shapes(known, shape)
    except ValueError:
        return False
    return True


class Check(NamedTuple):
    """Check of a value: words for what it must be, and a conversion that refuses all else."""

    wanted: Callable[[Sizes], str]  # "a finite number"
    convert: Callable[[Any, Sizes], Any]


class NumberRule(NamedTuple):
    """Numbers that an annotation allows besides its type."""

    allow: Allow = Allow()
    limits: tuple[Any, ...] = ()
    unit: str = ""  # suffix of the SI unit

    def with_marks(self, marks: list[Any]) -> "NumberRule":
        """Add the marks of an annotation."""
        allow = next((mark for mark in marks if isinstance(mark, Allow)), self.allow)
        limits = (*self.limits, *(mark for mark in marks if type(mark) in LIMITS))
        unit = next((mark.suffix for mark in marks if isinstance(mark, Unit)), self.unit)
        return NumberRule(allow, limits, unit)

    def words(self) -> str:
        """Write the limits: " above 0 and at most 1"."""
        each = [(LIMITS[type(mark)], mark) for mark in self.limits]
        return " and".join(f" {word} {getattr(mark, key):g}" for (key, word, _), mark in each)

    def admit(self, value: int | float | Array) -> bool:
        """Tell whether a number, or all of an array, keep the limits; NaN does where allowed."""
        each = [(LIMITS[type(mark)], mark) for mark in self.limits]
        if isinstance(value, int):  # of any size
            return all(test(value, getattr(mark, key)) for (key, _, test), mark in each)
        number = np.asarray(value)
        number = number[~np.isnan(number)] if self.allow.nan else number
        is_real = ~np.isnan(number) if self.allow.infinite else np.isfinite(number)
        is_within = (np.all(test(number, getattr(mark, key))) for (key, _, test), mark in each)
        return bool(is_real.all()) and all(is_within)


FINITE = NumberRule()


@cache
def checks_of(function: Any) -> dict[str, Check]:
    """Make the checks of a function's arguments, by name."""
    hints, checks = _read_hints(function), dict[str, Check]()
    for name, parameter in inspect.signature(function).parameters.items():
        numbers = NumberRule(Allow(infinite=_is_infinite(parameter.default)))
        if (check := make_check(hints.get(name, Any), numbers)) is not None:
            checks[name] = check
    return checks


def _read_hints(function: Any) -> dict[str, Any]:
    """Evaluate the annotations; one that is imported for type checkers alone stays text."""
    hints, known = dict[str, Any](function.__annotations__), inspect.unwrap(function).__globals__
    for name, hint in hints.items():
        alone = types.SimpleNamespace(__annotations__={name: hint})
        with suppress(NameError):
            hints |= get_type_hints(alone, known, include_extras=True)
    return hints


def _is_infinite(value: Any) -> bool:
    return isinstance(value, float) and bool(np.isinf(value))


def make_check(hint: Any, numbers: NumberRule = FINITE) -> Check | None:
    """Make the check of an annotation; None where it takes everything."""
    origin, parts = get_origin(hint), get_args(hint)
    if isinstance(hint, str):
        return (
            _check_class_of_name(hint.rpartition(".")[2])
            if hint.replace(".", "").isidentifier()
            else None
        )
    if origin is Annotated:
        return make_check(parts[0], numbers.with_marks(list(parts[1:])))
    if hint == ArrayLike:
        return _simple("numbers", _read_numbers)
    if hasattr(hint, "dim_str") and not isinstance(hint.dtypes, list | tuple):
        return _check_class(Array)  # of any entries
    if hasattr(hint, "dim_str"):
        return _check_array(hint, numbers)
    if origin in (Union, types.UnionType):
        # A path may be text, which no other text is to be taken for.
        skipped = {type(None), Symbol, *([str] if Path in parts else [])}
        others = [part for part in parts if part not in skipped]
        return _check_union([make_check(part, numbers) for part in others], parts)
    if origin is Literal:
        return _check_literal(parts)
    if hint in (float, int):
        return _check_number(hint, numbers)
    if (origin or hint) in PLAIN:
        wanted, convert = PLAIN[origin or hint]
        return _simple(wanted, convert)
    if origin is tuple and parts[-1:] != (...,):
        return _check_tuple([make_check(part, numbers) for part in parts])
    if origin in (dict, collections.abc.Mapping):
        return _check_table(*[make_check(part, numbers) for part in parts])
    if origin in (tuple, list, collections.abc.Sequence, collections.abc.Iterable):
        return _check_list(make_check(parts[0], numbers))
    kind = origin or hint
    return _check_class(kind) if isinstance(kind, type) and kind not in (object, Any) else None


def _simple(wanted: str, convert: Callable[[Any], Any]) -> Check:
    """Make a check of a conversion that returns None for what it does not take."""

    def take(value: Any, sizes: Sizes) -> Any:
        if (found := convert(value)) is None:
            raise InputError("", f"must be {wanted}, got {describe(value)}")
        return found

    return Check(lambda sizes: wanted, take)


def _read_number(value: Any) -> Any:
    if isinstance(value, np.generic) or (type(value) is Array and value.ndim == 0):
        value = value.item()
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value if is_number else None


def _check_number(kind: type, numbers: NumberRule) -> Check:
    words = {int: "an integer", float: "a number" if numbers.allow.infinite else "a finite number"}

    is_positive = any(getattr(mark, "gt", None) == 0 for mark in numbers.limits)
    is_bounded = any(type(mark) in UPPER for mark in numbers.limits)

    def convert(value: Any) -> Any:
        if isinstance(value, list | tuple | Mapping):  # whose labels name no number
            return None
        number = _read_number(to_plain(value, numbers.unit))
        if number is None or (kind is int and not isinstance(number, int)):
            return None
        if kind is float and isinstance(number, int):
            number = float(number) if abs(number) <= LARGEST else None
        if number is None or not numbers.admit(number):
            return None
        if is_bounded:
            return kind(number)
        return check_range(kind(number)) if is_positive or abs(number) > 1 else kind(number)

    return _simple(words[kind] + numbers.words(), convert)


def _is_path(value: Any) -> bool:
    if not isinstance(value, str | PathLike) or value == "":
        return False
    with suppress(ValueError):  # no file has a name with half a character, or 0, in it
        names = os.fsencode(value).split(b"/")
        return not any(b"\0" in name for name in names) and max(map(len, names)) <= LONGEST_NAME
    return False


PLAIN: dict[Any, tuple[str, Callable[[Any], Any]]] = {
    bool: ("True or False", lambda v: bool(v) if isinstance(v, bool | np.bool_) else None),
    str: ("text", lambda v: str(v) if isinstance(v, str) else None),
    Path: ("a path", lambda v: v if _is_path(v) else None),
    collections.abc.Callable: ("a function", lambda v: v if callable(v) else None),
}


def _check_class(kind: type) -> Check:
    wanted = f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"

    def convert(value: Any, sizes: Sizes) -> Any:
        if not isinstance(value, kind):
            raise InputError("", f"must be {wanted}, got {describe(value)}")
        known = {} if isinstance(value, type) else getattr(value, "array_sizes", {})
        for name, size in known.items():
            if not name.startswith("own_") and sizes.known.setdefault(name, size) != size:
                reason = f"must be {sizes.known[name]} as of the others, got {size}"
                raise InputError(name, reason)
        return value

    return Check(lambda sizes: wanted, convert)


def _check_class_of_name(name: str) -> Check:
    def convert(value: Any) -> Any:
        return value if name in (kind.__name__ for kind in type(value).__mro__) else None

    return _simple(f"a {name}", convert)


def _check_literal(values: tuple[Any, ...]) -> Check:
    options = [(type(value), value) for value in values]

    def convert(value: Any) -> Any:
        value = value.item() if isinstance(value, np.generic) else value
        if isinstance(value, float):  # a norm, as NumPy's take it
            value = "inf" if value == np.inf else int(value) if value.is_integer() else value
        return value if isinstance(value, str | int) and (type(value), value) in options else None

    return _simple(join_names(map(format_value, values)), convert)


def _check_union(checks: list[Check | None], kinds: tuple[Any, ...]) -> Check | None:
    if None in checks:
        return None
    each = [check for check in checks if check is not None]

    def convert(value: Any, sizes: Sizes) -> Any:
        if type(value) in kinds and isinstance(value, Symbol | None):
            return value
        for check in each:
            try:
                return check.convert(value, sizes)
            except InputError as error:
                if error.key or len(each) == 1:
                    raise  # of an entry: the kind is right
        raise _refusal(wanted(sizes), value)

    def wanted(sizes: Sizes) -> str:
        return join_names(dict.fromkeys(check.wanted(sizes) for check in each))

    return Check(wanted, convert)


def _refusal(wanted: str, value: Any) -> InputError:
    cure = f"; [{format_value(value)}] would do" if isinstance(value, str) else ""
    return InputError("", f"must be {wanted}, got {describe(value)}{cure * ('a list' in wanted)}")


def _check_list(check: Check | None) -> Check:
    def convert(value: Any, sizes: Sizes) -> Any:
        is_list = isinstance(value, list | tuple | range | deque | Array)
        if not is_list or (type(value) is Array and not value.ndim):
            raise _refusal("a list", value)
        if check is None:
            return value
        found = (check_entry(str(i), check, entry, sizes) for i, entry in enumerate(value))
        return tuple(found)

    return Check(lambda sizes: "a list", convert)


def _check_tuple(checks: list[Check | None]) -> Check:
    def convert(value: Any, sizes: Sizes) -> Any:
        is_list = isinstance(value, list | tuple) or (type(value) is Array and value.ndim > 0)
        if not is_list or len(value) != len(checks):
            raise InputError("", f"must be {len(checks)} values, got {describe(value)}")
        pairs = enumerate(zip(checks, value, strict=True))
        return tuple(v if c is None else check_entry(str(i), c, v, sizes) for i, (c, v) in pairs)

    return Check(lambda sizes: f"{len(checks)} values", convert)


def _check_table(keys: Check | None = None, values: Check | None = None) -> Check:
    def convert(value: Any, sizes: Sizes) -> Any:
        if not isinstance(value, Mapping):
            raise InputError("", f"must be a dict, got {describe(value)}")
        found = {}
        for key, entry in value.items():
            key = key if keys is None else keys.convert(key, sizes)
            found[key] = entry if values is None else check_entry(str(key), values, entry, sizes)
        return found

    return Check(lambda sizes: "a dict", convert)


def check_entry(key: str, check: Check, value: Any, sizes: Sizes) -> Any:
    """Check a value; an error of it has its key."""
    try:
        return check.convert(value, sizes)
    except InputError as error:
        raise error.inside(key) from error.__cause__


def _check_array(hint: Any, numbers: NumberRule) -> Check:
    kinds, dtype, name = ARRAYS.get(hint.dtypes[0], ("iuf", float, "finite numbers"))
    if "complex64" in hint.dtypes:
        kinds = "iufc"
    if kinds == "iuf" and (numbers.allow.nan or numbers.allow.infinite):
        name = "real numbers"
    dims, takes_symbols = hint.dim_str.split(), "object_" in hint.dtypes

    def wanted(sizes: Sizes) -> str:
        return f"an array of {name}{numbers.words()} of shape {sizes.words(dims)}"

    def convert(value: Any, sizes: Sizes) -> Any:
        if takes_symbols and _has_symbols(value):
            return value
        is_plain = type(value) is Array and value.dtype == dtype and value.flags.c_contiguous
        plain = value if is_plain else to_plain(value, numbers.unit)
        array = value if is_plain else _read_array(plain, kinds, dtype, takes_symbols)
        is_fit = array is not None and sizes.fit(array.shape, dims)
        if not is_fit or (dtype is not bool and not numbers.admit(array)):
            raise InputError("", f"must be {wanted(sizes)}, got {describe(value)}")
        if array.dtype == float:
            check_range(array[np.isfinite(array)])
        if sizes.keeps_arrays:
            array = array.copy() if array is value and array.flags.writeable else array
            array.flags.writeable = False
        return array

    return Check(wanted, convert)


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


def _has_symbols(value: Any) -> bool:
    if is_symbolic(value) or isinstance(value, Symbol):
        return True
    is_array = type(value) is Array and value.dtype == object
    return is_array and any(isinstance(v, Symbol) or is_symbolic(v) for v in value.ravel())


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
        wrong = np.argwhere(~np.isfinite(value))
        return (
            f"{text} with {value[tuple(wrong[0])]} at {wrong[0].tolist()}" if len(wrong) else text
        )
    if isinstance(value, np.generic | Array):
        return describe(value.item())
    if isinstance(value, list | tuple) and value:
        with suppress(InputError):
            return describe(read_array(value))
    return format_value(value)
