"""Export of a campaign's runs, row by row: CSV, or Parquet where pyarrow is installed."""

import csv
from pathlib import Path

from sato.atomic import replace_atomically
from sato.campaigns.selection import quote
from sato.campaigns.table import CampaignTable
from sato.scenario.errors import InputError, join_names

FORMATS = ("csv", "parquet")
BATCH = 5000  # rows in memory at a time


def export(table: CampaignTable, path: Path, format: str = "csv") -> Path:
    """Write all runs of a campaign for other tools, a row a run, and return the path.

    What a run does not have is empty, or null. A file that is there is replaced once all is
    written. Formats are "csv" and "parquet", which needs pyarrow.
    """
    if format not in FORMATS:
        raise InputError("", f'there is no format "{format}", only {join_names(FORMATS, "and")}')
    if path.is_dir():
        raise InputError("", f"{path}: is a folder, and a table goes into a file")
    write = _write_csv if format == "csv" else _write_parquet
    with replace_atomically(path) as new:
        write(table, new)
    return path


def _write_csv(table: CampaignTable, file: Path) -> None:
    with file.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(table.columns)
        writer.writerows(table.query("SELECT * FROM runs ORDER BY row"))


def _write_parquet(table: CampaignTable, file: Path) -> None:
    try:
        import pyarrow
        from pyarrow.parquet import ParquetWriter
    except ImportError as error:
        hint = "`pip install pyarrow` adds it, and --format csv needs nothing"
        raise InputError("", f"Parquet needs pyarrow, which is not installed; {hint}") from error
    types = {"TEXT": pyarrow.string(), "REAL": pyarrow.float64(), "INTEGER": pyarrow.int64()}
    kinds = {name: _find_kind(table, name) for name in table.columns}
    schema = pyarrow.schema([(name, types[kind]) for name, kind in kinds.items()])
    cells = ", ".join(f"CAST({quote(name, table)} AS {kind})" for name, kind in kinds.items())
    rows = table.query(f"SELECT {cells} FROM runs ORDER BY row")
    with ParquetWriter(file, schema) as writer:
        while batch := rows.fetchmany(BATCH):
            columns = zip(zip(*batch, strict=True), schema.types, strict=True)
            arrays = [pyarrow.array(values, type) for values, type in columns]
            writer.write_batch(pyarrow.record_batch(arrays, schema=schema))


def _find_kind(table: CampaignTable, name: str) -> str:
    """Return the type that holds all values of a column; SQLite has one for each value."""
    found = table.query(f"SELECT DISTINCT upper(typeof({quote(name, table)})) FROM runs")
    kinds = {kind for [kind] in found}
    return next((kind for kind in ("TEXT", "REAL", "INTEGER") if kind in kinds), "TEXT")
