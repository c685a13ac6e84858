"""Valid calls of the public functions, classes and methods of `sato`, for `fuzz_calls.py`."""

from collections.abc import Iterator
from typing import Any

Call = tuple[Any, dict[str, Any]]

# Changes that an argument takes though they look wrong: "Class.method.argument": names of changes.
ALLOWED: dict[str, tuple[str, ...]] = {}


def list_calls() -> Iterator[Call]:
    """List a function, a class or a bound method, and its arguments by name."""
    yield from ()
