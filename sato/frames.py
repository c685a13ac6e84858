"""Frames of a flight, as all who watch it get them: with arrays that nobody else has."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from functools import partial
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
from numpy import ndarray as Array
from numpy.random import Generator

from dynamics.callbacks import CallbackError, as_kind, call, is_own, is_strict, name_of, protect
from dynamics.inputs import InputError
from sato.interfaces import System

END = object()  # after the last frame


def fly(system: System[Any, Any], mission: Any, rng: Generator) -> Iterator[Any]:
    """Fly a drawn mission, and yield frames whose arrays cannot be written to.

    A `CallbackError` says that a system of the user's own fails, or yields what is no frame of it.
    """
    simulate = system.simulate
    if not is_own(simulate):
        yield from map(protect_frame, simulate(mission, rng))
        return
    passes: tuple[type[Exception], ...] = (CallbackError, *system.stop_errors)
    ask = partial(call, f"{simulate.__module__}:{name_of(simulate)}", passes=passes)
    frames = ask(lambda: iter(simulate(mission, rng)))
    check = partial(_check_frame, system.frame, {})
    yield from map(protect_frame, iter(partial(ask, next, frames, END, check=check), END))


def protect_frame(frame: Any) -> Any:
    """Return a frame with copies of its arrays, which cannot be written to, and of its events."""
    return type(frame)(*map(protect, frame))._replace(events=tuple(deepcopy(frame.events)))


def _check_frame(kind: type, shapes: dict[str, tuple[int, ...]], frame: Any) -> Any:
    """Refuse what is no frame of a kind, as it declares it, or changes the shape of a field."""
    if frame is END:
        return frame
    as_kind(frame, kind, f"a {kind.__name__}")
    for name, hint in get_type_hints(kind, include_extras=True).items():
        value, declared = getattr(frame, name), (*get_args(hint), object)[0]
        numeric = int | float | np.number if declared in (int, float) else declared
        if get_origin(hint) is Annotated and not isinstance(value, numeric):
            got = type(value).__name__
            got = f"{value.dtype} of shape {value.shape}" if isinstance(value, Array) else got
            raise InputError("", f"must have a field {name} of {declared}, got {got}")
        if isinstance(value, Array) and shapes.setdefault(name, value.shape) != value.shape:
            raise InputError("", f"must keep the shape {shapes[name]} of {name}, got {value.shape}")
    if not np.isfinite(frame.time) or not all(isinstance(event, dict) for event in frame.events):
        raise InputError("", f"must have a finite time and dicts as events, got {frame.time!r}")
    return frame


@contextmanager
def watching(callback: Callable[[Any, Any], object]) -> Iterator[Callable[[Any, Any], None]]:
    """Let a function of the user's own watch a flight, which goes on where it raises.

    The first exception is warned of, and the number of them at the end.
    """
    name, count = f"progress {name_of(callback)}", 0

    def watch(mission: Any, frame: Any) -> None:
        nonlocal count
        try:
            call(name, callback, mission, protect_frame(frame))
        except CallbackError as error:
            if is_strict.get():
                raise
            if not count:
                warnings.warn(f"{error}; the flight goes on", stacklevel=2)
            count += 1

    yield watch
    if count > 1:
        warnings.warn(f"{name} raised exceptions at {count} instants", stacklevel=2)
