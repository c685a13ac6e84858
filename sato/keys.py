"""Keys of a system's scenario files as text: values, default and meaning, table by table."""

from dataclasses import MISSING
from math import inf
from typing import Annotated, Any, Literal, get_args, get_origin

from numpy import ndarray as Array

from sato.scenario.definition import EACH, Field, kinds_of
from sato.scenario.errors import format_value, join_names
from sato.scenario.table import layout
from sato.systems import definition_of

NAMES = {int: "integer", float: "number", str: "text", bool: "true or false", Array: "list"}
BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}  # attributes of annotated_types


def format_keys(system: str) -> str:
    """List the keys of a system's scenario files, a block a table."""
    blocks = [f"system = {format_value(system)}\n"]
    listed: list[tuple[str, Any]] = [("", definition_of(system))]
    for head, definition in listed:
        kinds = kinds_of(definition)
        for table, entries in layout(definition).items():
            place = ".".join(filter(None, (head, table)))
            fields = {key: entry.field for key, entry in entries.items() if entry is not None}
            for key, field in fields.items():
                inner = place if field.is_inline else f"{place}.{key}".removeprefix(".")
                known = {definition for _, definition in listed}
                listed += [(inner, variant) for variant in field.variants if variant not in known]
            if kinds:
                fields.pop("kind", None)
            kind = f", kind = {join_names(map(format_value, kinds))}" if kinds else ""
            blocks.append(_format_table(f"[{place}]{kind}\n" if place else "", fields))
    return "\n".join(blocks)


def _format_table(head: str, fields: dict[str, Field]) -> str:
    rows = [(key, _values(of), _default(of), _meaning(key, of)) for key, of in fields.items()]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(3)]
    for row in rows:
        cells = [f"{text:{width}}" for text, width in zip(row, widths, strict=False)]
        head += "  ".join(["", *cells, row[3]]).rstrip() + "\n"
    return head


def _meaning(key: str, field: Field) -> str:
    # With the name of the attribute where that is another.
    is_same = key.startswith(field.name)
    return field.meaning if is_same else f"{field.meaning}; {field.name} in Python"


def _values(field: Field) -> str:
    if field.variants:
        text = f"kind {join_names(field.kinds)}" if field.kinds else "table"
        return f"list of {text}s" if field.is_list and not field.kinds else text
    bounds = [
        f"{sign} {getattr(mark, bound):g}"
        for mark in field.marks
        for bound, sign in BOUNDS.items()
        if getattr(mark, bound, None) is not None
    ]
    either = ["or list"] if EACH in field.marks else []
    return " ".join([_type_name(field.hint), *bounds, *either])


def _type_name(hint: Any) -> str:
    if get_origin(hint) is Annotated:
        return _type_name(get_args(hint)[0])
    if get_origin(hint) is Literal:
        return join_names(map(format_value, get_args(hint)))
    options = [option for option in get_args(hint) if option not in (type(None), Ellipsis)]
    if get_origin(hint) is tuple:
        inner = _type_name(options[0])
        is_list = inner.startswith("list of")
        return f"list of lists{inner.removeprefix('list')}" if is_list else f"list of {inner}s"
    if options:
        return join_names(map(_type_name, options))
    return NAMES.get(hint, getattr(hint, "__name__", str(hint)))


def _default(field: Field) -> str:
    if field.default is MISSING:
        return "required"
    if field.default in (None, (), inf):
        return "-"
    return "see below" if field.variants else format_value(field.default)
