"""Schema of a table that anybody may have made: plain columns, and nothing that computes."""

import re
import sqlite3
from collections.abc import Iterable
from pathlib import Path

from sato.scenario.errors import InputError

NAMES = {"campaign", "scenarios", "runs"}
QUOTED = re.compile(r'"(?:[^"]|"")*"')
# CREATE TABLE with names, types and keys alone.
PLAIN = re.compile(
    r"CREATE TABLE \w+ ?\((?:(?:\w+|\"\")(?: (?:TEXT|INTEGER|REAL|BOOLEAN|NOT NULL|PRIMARY KEY))*"
    r"(?:, ?|(?=\))))+\)(?: WITHOUT ROWID)?"
)


def check_schema(path: Path, connection: sqlite3.Connection, columns: Iterable[str]) -> None:
    """Refuse a database with views, triggers, computed columns, or without tables and columns."""
    known = set[str]()
    for kind, name, sql in connection.execute("SELECT type, name, sql FROM sqlite_master"):
        is_plain = kind == "table" and PLAIN.fullmatch(QUOTED.sub('""', str(sql))) is not None
        if name not in NAMES or not is_plain:
            raise InputError("", f"{path}: is no campaign, for {kind} {name} is none of its tables")
        if "\N{REPLACEMENT CHARACTER}" in sql:  # in place of bytes that are no UTF-8
            raise InputError("", f"{path}: is damaged: a name of its columns is no text")
        known.add(name)
    if known != NAMES:
        raise InputError("", f"{path}: is no campaign, for it has no table {min(NAMES - known)}")
    there = {row[1] for row in connection.execute("PRAGMA table_info(runs)")}
    if missing := [name for name in columns if name not in there]:
        raise InputError("", f"{path}: is no campaign, for its rows have no column {missing[0]}")


def check_pages(path: Path, connection: sqlite3.Connection) -> None:
    """Refuse a database whose pages lead back, and have more rows than there is room for."""
    (found,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if found != "ok":
        raise InputError("", f"{path}: is damaged: {' '.join(found.split())}")
