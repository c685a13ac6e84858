"""Errors of missions and scenario files: the key, what is wrong, and a value that would do."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from math import ceil, floor, log10
from typing import Any

from dynamics.errors import InputError as InputError
from dynamics.errors import format_value as format_value
from dynamics.errors import join_names as join_names

PLAIN_WORDS = {
    ", unable to parse string as an integer": "",
    ", unable to parse string as a number": "",
    "a valid integer": "an integer",
    "a valid ": "a ",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
    "tuple": "list",
    " after validation": "",
    "'": '"',
}


class ScenarioError(ValueError):
    """A scenario that cannot be flown; the message names the file and the key."""


def closest_name(name: str, known: Iterable[str]) -> str | None:
    """Find the known name that is spelled most alike."""
    close = get_close_matches(name, list(known), n=1, cutoff=0.6)
    return close[0] if close else None


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
    is_single = isinstance(first["input"], str) or not hasattr(first["input"], "__len__")
    for each in errors[:1] if is_single else errors:  # of a list, those that take one tell more
        if isinstance(cause := each.get("ctx", {}).get("error"), InputError):
            return cause
    where = ".".join(str(part) for part in first["loc"] if isinstance(part, int))
    literals = [other["msg"] for other in others if other["type"] == "literal_error"]
    words = [message.removeprefix("Input should be ") for message in literals]
    wanted = re.sub(r"\b\w+ should", "must", " or ".join([first["msg"], *words[:1]]))
    for theirs, ours in PLAIN_WORDS.items():
        wanted = wanted.replace(theirs, ours)
    return InputError(where, f"{wanted}, got {format_value(first['input'])}")
