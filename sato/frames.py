"""Frames of a flight, as all who watch it get them: with arrays that nobody else has."""

import warnings
from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any

import numpy as np
from numpy import ndarray as Array
from numpy.random import Generator

from dynamics.callbacks import CallbackError, call, check_result, is_own, is_strict
from dynamics.inputs import InputError
from sato.interfaces import System


def fly(system: System[Any, Any], mission: Any, rng: Generator) -> Iterator[Any]:
    """Fly a drawn mission, and yield frames whose arrays cannot be written to.

    Raises:
        CallbackError: A system of the user's own fails, or yields what is no frame of it.
    """
    simulate, first = system.simulate, None
    if not is_own(simulate):
        yield from map(protect, simulate(mission, rng))
        return
    name = f"{simulate.__module__}:{getattr(simulate, '__qualname__', 'simulate')}"
    frames = call(name, simulate, mission, rng)
    if not hasattr(frames, "__next__"):
        reason = f"must be a generator of frames, got {type(frames).__name__}; yield would do"
        raise CallbackError("", f"{name}: the result {reason}")
    passes = CallbackError, *system.stop_errors
    while (frame := call(name, next, frames, None, passes=passes)) is not None:
        first = first or frame
        yield protect(check_result(name, _check_frame, system.frame, frame, first))


def protect(frame: Any) -> Any:
    """Return a frame with copies of its arrays, which cannot be written to."""
    copies = {name: value.copy() for name, value in _arrays_of(frame).items()}
    for copy in copies.values():
        copy.flags.writeable = False
    return frame._replace(**copies, events=tuple(deepcopy(frame.events)))


def _arrays_of(frame: Any) -> dict[str, Array]:
    return {k: v for k, v in zip(frame._fields, frame, strict=True) if isinstance(v, Array)}


def _check_frame(kind: Any, frame: Any, first: Any) -> Any:
    """Refuse what is no frame of a system, or has arrays of other shapes than the first."""
    if not isinstance(frame, kind):
        raise InputError("", f"must be a {kind.__name__}, got {type(frame).__name__}")
    if np.shape(frame.time) != () or not np.isfinite(frame.time):
        raise InputError("", f"must have a time in seconds, got {frame.time!r}")
    for name in ("position", "velocity", "alive", "component"):
        value, before = getattr(frame, name), getattr(first, name)
        axes = 2 if name in ("position", "velocity") else 1
        if not isinstance(value, Array) or value.ndim != axes or value.dtype.kind not in "biuf":
            got = f"{value.dtype} of shape {value.shape}" if isinstance(value, Array) else value
            raise InputError("", f"must have an array {name} with {axes} axes, got {got!r}")
        if value.shape != before.shape:
            raise InputError("", f"must keep the shape {before.shape} of {name}, got {value.shape}")
    return frame


class Watcher:
    """Function of the user's own that is called with each frame of a flight, which goes on."""

    def __init__(self, callback: Callable[[Any, Any], object]) -> None:
        self._callback, self._error_count = callback, 0
        self._name = f"progress {getattr(callback, '__qualname__', type(callback).__name__)}"

    def __call__(self, mission: Any, frame: Any) -> None:
        """Call the function; warn of its first exception.

        Raises:
            CallbackError: It raised, and exceptions are to be raised as they are.
        """
        if not is_own(self._callback):
            self._callback(mission, frame)
            return
        try:
            call(self._name, self._callback, mission, frame._replace(events=deepcopy(frame.events)))
        except CallbackError as error:
            if is_strict():
                raise
            if not self._error_count:
                warnings.warn(f"{error}; the flight goes on", stacklevel=2)
            self._error_count += 1

    def close(self) -> None:
        """Tell how often the function failed, where that was more than once."""
        if self._error_count > 1:
            text = f"{self._name} raised exceptions at {self._error_count} instants"
            warnings.warn(text, stacklevel=2)
