"""Keys of a system's scenario files as text: values, default and meaning, table by table."""

from collections.abc import Iterator
from dataclasses import MISSING
from typing import Annotated, Any, Literal, get_args, get_origin

import numpy as np
from numpy import ndarray as Array

from sato.scenario.definition import Definition, Field, fields_of, is_named_tuple, kinds_of
from sato.scenario.errors import format_value, join_names
from sato.scenario.table import layout
from sato.systems import definition_of

NAMES = {int: "integer", float: "number", str: "text", bool: "true or false", Array: "list"}
BOUNDS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}  # attributes of annotated_types


def format_keys(system: str) -> str:
    """List the keys of a system's scenario files, a block a table.

    Raises:
        InputError: There is no such system.
    """
    blocks = [f"system = {format_value(system)}\n"]
    rest: list[tuple[str, type]] = []
    for table, entries in layout(definition_of(system)).tables.items():
        fields = [entry.field for entry in entries.values()]
        blocks.append(_format_table(f"[{table}]" if table else "", fields))
        rest += _definitions(fields, f"{table}." if table else "")
    done = set()
    while rest:
        address, definition = rest.pop(0)
        if definition in done:
            continue
        done.add(definition)
        fields = [field for field in fields_of(definition) if field.name != "kind"]
        kinds = kinds_of(definition)
        kind = f", kind = {join_names(map(format_value, kinds))}" if kinds else ""
        blocks.append(_format_table(f"{address}{kind}", fields))
        rest += _definitions(fields, f"{address}.")
    return "\n".join(blocks)


def _definitions(fields: list[Field], prefix: str) -> Iterator[tuple[str, type]]:
    for field in fields:
        for variant in field.variants:
            if issubclass(variant, Definition) or is_named_tuple(variant):
                address = f"[{prefix}{field.key}]" if not field.is_inline else f"[{prefix[:-1]}]"
                yield address.replace("[[", "[").replace("].", "."), variant


def _format_table(head: str, fields: list[Field]) -> str:
    rows = [
        (
            "kind" if field.is_inline else field.full_key,
            _values(field),
            _default(field),
            field.meaning,
        )
        for field in fields
    ]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(3)]
    lines = [
        "  " + "  ".join([*(f"{t:{w}}" for t, w in zip(row, widths, strict=False)), row[3]])
        for row in rows
    ]
    return "\n".join([head, *(line.rstrip() for line in lines), ""] if head else [*lines, ""])


def _values(field: Field) -> str:
    if field.variants:
        kinds = [kind for variant in field.variants for kind in kinds_of(variant)]
        text = f"kind {join_names(kinds)}" if kinds else "table"
        return f"list of {text}s" if field.is_list and not kinds else text
    return " ".join(filter(None, (_type_name(field.hint), _bounds(field))))


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


def _bounds(field: Field) -> str:
    found = []
    for mark in _metadata(field.adapter.hint):
        for bound, sign in BOUNDS.items():
            if getattr(mark, bound, None) is not None:
                found.append(f"{sign} {getattr(mark, bound):g}")
    return " ".join(found)


def _metadata(hint: Any) -> Iterator[Any]:
    if get_origin(hint) is Annotated:
        inner, *marks = get_args(hint)
        yield from _metadata(inner)
        yield from marks


def _default(field: Field) -> str:
    if field.default is MISSING:
        return "required"
    if field.default is None or field.default == ():
        return "-"
    if isinstance(field.default, float) and np.isinf(field.default):
        return "-"
    return "see below" if field.variants else format_value(field.default)
