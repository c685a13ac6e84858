"""`--set table.key=value`: a scenario with something else in it."""

import tomllib
from collections.abc import Iterator
from types import UnionType
from typing import Any, NamedTuple, Union, get_args, get_origin

from sato.former.refusal import Refusal, listed, nearest
from sato.former.units import Table, meaning

Path = tuple[str | int, ...]


class Spot(NamedTuple):
    """A table of a scenario, and where in the file it is."""

    path: Path
    data: dict[str, Any]
    kind: type[Table]


def override(data: dict[str, Any], setting: str, schema: type[Table]) -> None:
    """Change a scenario's tables in place, before they are checked.

    Args:
        data: As read from TOML.
        setting: "table.key=value". Where only one table has the key, the key alone; a list of
            tables is meant as a whole unless a number picks one of them. The value is TOML,
            or else the bare text.
        schema: What the tables may hold.

    Raises:
        Refusal: There is no such key, or there is one in several tables.
    """
    address, equals, written = setting.partition("=")
    address = address.strip()
    if not equals or not address:
        raise Refusal("", f'--set takes table.key=value, got "{setting}"')
    *table, key = address.split(".")
    there = set(data)
    spots = [s for s in _spots(schema, data) if _ends_with(s.path, table)]
    looked_into = set(data) - there
    holders = [s for s in spots if _holds(s, key)]
    if not holders:
        raise _unknown(address, key, spots, schema, data)
    exact = [s for s in holders if _names(s.path) == [p for p in table if not p.isdigit()]]
    holders = exact if table and exact else holders
    tables = list(dict.fromkeys(".".join([*_names(s.path), key]) for s in holders))
    if len(tables) > 1:
        raise Refusal(address, f"stands in several tables; write {listed(tables)}")
    for spot in holders:
        meant = meaning(key, spot.kind.model_fields)
        for old in [k for k in spot.data if _same(k, meant[0], spot.kind)]:
            del spot.data[old]
        spot.data[key] = _value(written.strip())
    for name in looked_into:
        if data[name] == {} and name != key:
            del data[name]  # not what was meant


def _spots(kind: type[Table], data: dict[str, Any], path: Path = ()) -> Iterator[Spot]:
    yield Spot(path, data, kind)
    for name, field in kind.model_fields.items():
        kinds = _tables(field.annotation)
        if len(kinds) == 1 and not any(f.is_required() for f in kinds[0].model_fields.values()):
            data.setdefault(name, {})
        value = data.get(name)
        numbered: list[tuple[Path, Any]] = [((name,), value)]
        if isinstance(value, list):
            numbered = [((name, i), part) for i, part in enumerate(value)]
        for where, part in numbered:
            if isinstance(part, dict) and (found := _of_kind(kinds, part)) is not None:
                yield from _spots(found, part, (*path, *where))


def _tables(annotation: Any) -> list[type[Table]]:
    if isinstance(annotation, type) and get_origin(annotation) is None:
        return [annotation] if issubclass(annotation, Table) else []
    if get_origin(annotation) in (Union, UnionType, list) or hasattr(annotation, "__metadata__"):
        return [kind for part in get_args(annotation) for kind in _tables(part)]
    return []


def _of_kind(kinds: list[type[Table]], data: dict[str, Any]) -> type[Table] | None:
    if len(kinds) == 1:
        return kinds[0]
    for kind in kinds:
        if data.get("kind") in get_args(kind.model_fields["kind"].annotation):
            return kind
    return None


def _names(path: Path) -> list[str]:
    return [part for part in path if isinstance(part, str)]


def _ends_with(path: Path, wanted: list[str]) -> bool:
    # Numbers of a list may be left out of what is wanted, and then mean all of it.
    left = list(path)
    for part in reversed(wanted):
        while left and isinstance(left[-1], int) and not part.isdigit():
            left.pop()
        if not left or str(left.pop()) != part:
            return False
    return True


def _holds(spot: Spot, key: str) -> bool:
    try:
        meaning(key, spot.kind.model_fields)
    except Refusal:
        return False
    return True


def _same(key: str, field: str, kind: type[Table]) -> bool:
    try:
        return meaning(key, kind.model_fields)[0] == field
    except Refusal:
        return False


def _unknown(
    address: str, key: str, spots: list[Spot], schema: type[Table], data: dict[str, Any]
) -> Refusal:
    for spot in spots:
        # A key that lacks its unit knows what was meant.
        try:
            meaning(key, spot.kind.model_fields)
        except Refusal as refusal:
            if "there is no such key" not in refusal.what:
                return Refusal(address, refusal.what)
    known = [
        ".".join([*_names(s.path), field])
        for s in _spots(schema, data)
        for field in s.kind.model_fields
    ]
    short = {name.rsplit(".", 1)[-1]: name for name in reversed(known)}
    close = nearest(address, known) or short.get(nearest(key, short) or "")
    hint = f"did you mean {close}?" if close else "`sato scenarios` lists scenarios to look into"
    return Refusal(address, f"there is no such key in this scenario; {hint}")


def _value(written: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {written}")
    except tomllib.TOMLDecodeError:
        return written
    return parsed["value"] if list(parsed) == ["value"] else written
