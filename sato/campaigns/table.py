"""Table of a campaign: one SQLite file, a row a run, written by one process."""

import json
import os
import sqlite3
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.doors import checked
from sato.atomic import remove_leftovers, replace_atomically
from sato.campaigns.definition import Campaign, digest
from sato.campaigns.schema import check_pages, check_schema
from sato.campaigns.trial import Outcome, Trial, as_cell, own_version
from sato.files import check_no_link
from sato.run_data import json_default
from sato.scenario.errors import InputError, closest_name, join_names

if TYPE_CHECKING:  # slow to import
    import pandas
    import xarray

TABLE_FILE = "campaign.sqlite"
PATIENCE = 30.0  # wait for another program that has locked the table [s]
MOST_BYTES = 64_000_000  # of a cell
MOST_COLUMNS = 1900  # SQLite takes 2,000 and more
EXITS = ("reached", "done", "not reached", "broken", "refused", "time limit", "died", "error")
SUCCESSES = ("reached", "done")  # of runs, and of functions in place of runs
INTERRUPTED = "died"  # exit of rows that are flown again when a campaign is resumed
# That differ between two runs of the same row.
MEASURED = ("wall_s", "peak_memory_mib", "worker", "attempts")
# By name; those of parameters, summary and further columns are added when they are first seen.
_COLUMNS = {
    "row": "INTEGER PRIMARY KEY",
    "exit": "TEXT NOT NULL",
    "error": "TEXT",
    "seed": "INTEGER NOT NULL",
    "parameters": "TEXT NOT NULL",  # JSON
    "scenario": "TEXT",
    "scenario_hash": "TEXT",
    "version": "TEXT",
    "wall_s": "REAL",
    "peak_memory_mib": "REAL",
    "worker": "TEXT",
    "attempts": "INTEGER NOT NULL",
    "warnings": "TEXT",
}
_SCHEMA = f"""
CREATE TABLE campaign (definition TEXT NOT NULL, fingerprint TEXT NOT NULL, version TEXT NOT NULL);
CREATE TABLE scenarios (hash TEXT PRIMARY KEY, text TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE runs ({", ".join(f"{name} {kind}" for name, kind in _COLUMNS.items())});
"""


class TableError(RuntimeError):
    """A table that cannot be read or written now; what is in it stays."""


class CampaignTable(AbstractContextManager["CampaignTable"]):
    """Table in the folder of a campaign, from which rows are read, and to which a writer adds."""

    def __init__(self, folder: Path, is_writer: bool = False) -> None:
        self.folder, self.path = folder, folder / TABLE_FILE
        remove_leftovers(folder)
        if not self.path.is_file():
            raise InputError("", f"{folder}: holds no campaign; `sato campaign run` makes one")
        for end in ("", "-wal", "-shm", "-journal"):  # which SQLite would read, or make
            check_no_link(Path(f"{self.path}{end}"), "a campaign")
        mode = "rw" if is_writer else "ro"
        journal = Path(f"{self.path}-wal")
        has_journal = journal.exists() and journal.stat().st_size > 0
        if not (is_writer or os.access(folder, os.W_OK) or has_journal):
            mode = "ro&immutable=1"
        address = f"{self.path.resolve().as_uri()}?mode={mode}"
        options: Any = {"uri": True, "timeout": PATIENCE, "isolation_level": None}
        with ExitStack() as opened:
            with describe_errors(self.path):
                connection = opened.enter_context(closing(sqlite3.connect(address, **options)))
                connection.text_factory = lambda text: text.decode("utf-8", "replace")
                connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
                check_schema(self.path, connection, _COLUMNS)
                if not is_writer:
                    check_pages(self.path, connection)
                row = connection.execute("SELECT * FROM campaign").fetchone()
            self._connection, self.fingerprint, self.version = connection, str(row[1]), str(row[2])
            self.campaign = self._read_campaign(row[0])
            self._names = {name.lower(): name for name in self.columns}
            if is_writer:
                self.query("PRAGMA synchronous = NORMAL")  # a killed process loses nothing
            opened.pop_all()  # a table that is refused is closed

    def _read_campaign(self, text: str) -> Campaign:
        try:
            return Campaign.from_json(text)
        except InputError as error:
            if self.version == own_version():
                raise
            reason = f"was written by sato {self.version}, and this is {own_version()}: {error}"
            cure = f"sato {self.version} reads it"
            raise InputError("", f"{self.folder}: {reason}; {cure}") from error

    @classmethod
    def create(cls, folder: Path, campaign: Campaign) -> "CampaignTable":
        """Create the table of a campaign, whole or not at all."""
        path = folder / TABLE_FILE
        values = (campaign.to_json(), campaign.fingerprint, own_version())
        with describe_errors(path), replace_atomically(path) as new:
            with closing(sqlite3.connect(new, isolation_level=None)) as connection:
                connection.execute("PRAGMA journal_mode = WAL")
                connection.executescript(_SCHEMA)
                connection.execute("INSERT INTO campaign VALUES (?, ?, ?)", values)
        return cls(folder, is_writer=True)

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def columns(self) -> list[str]:
        """Names of all columns."""
        return [row[1] for row in self.query("PRAGMA table_info(runs)")]

    def __len__(self) -> int:
        """Return the number of rows."""
        return int(self.query("SELECT count(*) FROM runs").fetchone()[0])

    def rows(self, columns: Sequence[str] = ()) -> Iterator[dict[str, Any]]:
        """Read rows one by one, in the order of their numbers; all columns, or those named."""
        names = list(columns) or self.columns
        text = f"SELECT {', '.join(map(self.quote, names))} FROM runs ORDER BY row"
        with describe_errors(self.path):
            for values in self._connection.execute(text):
                yield dict(zip(names, values, strict=True))

    def quote(self, column: str) -> str:
        """Quote the name of a column for SQL; refuse one that is not there."""
        known = self.columns
        if column not in known:
            close = closest_name(column, known)
            hint = f'did you mean "{close}"?' if close else f"there are {join_names(known, 'and')}"
            raise InputError("", f'there is no column "{column}"; {hint}')
        return _quoted(column)

    def row(self, number: int) -> dict[str, Any]:
        """Read one row; refuse a number that is not there."""
        names = self.columns
        values = self.query("SELECT * FROM runs WHERE row = ?", (number,)).fetchone()
        if values is None:
            raise InputError("", f"{self.folder}: has no row {number}")
        return dict(zip(names, values, strict=True))

    def scenario(self, row: dict[str, Any]) -> str | None:
        """Return the scenario file of a row, as it was flown; None where its worker died."""
        query = "SELECT text FROM scenarios WHERE hash = ?"
        found = self.query(query, (row["scenario_hash"],)).fetchone()
        return found[0] if found else None

    def exits(self) -> Counter[str]:
        """Count the rows by exit."""
        found = dict(self.query("SELECT exit, count(*) FROM runs GROUP BY exit").fetchall())
        return Counter({name: found[name] for name in EXITS if name in found})

    def has_further_columns(self) -> bool:
        """Return False where the function of further columns failed in every row."""
        query = "SELECT count(*) FROM runs WHERE columns_error IS NULL"
        return "columns_error" not in self.columns or bool(self.query(query).fetchone()[0])

    def attempts(self) -> dict[int, int]:
        """Return the attempts of rows that are flown again, by row."""
        query = "SELECT row, attempts FROM runs WHERE exit = ?"
        return dict(self.query(query, (INTERRUPTED,)).fetchall())

    def numbers_done(self) -> bytearray:
        """Mark the rows that are not flown again: 1 at the number of each."""
        marks = bytearray(self.campaign.runs)
        for (row,) in self.query("SELECT row FROM runs WHERE exit != ?", (INTERRUPTED,)):
            if row < len(marks):
                marks[row] = 1
        return marks

    def to_pandas(self, columns: Sequence[str] = ()) -> "pandas.DataFrame":
        """Read the table as a data frame, with rows by their numbers."""
        import pandas

        frame = pandas.DataFrame(self.rows(columns), columns=list(columns) or self.columns)
        return frame.set_index("row") if "row" in frame else frame

    def to_xarray(self, columns: Sequence[str] = ()) -> "xarray.Dataset":
        """Read the table as a dataset along the dimension "row"."""
        names = dict.fromkeys(["row", *columns]) if columns else ()
        data: xarray.Dataset = self.to_pandas(tuple(names)).to_xarray()
        return data

    def redefine(self, campaign: Campaign) -> None:
        """Replace the definition, by one with more trials or another version."""
        text = "UPDATE campaign SET definition = ?, fingerprint = ?, version = ?"
        self.query(text, (campaign.to_json(), campaign.fingerprint, own_version()))
        self.campaign = campaign

    def add(self, trial: Trial, outcome: Outcome, attempts: int) -> None:
        """Add the row of a trial, or replace it, in one transaction."""
        cells, text = self.cells(trial, outcome), outcome.get("scenario")
        try:
            with describe_errors(self.path), self._connection:  # commits, or rolls back
                self._connection.execute("BEGIN IMMEDIATE")
                if text is not None:
                    command = "INSERT OR IGNORE INTO scenarios VALUES (?, ?)"
                    self._connection.execute(command, (cells["scenario_hash"], text))
                known = {name: value for name, value in cells.items() if value is not None}
                cells = {self._ensure_column(name, value): value for name, value in known.items()}
                cells["attempts"] = attempts
                names, marks = ", ".join(map(_quoted, cells)), ", ".join("?" * len(cells))
                command = f"INSERT OR REPLACE INTO runs ({names}) VALUES ({marks})"
                self._connection.execute(command, tuple(cells.values()))
        except BaseException:
            self._names = {name.lower(): name for name in self.columns}
            raise

    def cells(self, trial: Trial, outcome: Outcome) -> dict[str, Any]:
        """Return the cells of the row of a trial; a name that is taken gets its origin in front."""
        known = {key: as_cell(value) for key, value in outcome.items() if key in _COLUMNS}
        cells = {"version": own_version()} | known | {"row": trial.row, "seed": trial.seed}
        cells["parameters"] = json.dumps(trial.parameters, default=json_default)
        cells["scenario"] = trial.scenario_name
        if outcome.get("scenario") is not None:
            cells["scenario_hash"] = digest(outcome["scenario"])
        summary = {k: v for k, v in outcome.get("summary", {}).items() if k not in _COLUMNS}
        groups = {
            "parameters": trial.parameters | ({"case": trial.case} if trial.case else {}),
            "summary": summary,
            "columns": outcome.get("columns", {}),
        }
        taken = {name.lower() for name in _COLUMNS}
        for origin, group in groups.items():
            for name, value in group.items():
                full = f"{origin}.{name}" if name.lower() in taken else name
                taken.add(full.lower())
                cells[full] = as_cell(value)
        return cells

    def _ensure_column(self, name: str, value: object) -> str:
        if name.lower() not in self._names:
            if len(self._names) >= MOST_COLUMNS:
                raise TableError(f"{self.path}: more than {MOST_COLUMNS} columns, at {name}")
            kind = " BOOLEAN" if isinstance(value, bool) else ""  # of which tables show rates
            self._connection.execute(f"ALTER TABLE runs ADD COLUMN {_quoted(name)}{kind}")
            self._names[name.lower()] = name
        return self._names[name.lower()]

    @property
    def booleans(self) -> set[str]:
        """Names of the columns that hold booleans."""
        rows = self.query("PRAGMA table_info(runs)")
        return {name for _, name, kind, *_ in rows if kind == "BOOLEAN"}

    @property
    def groups(self) -> list[str]:
        """Columns by which runs are grouped if the file names none: what the campaign varies."""
        several = {"scenario": len(self.campaign.scenario) > 1, "case": bool(self.campaign.case)}
        names = [*(name for name, varies in several.items() if varies), *self.campaign.grid]
        known = self.columns
        return [*self.campaign.by] or [name for name in names if name in known]

    def query(self, text: str, values: Iterable[Any] = ()) -> sqlite3.Cursor:
        """Execute a statement of SQL, as of the table `runs`."""
        with describe_errors(self.path):
            cursor: sqlite3.Cursor = self._connection.execute(text, tuple(values))
        return cursor


@checked
def open_table(folder: str | Path) -> CampaignTable:
    """Open the table of a campaign to read it, also while the campaign runs; refuse other folders.

    A `TableError` says that the file is damaged, or locked by another program.
    """
    return CampaignTable(Path(folder))


@contextmanager
def describe_errors(path: Path) -> Iterator[None]:
    """Make a `TableError` with a sentence of what SQLite reports."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:  # of a sentence of SQLite, with bytes
        text = str(error) if isinstance(error, sqlite3.Error) else "the file is damaged"
        if "locked" in text:
            text = f"another program has locked the table for more than {PATIENCE:g} s"
        elif "full" in text or "disk I/O" in text:
            text = f"nothing can be written: {text}"
        raise TableError(f"{path}: {text}; the rows in it are kept") from error


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"'
