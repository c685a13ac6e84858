"""Callbacks: functions and methods of a user's own, called with copies, their results checked.

They are not trusted. Each gets arrays that nobody else has and that cannot be written to. What it
returns is converted and checked, and what it raises becomes a sentence with the place in the
user's file. Functions of this library are called as they are.
"""

import os
import sysconfig
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial, partialmethod, wraps
from pathlib import Path
from traceback import walk_tb
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy import ndarray as Array

from dynamics.inputs import LARGEST, InputError, check_finite, check_range, read_array
from dynamics.symbols import has_symbols

LIBRARY = ("dynamics", "problems", "sato")
# Beginnings of the names of files that are not the user's.
_FOREIGN = (
    *(f"{Path(__file__).parent.parent / name}{os.sep}" for name in LIBRARY),
    *(sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")),
    "<frozen",
    "<__array",
)
MAX_LENGTH = 300  # of the text of an exception
T = TypeVar("T")
METHODS: Any = Callable, classmethod, partialmethod

is_strict: ContextVar[bool] = ContextVar("is_strict", default=False)  # as of `strictly`


class CallbackError(InputError):
    """Fault of a function of the user's own: it raised, or returned what it may not.

    An exception that it raised is the cause of this one.
    """


class Callback(NamedTuple):
    """Method that users write."""

    parameters: str  # their names
    check: Callable[[Any, dict[str, Any], Any], Any]  # object, arguments, result ↦ it, converted
    passes: type[InputError] = CallbackError  # what it may raise


def name_of(function: Any) -> str:
    """Return the name of a function, or of the class of another object."""
    return str(getattr(function, "__qualname__", type(function).__name__))


def is_own(part: Any) -> bool:
    """Tell whether a class or a function is the user's own, and not of this library."""
    part = part.func if isinstance(part, partial) else part
    return str(getattr(part, "__module__", "")).partition(".")[0] not in LIBRARY


@contextmanager
def strictly(is_wanted: bool) -> Iterator[None]:
    """Raise exceptions of callbacks as they are, where this is wanted."""
    token = is_strict.set(is_wanted)
    try:
        yield
    except InputError as error:
        fault: BaseException | None = error
        while is_wanted and fault is not None:
            if isinstance(fault, CallbackError) and fault.__cause__ is not None:
                raise fault.__cause__ from fault.__cause__.__cause__
            fault = fault.__cause__
        raise
    finally:
        is_strict.reset(token)


def call(
    name: str,
    function: Callable[..., Any],
    *arguments: Any,
    passes: tuple[type[Exception], ...] = (CallbackError,),
    check: Callable[[Any], Any] | None = None,
    **options: Any,
) -> Any:
    """Call a function of the user's own with copies of arrays, which cannot be written to.

    A `check` converts the result, or raises an `InputError` that begins with "must". Exceptions
    that pass are raised as they are; of all others, and of a wrong result, a `CallbackError` tells.
    """
    passes = *passes, MemoryError
    try:
        options = {key: protect(value) for key, value in options.items()}
        result = function(*map(protect, arguments), **options)
    except passes:
        raise
    except Exception as error:
        where = f" ({place})" if (place := _find_place(error, function)) else ""
        if isinstance(error, ValueError) and "read-only" in str(error):
            reason = "writes into an array that it was given, which is the flight's"
            raise CallbackError("", f"{name} {reason}{where}; x = x.copy() would do") from error
        text = " ".join(str(error).split())[:MAX_LENGTH]
        said = f"{type(error).__name__}: {text}" if text else type(error).__name__
        raise CallbackError("", f"{name} raised {said}{where}") from error
    try:
        return result if check is None else check(result)
    except InputError as error:
        raise CallbackError("", f"{name}: the result {error}") from None


def as_shape(value: Any, shape: tuple[int, ...], can_stretch: bool = False) -> Array:
    """Convert a result to an array of finite doubles of a shape; an `InputError` refuses any other.

    Where it can be stretched, leading axes may be missing, along which it is then the same.
    """
    if type(value) is Array and value.dtype == float and value.shape == shape and value.size:
        if np.abs(value).max() <= LARGEST:  # fast: models are asked at thousands of times
            return value.copy()
    would_do = f"an array of shape {shape} would do"
    if value is None:
        raise InputError("", f"must not be None: a return is missing; {would_do}")
    value = value.full() if type(value).__name__ == "DM" else value  # numbers of CasADi
    try:
        array = read_array(value).astype(float)
    except InputError as error:
        raise InputError("", f"{error}; {would_do}") from error
    check_finite(array)
    check_range(array)
    lacking = max(len(shape) - array.ndim, 0) if can_stretch else 0
    if array.shape != shape[lacking:]:
        raise InputError("", f"must be an array of shape {shape}, got {array.shape}")
    return np.array(np.broadcast_to(array, shape))


def as_kind(value: Any, kind: Any, would_do: str) -> Any:
    """Return a result of a type; an `InputError` refuses any other."""
    if not isinstance(value, kind):
        raise InputError("", f"must be {would_do}, got {type(value).__name__}")
    return value


def guard(cls: type, callbacks: dict[str, Callback]) -> None:
    """Let methods of a new class that are the user's own be called and checked as callbacks."""
    for name, callback in callbacks.items():
        owner = next((base for base in cls.__mro__ if name in vars(base)), None)
        if owner is not None and is_own(owner):
            method = vars(owner)[name]
            as_kind(method, METHODS, f"a method {name} of {cls.__name__}")
            setattr(cls, name, _guard_method(name, method, callback))


def guard_attributes(part: Any, callbacks: dict[str, Callback]) -> None:
    """Guard what replaced methods of an object later: in its class, or as attributes of its own."""
    guard(type(part), callbacks)
    attributes, kind = getattr(part, "__dict__", {}), type(part).__name__
    for name in callbacks.keys() & attributes.keys():
        function = as_kind(attributes[name], Callable, f"a function {name} of {kind}")
        if not getattr(function, "is_guarded", False):
            guarded = _guard_method(name, staticmethod(function), callbacks[name])
            attributes[name] = guarded.__get__(part)


def _guard_method(name: str, method: Any, callback: Callback) -> Any:
    if getattr(method, "is_guarded", False):
        return method

    names = callback.parameters.split()

    @wraps(method)
    def guarded(self: Any, *arguments: Any, **options: Any) -> Any:
        # Objects with `__call__` and partial functions are not bound.
        bound = method.__get__(self, type(self)) if hasattr(method, "__get__") else method
        given = dict(zip(names, arguments, strict=False)) | options
        # A call of `super()` is checked by what calls it.
        is_inner = getattr(getattr(self, name), "__func__", None) is not guarded
        if is_inner or any(map(has_symbols, given.values())):
            return bound(*arguments, **options)
        time = given.get("t")
        when = f"(t={float(time):.6g})" if isinstance(time, (float, int, np.floating)) else ""
        full_name, passes = f"{type(self).__name__}.{name}{when}", (callback.passes,)
        check = partial(callback.check, self, given)
        return call(full_name, bound, *arguments, passes=passes, check=check, **options)

    guarded.is_guarded = True  # type: ignore[attr-defined]
    return guarded


def _find_place(error: BaseException, function: Any) -> str:
    """Find the file and the line of the user's code that raised an exception; "" if unknown."""
    code = getattr(getattr(function, "__func__", function), "__code__", None)
    places = [] if code is None else [(code.co_filename, code.co_firstlineno)]
    places += [(frame.f_code.co_filename, line) for frame, line in walk_tb(error.__traceback__)]
    known = [place for place in places if not place[0].startswith(_FOREIGN)]
    return f"{Path(known[-1][0]).name}:{known[-1][1]}" if known else ""


def freeze(value: T) -> T:
    """Return a value, of whose arrays none can be written to from now on."""
    if isinstance(value, Array):
        value.flags.writeable = False
    parts = value if isinstance(value, tuple | list) else getattr(value, "__dict__", {}).values()
    for part in parts:
        freeze(part)
    return value


def protect(value: Any) -> Any:
    """Return a copy of an array that cannot be written to; other values as they are."""
    is_numeric = isinstance(value, Array) and value.dtype != object
    return freeze(value.copy()) if is_numeric else value
