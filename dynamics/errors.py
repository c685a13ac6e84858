"""Error of wrong input, and the words of its message."""

from collections.abc import Iterable
from typing import Any


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
        return type(self)(".".join(filter(None, (table, self.key))), self.reason)


def join_names(names: Iterable[Any], last: str = "or") -> str:
    """Join names in a sentence: "a, b or c"; "none" where there are none."""
    *most, end = [str(name) for name in names] or ["none"]
    return f"{', '.join(most)} {last} {end}" if most else end


def format_value(value: object) -> str:
    """Write a value as TOML does, cut short where it is long."""
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "None"
    if isinstance(value, str):
        value = value if value[:40].isprintable() else repr(value[:40])[1:-1] + value[40:41]
        return f'"{value}"' if len(value) <= 40 else f'"{value[:40]}…"'
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, float):
        if value.is_integer():
            return f"{value:.1f}" if abs(value) < 1e6 else f"{value:.6g}"
        text = f"{value:.6g}"
        return repr(value) if float(text).is_integer() else text
    if isinstance(value, int) and abs(value) >= 10**30:
        return "an integer of more than 30 digits"
    return str(value) if isinstance(value, int) else f"an object of type {type(value).__name__}"
