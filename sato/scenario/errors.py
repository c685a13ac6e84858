"""Errors of missions and scenario files: the key, what is wrong, and a value that would do."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from math import ceil, floor, log10
from typing import Any

PLAIN_WORDS = {
    "a valid integer": "an integer",
    "a valid ": "a ",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "tuple": "list",
    " after validation": "",
    "'": '"',
}


class InputError(ValueError):
    """A mission that cannot be flown; the message names the key and a value that would do.

    Args:
        key: Key of the scenario file, with its tables as far as they are known.
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


class ScenarioError(ValueError):
    """A scenario that cannot be flown; the message names the file and the key."""


def join_names(names: Iterable[Any], last: str = "or") -> str:
    """Join names in a sentence: "a, b or c"."""
    *most, end = [str(name) for name in names]
    return f"{', '.join(most)} {last} {end}" if most else end


def closest_name(name: str, known: Iterable[str]) -> str | None:
    """Find the known name that is spelled most alike."""
    close = get_close_matches(name, list(known), n=1, cutoff=0.6)
    return close[0] if close else None


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


def round_up(value: float) -> str:
    """Round to four digits upwards, so that a least value stays sufficient."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{ceil(value / unit * (1 - 1e-12)) * unit:.4g}"


def round_down(value: float) -> str:
    """Round to four digits downwards, so that a largest value stays sufficient."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{floor(value / unit * (1 + 1e-12)) * unit:.4g}"


def explain(error: Any) -> InputError:
    """Say in plain words the first that pydantic objects to, and what would do."""
    errors: list[Any] = error.errors(include_url=False)
    first, *others = errors
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return cause
    where = ".".join(str(part) for part in first["loc"] if isinstance(part, int))
    literals = [other["msg"] for other in others if other["type"] == "literal_error"]
    words = [message.removeprefix("Input should be ") for message in literals]
    wanted = re.sub(r"\b\w+ should", "must", " or ".join([first["msg"], *words[:1]]))
    for theirs, ours in PLAIN_WORDS.items():
        wanted = wanted.replace(theirs, ours)
    return InputError(where, f"{wanted}, got {format_value(first['input'])}")
