"""Sentences about values of the wrong type or size, from pydantic's list of errors."""

from typing import Any

from pydantic import ValidationError

from sato.scenario.errors import InputError, format_value


def explain(error: ValidationError) -> InputError:
    """Turn the first of pydantic's errors into one sentence."""
    first: Any = error.errors(include_url=False)[0]
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return cause
    where = ".".join(str(part) for part in first["loc"] if isinstance(part, int))
    return InputError(where, _sentence(first))


def _sentence(error: Any) -> str:
    context, got = error.get("ctx", {}), f"got {format_value(error['input'])}"
    match error["type"]:
        case "int_type" | "int_from_float":
            return f"must be an integer, {got}"
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
        case "list_type" | "tuple_type":
            return f"must be a list, {got}"
        case "literal_error":
            return f"must be {str(context['expected']).replace(chr(39), chr(34))}, {got}"
        case "greater_than":
            bound = context["gt"]
            return f"must be {'positive' if bound == 0 else f'more than {bound}'}, {got}"
        case "greater_than_equal":
            bound = context["ge"]
            return f"must {'not be negative' if bound == 0 else f'be at least {bound}'}, {got}"
        case "less_than":
            return f"must be less than {context['lt']}, {got}"
        case "less_than_equal":
            return f"must be at most {context['le']}, {got}"
        case "too_short":
            return f"needs at least {context['min_length']} entries, got {len(error['input'])}"
    return f"{error['msg'][0].lower()}{error['msg'][1:]}, {got}"
