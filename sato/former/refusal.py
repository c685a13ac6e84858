"""Saying no: what was wrong, where, and what would do."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from math import ceil, floor, log10
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from sato.scenario.errors import ScenarioError


__all__ = ["Refusal", "ScenarioError", "explain", "listed", "nearest"]


class Refusal(ValueError):
    """Something in a scenario that cannot be; whoever knows the file makes it a ScenarioError."""

    def __init__(self, where: str, what: str) -> None:
        super().__init__(f"{where}: {what}" if where else what)
        self.where = where
        self.what = what

    def inside(self, table: str) -> "Refusal":
        """The same, of a key in a table."""
        return Refusal(".".join(filter(None, (table, self.where))), self.what)


@contextmanager
def refused_at(where: str) -> Iterator[None]:
    """What is refused in here, or said to be no good, is refused of a key of the file."""
    try:
        yield
    except Refusal as refusal:
        raise refusal.inside(where) from refusal
    except ValueError as error:
        raise Refusal(where, str(error)) from error


def listed(names: Iterable[Any], last: str = "or") -> str:
    """Names in a sentence: "a, b or c"."""
    *most, end = [str(name) for name in names]
    return f"{', '.join(most)} {last} {end}" if most else end


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that was probably meant."""
    close = get_close_matches(name, list(known), n=1, cutoff=0.6)
    return close[0] if close else None


def shown(value: object) -> str:
    """A value as one would write it in TOML, cut short where it is long."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"' if len(value) <= 40 else f'"{value[:40]}…"'
    if isinstance(value, dict):
        return "a table"
    if isinstance(value, list):
        return "a list"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def upward(value: float) -> str:
    """To four digits and never down: a least value that is said to do must do."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{ceil(value / unit * (1 - 1e-12)) * unit:.4g}"


def downward(value: float) -> str:
    """To four digits and never up."""
    unit = 10.0 ** (floor(log10(value)) - 3)
    return f"{floor(value / unit * (1 + 1e-12)) * unit:.4g}"


def explain(error: ValidationError, data: dict[str, Any]) -> Refusal:
    """The first of pydantic's complaints, as one sentence about a key of the file."""
    first = error.errors(include_url=False)[0]
    where = _where(first["loc"], data)
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, Refusal):
        return cause.inside(where)
    return Refusal(where, _what(first))


def _where(location: tuple[int | str, ...], data: Any) -> str:
    # pydantic puts the kind of a table into the path; a reader of the file does not see it there.
    path: list[str] = []
    here, tagged = data, False
    for part in location:
        if isinstance(here, dict) and here.get("kind") == part and not tagged:
            tagged = True
            continue
        if isinstance(here, dict) and isinstance(part, int):
            continue  # one table, written where a list of them could be
        path.append(str(part))
        tagged = False
        try:
            here = here[part]
        except (KeyError, IndexError, TypeError):
            here = None
    return ".".join(path)


def _what(error: ErrorDetails) -> str:
    context = error.get("ctx", {})
    got = f"got {shown(error['input'])}"
    match error["type"]:
        case "missing":
            return "is missing, and has no value of its own"
        case "union_tag_not_found":
            return "needs a kind"
        case "union_tag_invalid":
            known = [tag.strip().strip("'") for tag in str(context["expected_tags"]).split(",")]
            meant = nearest(str(context["tag"]), known)
            hint = f'; did you mean "{meant}"?' if meant else ""
            return f'there is no kind "{context["tag"]}", only {listed(known, "and")}{hint}'
        case "int_type" | "int_from_float":
            return f"must be a whole number, {got}"
        case "float_type":
            return f"must be a number, {got}"
        case "finite_number":
            return f"must be a finite number, {got}"
        case "string_type":
            return f"must be text in quotes, {got}"
        case "string_pattern_mismatch":
            return (
                f"must be of letters, digits, '_', '.' and '-', the first a letter or digit, {got}"
            )
        case "bool_type":
            return f"must be true or false, {got}"
        case "list_type":
            return f"must be a list, {got}"
        case "model_type" | "model_attributes_type" | "dict_type":
            return f"must be a table, {got}"
        case "literal_error":
            return f"must be {str(context['expected']).replace(chr(39), chr(34))}, {got}"
        case "greater_than":
            bound = context["gt"]
            kind = "positive" if bound == 0 else f"more than {bound}"
            return f"must be {kind}, {got}"
        case "greater_than_equal":
            bound = context["ge"]
            return f"must {'not be negative' if bound == 0 else f'be at least {bound}'}, {got}"
        case "less_than":
            return f"must be less than {context['lt']}, {got}"
        case "too_short":
            return f"needs at least {context['min_length']} entry, got {context['actual_length']}"
    return f"{error['msg'][0].lower()}{error['msg'][1:]}, {got}"
