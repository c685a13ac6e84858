"""`--set table.key=value`: change a scenario before it is checked."""

import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy import ndarray as Array

from sato.scenario.definition import Field, fields_of
from sato.scenario.errors import InputError, format_value, join_names
from sato.scenario.table import Entry, choose, find_key, layout, unknown_key

NUMBER = re.compile(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)
NONE = object()  # value that takes a key away, unless the key has a value "none"
Path = tuple[str | int, ...]


class Spot(NamedTuple):
    """A table of a scenario: its path, its data, and the keys that it may have."""

    path: Path
    data: dict[str, Any]
    entries: dict[str, Entry | None]

    def same_keys(self, key: str) -> list[str]:
        """List the keys of the data that have the meaning of this one, in whatever unit."""
        name = find_key(key, self.entries)
        return [old for old in self.data if find_key(old, self.entries) == name]

    def takes_none(self, key: str, is_text: bool) -> bool:
        """Tell whether "none" is a value of a key, or any text is, if it is given as one."""
        entry = self.entries[str(find_key(key, self.entries))]
        kinds = () if entry is None else (entry.field.hint, *get_args(entry.field.hint))
        return "none" in kinds or (is_text and (entry is None or str in kinds))

    def address(self, key: str) -> str:
        """Return the key with its tables, without the numbers of lists."""
        return ".".join([*(part for part in self.path if isinstance(part, str)), key])


Setting = str | tuple[str, Any]
Settings = Iterable[Setting] | Mapping[str, Any]


def list_settings(overrides: Settings) -> tuple[Setting, ...]:
    """List overrides, texts or pairs of key and value, or a dict of these."""
    return tuple(overrides.items() if isinstance(overrides, Mapping) else overrides)


def write_value(value: Any) -> str:
    """Write a value of a setting as TOML, in one line."""
    if isinstance(value, dict):
        rows = ", ".join(f"{json.dumps(key)} = {write_value(part)}" for key, part in value.items())
        return f"{{{rows}}}"
    if value is None:  # of a key that is taken away
        return "none"
    plain = value.tolist() if type(value) is Array or isinstance(value, np.generic) else value
    if isinstance(plain, list | tuple):
        return f"[{', '.join(map(write_value, plain))}]"
    if not isinstance(plain, bool | str | int | float):
        raise InputError("", f"must be a number, text, list or table, got {format_value(value)}")
    return repr(plain) if isinstance(plain, float) else json.dumps(plain)


def override(data: dict[str, Any], setting: Setting, definition: Any) -> str:
    """Change a scenario's tables in place.

    Args:
        data: As read from TOML.
        setting: "table.key=value", or the key and the value. Where only one table has the key,
            the key alone; a list of tables is meant as a whole unless a number picks one of
            them. The value of a text is TOML, or else the bare text. None takes the key away, as
            the bare text none does unless it is a value of the key.
        definition: Mission of the system, whose keys the tables may have.

    Returns:
        The key with all its tables, as in "swarm.agents".

    Raises:
        InputError: There is no such key, or there is one in several tables.
    """
    address, value = _split(setting) if isinstance(setting, str) else setting
    key, plain = address.split(".")[-1], _without_numbers(address)
    holders = _find_holders(data, address, definition)
    for spot in holders:
        for old in spot.same_keys(key):
            del spot.data[old]
        is_text = isinstance(value, str) and value == "none"  # the word of a campaign's file
        is_none = value is NONE or is_text
        if value is None or (is_none and not spot.takes_none(key, is_text)):
            continue
        table: Any = data
        for part in spot.path:
            table = table.setdefault(part, {}) if isinstance(part, str) else table[part]
        table[key] = "none" if value is NONE else _copied(address, value)
    # Numbers pick tables of a list.
    return holders[0].address(key) if address == plain else address


def _copied(address: str, value: Any) -> Any:
    try:
        return deepcopy(value)
    except (TypeError, RecursionError) as error:
        raise InputError(address, f"takes no value such as {format_value(value)}") from error


def find_places(data: dict[str, Any], address: str, definition: Any) -> set[tuple[Path, str]]:
    """Return the places that a setting of a key, in any unit, changes: table and key."""
    key = address.split(".")[-1]
    holders = _find_holders(data, address, definition)
    return {(spot.path, str(find_key(key, spot.entries))) for spot in holders}


def _find_holders(data: dict[str, Any], address: str, definition: Any) -> list[Spot]:
    *tables, key = address.split(".")
    plain, spots = _without_numbers(address), list(_spots(definition, data))
    holders = [s for s in spots if find_key(key, s.entries) and _ends_with(s.path, tables)]
    if not holders:
        raise _unknown(address, plain, spots)
    holders = [s for s in holders if s.same_keys(key)] or holders
    if tables:
        holders = [s for s in holders if s.address(key) == plain] or holders
    addresses = list(dict.fromkeys(s.address(key) for s in holders))
    if len(addresses) > 1:
        raise InputError(address, f"stands in several tables; write {join_names(addresses)}")
    return holders


def _without_numbers(address: str) -> str:
    return ".".join(part for part in address.split(".") if not part.isdigit())


def _split(setting: str) -> tuple[str, Any]:
    address, equals, written = setting.partition("=")
    if not equals or not address.strip():
        raise InputError("", f'--set takes table.key=value, got "{setting}"')
    return address.strip(), _parse_value(written.strip())


def _spots(definition: Any, data: dict[str, Any], path: Path = ()) -> Iterator[Spot]:
    inline = [_chosen(f, data.get(f.table)) for f in fields_of(definition) if f.is_inline]
    for table, entries in layout(definition, *inline).items():
        here = data.get(table, {}) if table else data
        if not isinstance(here, dict):
            continue
        where = (*path, table) if table else path
        yield Spot(where, here, entries)
        for key, entry in entries.items():
            if entry is None or not entry.field.variants:
                continue
            value: Any = here.get(key)
            parts = enumerate(value) if isinstance(value, list) else [(None, value)]
            for number, part in parts:
                variant = _chosen(entry.field, part)
                if variant is not None:
                    inner = (*where, key) if number is None else (*where, key, number)
                    yield from _spots(variant, part, inner)


def _chosen(field: Field, data: Any) -> type | None:
    try:
        return choose(field, data)
    except InputError:
        return None  # which is refused when the table is read


def _ends_with(path: Path, wanted: list[str]) -> bool:
    # Numbers of a list may be left out of what is wanted, and then mean all of it.
    left = list(path)
    for part in reversed(wanted):
        while left and isinstance(left[-1], int) and not part.isdigit():
            left.pop()
        if not left or str(left.pop()) != part:
            return False
    return True


def _unknown(address: str, plain: str, spots: list[Spot]) -> InputError:
    known = []
    for spot in spots:
        for key in spot.entries:
            parts = spot.address(key).split(".")
            known += [".".join(parts[i:]) for i in range(len(parts))]
    table, _, key = plain.rpartition(".")
    for spot in spots:  # of a table that is not there
        entry = spot.entries.get(table.rpartition(".")[2])
        if entry and f".{spot.address(entry.field.key)}".endswith(f".{table}"):
            if any(find_key(key, layout(kind)[""]) for kind in entry.field.variants):
                return InputError(address, _suggest_table(address, table, entry.field, spot.data))
    return InputError(address, unknown_key(plain, known).reason)


def _suggest_table(address: str, table: str, field: Field, data: dict[str, Any]) -> str:
    """Say why a table has no such key, and how a whole one is given."""
    there, whole = data.get(field.key), address.rpartition(".")[0]
    if field.is_list and not field.kinds:
        count = len(there) if isinstance(there, list) else 0
        fault = f"is of a table that is not there: of {table} there are {count}"
        return f"{fault}; {table}=[{{…}}, …], with all of them, would do"
    fault = "is of another kind" if isinstance(there, dict) else "is no table yet"
    kind = 'kind = "…"' if field.kinds else "…"
    return f"{table} {fault}; {whole}={{{kind}}}, with all of its keys, would do"


def _parse_value(written: str) -> Any:
    if written == "none":  # in quotes it is a text
        return NONE
    if NUMBER.fullmatch(written):  # which TOML wants with a zero
        return float(written)
    try:
        parsed = tomllib.loads(f"value = {written}")
    except (ValueError, RecursionError):
        return written
    return parsed["value"] if list(parsed) == ["value"] else written
