"""Between definitions and the tables of a scenario file."""

from collections.abc import Collection, Iterator
from dataclasses import MISSING
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from dynamics.inputs import LARGEST, is_marked
from dynamics.quantities import to_si
from dynamics.units import SUFFIXES, split_unit
from sato.scenario.definition import (
    Field,
    errors_in,
    fields_of,
    is_named_tuple,
    kinds_of,
    map_numbered,
)
from sato.scenario.errors import InputError, closest_name, format_value, join_names

MANY_TABLES = 10_000  # of one kind, such as legs
OWN = "own"  # kind of a value of the user's own
_SI = {unit.quantity: suffix for suffix, unit in SUFFIXES.items() if unit.factor == 1.0}
RENAMED = {  # keys of version 0.1
    "centre_m": "center_m",
    "commit_steps": "freeze_steps",
    "normalise": "normalize",
    "relinearise": "relinearize",
}


class Entry(NamedTuple):
    """Field that a key fills, and the names of the attributes that lead to it."""

    path: tuple[str, ...]
    field: Field


# By table, "" being the definition's own, and key; None for names of tables, and for the kind
# that only chooses a definition.
Layout = dict[str, dict[str, Entry | None]]


def layout(definition: Any, inline: type | None = None) -> Layout:
    """List the tables and keys of a class of definitions, and of the inline one if it is known."""
    tables: Layout = {"": {"kind": None} if kinds_of(definition) else {}}
    for table, entry in _entries(definition, (), ""):
        keys = tables.setdefault(table, {})
        if not entry.field.is_inline:
            keys[entry.field.key] = entry
        elif inline is None:
            keys["kind"] = entry
        else:
            keys["kind"] = None
            keys |= {inner.field.key: inner for _, inner in _entries(inline, entry.path, table)}
    for table in tables:
        if table:
            tables[""].setdefault(table, None)
    return tables


def read_table(definition: Any, data: dict[str, Any]) -> Any:
    """Build a definition from the table of a file, as TOML or JSON have it."""
    values: dict[tuple[str, ...], Any] = {}
    inline = None
    for field in fields_of(definition):
        if field.is_inline:
            with errors_in(field.table):
                inline = values[(field.name,)] = choose(field, data.get(field.table, {}))
    for table, entries in layout(definition, inline).items():
        with errors_in(table):
            values |= _read_keys(entries, data.get(table, {}) if table else data)
    return _build(definition, values)


def write_table(value: Any) -> dict[str, Any]:
    """Write a definition as the table of a file; what is not given is left out.

    A value that no file can hold, as a model of the user's own, is written as kind "own", with the
    name of its class.
    """
    held: Any = None  # by the inline field
    own: dict[str, dict[str, Any]] = {}  # tables of values of the user's own
    for field in fields_of(type(value)):
        if field.is_inline or field.is_nested:
            part = getattr(value, field.name)
            if part is not None and type(part) not in field.variants:
                own[field.table if field.is_inline else field.key] = name_class(part)
            elif field.is_inline:
                held = part
    written: dict[str, Any] = {}
    for table, entries in layout(type(value), None if held is None else type(held)).items():
        rows = dict(own.get(table, {}))
        for key, entry in entries.items():
            if entry is not None:
                part = reduce(lambda at, name: getattr(at, name, None), entry.path, value)
                is_own = table in own and (entry.field.is_inline or len(entry.path) > 1)
                plain = None if is_own else _plain(part, entry.field.variants)
            else:
                plain = (held if table else value).kind if key == "kind" else None
            if plain is not None:
                rows.setdefault(key, plain)
        if table and rows:
            written[table] = rows
        elif not table:
            written = rows
    return written


def name_class(value: object) -> dict[str, str]:
    """Return the table that stands for a value that no file can hold: the name of its class."""
    kind = type(value)
    return {"kind": OWN, "class": f"{kind.__module__}.{kind.__qualname__}"}


def find_own(data: Any, address: str = "") -> Iterator[tuple[str, str]]:
    """Yield address and class of each value of the user's own that a file names.

    The class of a model is empty in files of earlier versions.
    """
    parts: Any = data.items() if isinstance(data, dict) else ()
    if isinstance(data, dict) and data.get("kind") == OWN:
        if "class" in data or address == "model":
            yield address, str(data.get("class", ""))
    elif isinstance(data, list) and any(isinstance(part, dict) for part in data):
        parts = enumerate(data)
    for key, part in parts:
        yield from find_own(part, f"{address}.{key}" if address else str(key))


def choose(field: Field, data: Any) -> type:
    """Choose among the definitions that a field may hold, by the kind in a table."""
    if not isinstance(data, dict):
        raise InputError("", f"must be a table, got {format_value(data)}")
    if not field.kinds:
        return field.variants[0]
    kind, names = data.get("kind"), join_names(map(format_value, field.kinds), "and")
    if kind is None:
        raise InputError("kind", f"is missing; there are {names}")
    if not isinstance(kind, str):
        raise InputError("kind", f"there is no kind {format_value(kind)}, only {names}")
    if kind in field.kinds:
        return field.kinds[kind]
    close = closest_name(str(kind), field.kinds)
    hint = f'; did you mean "{close}"?' if close else ""
    raise InputError("kind", f"there is no kind {format_value(kind)}, only {names}{hint}")


def find_key(key: str, known: Collection[str]) -> str | None:
    """Find the known key that is meant, perhaps with another unit of the same kind."""
    base, unit = split_unit(key)
    si = f"{base}_{_SI[SUFFIXES[unit].quantity]}" if unit else key
    return next((name for name in (key, si) if name in known), None)


def unknown_key(address: str, known: Collection[str]) -> InputError:
    """Return the error of a key that is not known, with the one that was likely meant."""
    renamed = RENAMED.get(address.rsplit(".", 1)[-1])
    if renamed in {name.rsplit(".", 1)[-1] for name in known}:
        return InputError(address, f"is now called {renamed}")
    base, unit = split_unit(address)
    similar = {split_unit(name)[0]: name for name in reversed([*known]) if name != address}
    if base in similar:
        fault = "has no unit" if unit is None else "has the wrong unit"
        return InputError(address, f"{fault}; write {similar[base].rsplit('.', 1)[-1]}")
    close = closest_name(address, known)
    hint = f"did you mean {close}?" if close else "`sato keys SYSTEM` lists the keys"
    return InputError(address, f"there is no such key; {hint}")


def _entries(definition: Any, path: tuple[str, ...], table: str) -> Iterator[tuple[str, Entry]]:
    for field in fields_of(definition):
        inner = (*path, field.name)
        if field.is_nested:
            yield from _entries(field.variants[0], inner, field.key)
        else:
            yield field.table or table, Entry(inner, field)


def _read_keys(entries: dict[str, Entry | None], given: Any) -> dict[tuple[str, ...], Any]:
    if not isinstance(given, dict):
        raise InputError("", f"must be a table, got {format_value(given)}")
    values: dict[tuple[str, ...], Any] = {}
    for key, value in given.items():
        name = find_key(key, entries)
        if name is None and (hasattr(value, "unit") or hasattr(value, "units")):
            name = next((known for known in entries if split_unit(known)[0] == key), None)
        if name is None:
            raise unknown_key(key, entries)
        entry = entries[name]
        if entry is None:
            continue
        if entry.path in values:
            other = next(k for k in given if find_key(k, entries) == name)
            raise InputError(key, f"is given twice; one of it and {other} is enough")
        unit = split_unit(key)[1]
        with errors_in(key):
            plain = value if entry.field.variants else to_si(value, entry.field.unit)
            if unit is not None and key != name and plain is value:
                plain = _scaled(value, SUFFIXES[unit].factor)
            values[entry.path] = _read_value(entry.field, plain)
    return values


def _read_value(field: Field, value: Any) -> Any:
    if not field.variants:
        return value
    if field.is_list and isinstance(value, list):
        if len(value) > MANY_TABLES:
            raise InputError("", f"has {len(value):,} tables; {MANY_TABLES:,} or fewer would do")
        return map_numbered(lambda part: _read_definition(field, part), value)
    found = _read_definition(field, value)
    return (found,) if field.is_list else found


def _read_definition(field: Field, value: Any) -> Any:
    if isinstance(value, str) and field.kinds:
        value = {"kind": value}
    if isinstance(value, dict) and "file" in value and "file" in field.kinds:
        value = {"kind": "file"} | value
    return read_table(choose(field, value), value)


def _build(definition: type, values: dict[tuple[str, ...], Any]) -> Any:
    """Construct a definition, nested ones first, from the values of its fields by path."""
    arguments: dict[str, Any] = {}
    for field in fields_of(definition):
        inner = {path[1:]: value for path, value in values.items() if path[0] == field.name}
        own = inner.pop((), MISSING)
        if field.is_inline or (field.is_nested and (inner or field.default is MISSING)):
            with errors_in(field.address):
                arguments[field.name] = _build(own if field.is_inline else field.variants[0], inner)
        elif own is not MISSING:
            arguments[field.name] = own
        elif field.default is MISSING:
            raise InputError(field.address, "is missing, and has no default")
    return definition(**arguments)


def _plain(value: Any, variants: tuple[type, ...] = ()) -> Any:
    if type(value) in variants:
        return write_table(value)
    if isinstance(value, Array):
        return value.tolist()
    if isinstance(value, tuple) and not is_named_tuple(type(value)):
        parts = [part if isinstance(part, float) else _plain(part, variants) for part in value]
        return parts or None
    if variants and value is not None:
        return name_class(value)
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _scaled(value: Any, factor: float) -> Any:
    # Text, tables and huge numbers are left as they are: the check of the field refuses them.
    if (
        isinstance(value, dict)
        or is_marked(value)
        or getattr(value, "dtype", np.dtype(float)).names
    ):
        raise InputError("", "has labels, and is taken in the SI unit alone")
    if isinstance(value, Array | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_scaled(part, factor) for part in value]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return value * factor if is_number and abs(value) <= LARGEST else value
