"""Between definitions and the tables of a scenario file."""

from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray as Array

from dynamics.units import SUFFIXES, Unit
from sato.scenario.definition import Definition, Field, fields_of, is_named_tuple, kinds_of
from sato.scenario.errors import InputError, closest_name, errors_in, format_value, join_names

RENAMED = {  # former keys
    "centre_m": "center_m",
    "commit_steps": "freeze_steps",
    "normalise": "normalize",
    "relinearise": "relinearize",
}


OWN = "own"  # kind of a value of the user's own


class Entry(NamedTuple):
    """Key of a table: the field that it fills, and the definitions on the way to the field."""

    owners: tuple[Field, ...]  # nested definitions, outermost first
    field: Field

    @property
    def path(self) -> tuple[str, ...]:
        """Names of the attributes from the outermost definition to the field."""
        return (*(owner.name for owner in self.owners), self.field.name)


class TableLayout(NamedTuple):
    """Keys of a definition in a file: by table, "" being the definition's own."""

    tables: Mapping[str, Mapping[str, Entry]]


def layout(definition: Any, kind: str | None = None) -> TableLayout:
    """List the tables and keys of a definition.

    Args:
        definition: A class of definitions.
        kind: Kind of the definition whose keys stand in the same table, where one does.
    """
    tables: dict[str, dict[str, Entry]] = {"": {}}
    for entry in _entries(definition, (), ""):
        table, found = entry
        tables.setdefault(table, {})[found.field.full_key] = found
        if found.field.is_inline and kind is not None:
            variant = choose(found.field, kind)
            for _, inner in _entries(variant, (found.field,), table):
                tables[table][inner.field.full_key] = inner
    return TableLayout(tables)


def read_table(definition: Any, data: Any) -> Any:
    """Build a definition from the table of a file.

    Args:
        definition: A class of definitions.
        data: The table, as TOML or JSON have it.

    Raises:
        InputError: A key is unknown, missing, in the wrong unit, or has a wrong value.
    """
    if not isinstance(data, dict):
        raise InputError("", f"must be a table, got {format_value(data)}")
    if issubclass(definition, Definition):
        definition.check_table(data)
    found = layout(definition, _inline_kind(definition, data))
    values: dict[tuple[str, ...], Any] = {}
    for table, entries in found.tables.items():
        given = data.get(table, {}) if table else data
        if not isinstance(given, dict):
            raise InputError(table, f"must be a table, got {format_value(given)}")
        other = [name for name in found.tables if name] if not table else []
        with errors_in(table):
            values |= _read_keys(entries, given, other, bool(kinds_of(definition)))
    return _build(definition, values)


def write_table(value: Any) -> dict[str, Any]:
    """Write a definition as the table of a file; what is not given is left out.

    A value that no file can hold, as a model of the user's own, is written as kind "own".
    """
    inline = (getattr(value, f.name) for f in fields_of(type(value)) if f.is_inline)
    kind = next(map(_kind_of, inline), None)
    written: dict[str, Any] = {}
    for table, entries in layout(type(value), None if kind == OWN else kind).tables.items():
        rows = written if not table else {}
        for key, entry in entries.items():
            held = value
            for name in entry.path:
                held = getattr(held, name, None)
            if entry.field.is_inline:
                rows["kind"] = _kind_of(held)
                continue
            plain = _plain(held)
            if plain is not None:
                rows[key] = plain
        if table and rows:
            written[table] = rows
    if kinds_of(type(value)) and "kind" not in written:
        written = {"kind": _kind_of(value)} | written
    return written


def choose(field: Field, kind: Any) -> type:
    """Choose among the definitions that a field may hold.

    Raises:
        InputError: None has this kind.
    """
    known = {name: variant for variant in field.variants for name in kinds_of(variant)}
    if kind == OWN and OWN not in known:
        raise InputError("kind", '"own" is of a mission in Python, which no file can hold')
    if not isinstance(kind, str) or kind not in known:
        close = closest_name(str(kind), known)
        hint = f'; did you mean "{close}"?' if close else ""
        names = join_names((f'"{name}"' for name in known), "and")
        raise InputError("kind", f"there is no kind {format_value(kind)}, only {names}{hint}")
    return known[kind]


def resolve_key(key: str, entries: Mapping[str, object]) -> tuple[str, float]:
    """Find the key that is meant, and the factor that turns its value into SI units.

    Raises:
        InputError: There is no such key, or its unit is missing, superfluous or of another kind.
    """
    if key in entries:
        return key, 1.0
    base, suffix = split_unit(key)
    for si in (name for name, of in SUFFIXES.items() if of.factor == 1.0):
        if suffix and SUFFIXES[si].quantity == SUFFIXES[suffix].quantity:
            if f"{base}_{si}" in entries:
                return f"{base}_{si}", SUFFIXES[suffix].factor
    measured = {split_unit(name)[0]: name for name in entries if split_unit(name)[1]}
    if suffix is None and base in measured:
        raise InputError(key, f"has no unit; write {measured[base]}")
    if suffix and base in measured:
        right = Unit(str(split_unit(measured[base])[1])).quantity
        wrong = Unit(suffix).quantity
        raise InputError(key, f"is in a unit of {wrong}, not of {right}; write {measured[base]}")
    if suffix and base in entries:
        raise InputError(key, f"is a number without a unit; write {base}")
    if RENAMED.get(key) in entries:
        raise InputError(key, f"is now called {RENAMED[key]}")
    close = closest_name(key, entries)
    hint = f"did you mean {close}?" if close else f"the keys here are {', '.join(entries)}"
    raise InputError(key, f"there is no such key; {hint}")


def split_unit(key: str) -> tuple[str, str | None]:
    """Split a key from the suffix of its unit."""
    for suffix in SUFFIXES:
        if key.endswith(f"_{suffix}"):
            return key.removesuffix(f"_{suffix}"), suffix
    return key, None


def _entries(definition: Any, owners: tuple[Field, ...], table: str) -> Iterator[tuple[str, Entry]]:
    for field in fields_of(definition):
        home = field.table if field.table is not None else table
        if field.is_nested:
            inner = field.key if not home else f"{home}.{field.key}"
            yield from _entries(field.variants[0], (*owners, field), inner)
        else:
            yield home, Entry(owners, field)


def _inline_kind(definition: type, data: dict[str, Any]) -> str | None:
    for table, entry in _entries(definition, (), ""):
        if entry.field.is_inline:
            held = data.get(table)
            if not isinstance(held, dict) or "kind" not in held:
                raise InputError(table, "needs a kind" if held is not None else "is missing")
            with errors_in(table):
                choose(entry.field, held["kind"])
            return str(held["kind"])
    return None


def _read_keys(
    entries: Mapping[str, Entry], given: dict[str, Any], tables: list[str], is_tagged: bool
) -> dict[tuple[str, ...], Any]:
    values: dict[tuple[str, ...], Any] = {}
    keys = {key: entry for key, entry in entries.items() if not entry.field.is_inline}
    inline = [entry for entry in entries.values() if entry.field.is_inline]
    is_tagged = is_tagged or bool(inline)
    for key, value in given.items():
        if key in tables or (key == "kind" and key not in keys and is_tagged):
            continue
        name, factor = resolve_key(key, keys)
        entry = keys[name]
        if entry.path in values:
            raise InputError(key, f"is given twice; one of it and {name} is enough")
        with errors_in(key):
            values[entry.path] = _read_value(entry.field, _scaled(value, factor))
    for entry in inline:
        values[entry.path] = choose(entry.field, given["kind"])
    return values


def _read_value(field: Field, value: Any) -> Any:
    if not field.variants:
        return value
    if field.is_list:
        given = [value] if isinstance(value, dict) else value
        if not isinstance(given, list):
            raise InputError("", f"must be a list of tables, got {format_value(value)}")
        found = []
        for number, one in enumerate(given):
            with errors_in(str(number) if isinstance(value, list) else ""):
                found.append(_read_record(field, one))
        return tuple(found)
    return _read_record(field, value)


def _read_record(field: Field, value: Any) -> Any:
    kinds = [kind for variant in field.variants for kind in kinds_of(variant)]
    if isinstance(value, str) and kinds:
        value = {"kind": value}
    if not isinstance(value, dict):
        raise InputError("", f"must be a table, got {format_value(value)}")
    if not kinds:
        return read_table(field.variants[0], value)
    if "kind" not in value and "file" in value and "file" in kinds:
        value = {"kind": "file"} | value
    if "kind" not in value:
        raise InputError("", "needs a kind")
    return read_table(choose(field, value["kind"]), value)


def _build(definition: type, values: dict[tuple[str, ...], Any]) -> Any:
    """Construct a definition, nested ones first, from the values of its fields by path."""
    arguments: dict[str, Any] = {}
    for field in fields_of(definition):
        inner = {path[1:]: value for path, value in values.items() if path[0] == field.name}
        own = inner.pop((), MISSING)
        if field.is_inline or (field.is_nested and (inner or field.default is MISSING)):
            with errors_in(str(field.table) if field.is_inline else field.key):
                arguments[field.name] = _build(own if field.is_inline else field.variants[0], inner)
        elif own is not MISSING:
            arguments[field.name] = own
        elif field.default is MISSING:
            reason = "is missing, and has no default"
            raise InputError(field.address, reason, is_complete=field.table is not None)
    return definition(**arguments)


def _kind_of(value: Any) -> Any:
    if not (isinstance(value, Definition) or is_named_tuple(type(value))):
        return OWN
    kinds = kinds_of(type(value))
    return value.kind if hasattr(value, "kind") else kinds[0]


def _plain(value: Any) -> Any:
    if isinstance(value, Definition) or is_named_tuple(type(value)):
        return write_table(value)
    if isinstance(value, Array):
        return value.tolist()
    if isinstance(value, tuple):
        return [_plain(part) for part in value] or None
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _scaled(value: Any, factor: float) -> Any:
    # Text and tables are left as they are: the check of the field refuses them.
    if factor == 1.0:
        return value
    if isinstance(value, list):
        return [_scaled(part, factor) for part in value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return value * factor
