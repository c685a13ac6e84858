"""`--set table.key=value`: change a scenario before it is checked."""

import tomllib
from collections.abc import Iterator
from dataclasses import MISSING
from typing import Any, NamedTuple

from sato.scenario.definition import Field, kinds_of
from sato.scenario.errors import InputError, closest_name, join_names
from sato.scenario.table import Entry, layout, resolve_key

Path = tuple[str | int, ...]


class Spot(NamedTuple):
    """A table of a scenario: its path, its data, and the keys and tables that it may have."""

    path: Path
    data: dict[str, Any]
    keys: dict[str, Entry]
    tables: frozenset[str] = frozenset()  # and "kind", where a kind chooses the keys

    @property
    def names(self) -> list[str]:
        """Path without the numbers of lists."""
        return [part for part in self.path if isinstance(part, str)]

    def holds(self, key: str) -> bool:
        """Tell whether a key, in whatever unit, may stand in this table."""
        if key in self.tables:
            return True
        try:
            resolve_key(key, self.keys)
        except InputError:
            return False
        return True

    def is_given(self, key: str) -> bool:
        """Tell whether the table has the key already."""
        return any(self._name(old) == self._name(key) for old in self.data)

    def set(self, key: str, value: Any) -> None:
        """Set a key, in place of the same key in another unit."""
        for old in [k for k in self.data if self._name(k) == self._name(key)]:
            del self.data[old]
        self.data[key] = value

    def _name(self, key: str) -> str:
        is_key = key not in self.tables and self.holds(key)
        return resolve_key(key, self.keys)[0] if is_key else key


def override(data: dict[str, Any], setting: str, definition: Any) -> None:
    """Change a scenario's tables in place.

    Args:
        data: As read from TOML.
        setting: "table.key=value". Where only one table has the key, the key alone; a list of
            tables is meant as a whole unless a number picks one of them. The value is TOML,
            or else the bare text.
        definition: Mission of the system, whose keys the tables may have.

    Raises:
        InputError: There is no such key, or there is one in several tables.
    """
    address, equals, written = setting.partition("=")
    address = address.strip()
    if not equals or not address:
        raise InputError("", f'--set takes table.key=value, got "{setting}"')
    *table, key = address.split(".")
    before = set(data)
    spots = list(_spots(definition, data))
    holders = [s for s in spots if _ends_with(s.path, table) and s.holds(key)]
    whole = [s for s in spots if s.path and _ends_with(s.path, [*table, key])]
    if not holders and whole and isinstance(_value(written.strip()), dict):
        for spot in whole:
            spot.data.clear()
            spot.data.update(_value(written.strip()))
        return
    if not holders:
        raise _unknown(address, key, [s for s in spots if _ends_with(s.path, table)], spots)
    holders = [s for s in holders if s.is_given(key)] or holders
    exact = [s for s in holders if s.names == [part for part in table if not part.isdigit()]]
    holders = exact if table and exact else holders
    tables = list(dict.fromkeys(".".join([*s.names, key]) for s in holders))
    if len(tables) > 1:
        raise InputError(address, f"stands in several tables; write {join_names(tables)}")
    for spot in holders:
        spot.set(key, _value(written.strip()))
    for name in set(data) - before:
        if data[name] == {} and name != key:
            del data[name]  # added for the search alone


def _spots(definition: Any, data: dict[str, Any], path: Path = ()) -> Iterator[Spot]:
    tables = layout(definition, _inline_kind(definition, data)).tables
    for table, entries in tables.items():
        keys = {key: entry for key, entry in entries.items() if not entry.field.is_inline}
        has_tables = {key for key, entry in keys.items() if entry.field.variants}
        required = any(_is_required(entry) for entry in entries.values())
        if table and not required:
            data.setdefault(table, {})
        here = data.get(table) if table else data
        if not isinstance(here, dict):
            continue
        named = frozenset(tables) - {""} if not table else frozenset()
        has_kind = len(keys) < len(entries) or (not table and bool(kinds_of(definition)))
        named |= {"kind"} if has_kind else set()
        yield Spot((*path, table) if table else path, here, keys, named)
        for key in has_tables:
            yield from _inner(keys[key].field, here.get(key), (*path, *filter(None, (table,)), key))


def _inner(field: Field, value: Any, path: Path) -> Iterator[Spot]:
    numbered: list[tuple[Path, Any]] = [(path, value)]
    if isinstance(value, list):
        numbered = [((*path, i), part) for i, part in enumerate(value)]
    for where, part in numbered:
        if isinstance(part, dict):
            variant = _variant(field, part)
            if variant is not None:
                yield from _spots(variant, part, where)


def _variant(field: Field, data: dict[str, Any]) -> type | None:
    if len(field.variants) == 1:
        return field.variants[0]
    named = (v for v in field.variants if data.get("kind") in kinds_of(v))
    return next(named, None)


def _inline_kind(definition: Any, data: dict[str, Any]) -> str | None:
    for table, entries in layout(definition).tables.items():
        for entry in entries.values():
            held = data.get(table)
            if entry.field.is_inline and isinstance(held, dict):
                known = [kind for variant in entry.field.variants for kind in kinds_of(variant)]
                return held["kind"] if held.get("kind") in known else None
    return None


def _is_required(entry: Entry) -> bool:
    # A table that may be absent as a whole has an owner with a default.
    return (entry.owners or (entry.field,))[0].default is MISSING


def _ends_with(path: Path, wanted: list[str]) -> bool:
    # Numbers of a list may be left out of what is wanted, and then mean all of it.
    left = list(path)
    for part in reversed(wanted):
        while left and isinstance(left[-1], int) and not part.isdigit():
            left.pop()
        if not left or str(left.pop()) != part:
            return False
    return True


def _unknown(address: str, key: str, near: list[Spot], spots: list[Spot]) -> InputError:
    for spot in near:
        # A key that lacks its unit tells what was meant.
        try:
            resolve_key(key, spot.keys)
        except InputError as error:
            if "there is no such key" not in error.reason:
                return InputError(address, error.reason)
    known = [".".join([*spot.names, name]) for spot in spots for name in spot.keys]
    short = {name.rsplit(".", 1)[-1]: name for name in reversed(known)}
    close = closest_name(address, known) or short.get(closest_name(key, short) or "")
    hint = f"did you mean {close}?" if close else "`sato keys SYSTEM` lists the keys"
    return InputError(address, f"there is no such key in this scenario; {hint}")


def _value(written: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {written}")
    except tomllib.TOMLDecodeError:
        return written
    return parsed["value"] if list(parsed) == ["value"] else written
