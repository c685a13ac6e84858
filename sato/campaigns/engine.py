"""Campaigns flown and resumed: rows that are missing, by processes here or by a cluster."""

import json
import os
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from dynamics.doors import checked
from sato.atomic import make_folder
from sato.campaigns.definition import Campaign, digest
from sato.campaigns.local import fly_locally
from sato.campaigns.table import INTERRUPTED, MEASURED, TABLE_FILE, CampaignTable, TableError
from sato.campaigns.trial import Flights, Outcome, TrialFunction, own_version, run_trial
from sato.check.report import JUDGED
from sato.files import check_no_link
from sato.scenario.definition import Amount, Count, Positive
from sato.scenario.errors import InputError, join_names
from sato.scenario.file import describe_own, find_file, load_toml

MOST_RUNS = 10**6
MOST_WORKERS = 1024
LOCK_FILE = "campaign.lock"

# Called at first and after each row, with the number of rows by exit and of all runs.
Progress = Callable[[Counter[str], int], object]


@checked
def campaign(
    scenario: Any = (),
    *,
    function: Any = "",
    out: str | Path,
    trials: Amount = 1,
    seed: Count = 0,
    grid: Mapping[str, Any] | None = None,
    draw: Mapping[str, Any] | None = None,
    case: Mapping[str, Mapping[str, Any]] | None = None,
    columns: Any = "",
    time_limit: Annotated[float, Positive] | None = None,
    keep: Literal["failures", "all", "none"] = "none",
    resume: bool = False,
    workers: Amount | None = None,
    scheduler: str | None = None,
    allow_version: bool = False,
    allow_many: bool = False,
    progress: Progress = lambda exits, runs: None,
) -> CampaignTable:
    """Fly many runs into one table.

    Worker processes import the caller's script, so that it calls this function under
    `if __name__ == "__main__":`, and functions stand at the top of a module or script.

    Args:
        scenario: Name, file, dict, mission, or function of a generator that returns a mission
            or a dict; or a list of them.
        function: In place of a scenario, function of a generator and of the keys below, which
            returns a dict of columns.
        out: Folder of the table.
        trials: Number of seeds, at each point of the grid.
        seed: First seed.
        grid: Values by key of the scenario, all combined.
        draw: Distributions by key, each as in a file: {"kind": "uniform", "low": 1.0, ...}.
        case: Values by key that belong together, by a name that the column "case" takes.
        columns: Function of a run that returns a dict of more columns.
        time_limit: Time after which a run is ended [s].
        keep: Runs whose files are kept in the folder.
        resume: Go on with a table; rows whose worker died are flown again.
        workers: Number of processes; one a core by default.
        scheduler: Address of a Dask scheduler.
        allow_version: Resume with another version.
        allow_many: Allow more than a million runs.
        progress: Function called with the rows that there are.

    Returns:
        The table, opened to read: `rows()`, `exits()`, `to_pandas()`, `to_xarray()`.

    Raises:
        InputError: The campaign cannot be flown, or the folder holds another one.
        TableError: The table cannot be written; all rows until then are in it.
        WorkerError: Workers end at once, or the scheduler cannot be reached.
    """
    defined = Campaign(
        name=Path(out).name,
        scenario=scenario,
        function=function,
        trials=trials,
        seed=seed,
        grid=grid or (),
        draw=draw or (),
        case=case or (),
        columns=columns,
        time_limit=time_limit,
        keep=keep,
    )
    options = resume, workers, scheduler, allow_version, allow_many, progress
    fly_campaign(defined, Path(out), *options)
    return CampaignTable(Path(out))


def fly_campaign(
    campaign: Campaign,
    folder: Path,
    resume: bool = False,
    workers: int | None = None,
    scheduler: str | None = None,
    allow_version: bool = False,
    allow_many: bool = False,
    progress: Progress = lambda exits, runs: None,
    function: TrialFunction = run_trial,
) -> None:
    """Fly the runs of a campaign that its table does not hold yet.

    Options and errors are those of `campaign`; rows whose worker died are flown again. The function
    of a trial gives its outcome, and is importable by name.
    """
    if campaign.runs > MOST_RUNS and not allow_many:
        reason = f"{campaign.runs:,} runs are more than {MOST_RUNS:,}"
        raise InputError("", f"{reason}; --yes flies them all the same")
    campaign.check_keys()
    folder = folder.resolve()
    with (
        _connected(scheduler, workers) as fly,
        _only_writer(folder),
        _open(campaign, folder, resume, allow_version) as table,
    ):
        exits, died, done = table.exits(), table.attempts(), table.numbers_done()
        rows = (row for row in range(campaign.runs) if not done[row])
        trials = (campaign.trial(row, str(folder)) for row in rows)
        with closing(fly(function, trials, campaign.time_limit)) as flown:
            progress(exits, campaign.runs)
            for trial, outcome in flown:
                before = died.get(trial.row, 0)
                table.add(trial, outcome, before + 1)
                if before:
                    exits[INTERRUPTED] -= 1
                exits[outcome["exit"]] += 1
                progress(exits, campaign.runs)


def fly_again(
    table: CampaignTable, number: int, is_trusted: bool = False, functions: Path | None = None
) -> tuple[Outcome, list[str] | None]:
    """Fly a row again by its number, keep the run, and return the outcome and differing columns.

    There is nothing to compare, and None, where the worker of the row died or was ended. A table
    that names functions or files is refused, unless it is trusted, or the functions' file is given.
    """
    row = table.row(number)
    text = table.scenario(row)
    _check_trusted(table, number, is_trusted, functions)
    given = table.campaign.trial(number, str(table.folder.resolve()))
    given = given if functions is None else given._replace(modules=str(functions.resolve().parent))
    given = given._replace(parameters=json.loads(row["parameters"]), seed=row["seed"], keep="all")
    whole = given
    if text is not None and not describe_own(text):  # what no file holds is drawn again
        whole = given._replace(source=load_toml(text, given.scenario_name), parameters={})
    if not is_trusted and (file := find_file([whole.source, whole.parameters])):
        raise InputError("", f"{table.folder}: its scenario names a file, {file}; --trust reads it")
    outcome = run_trial(whole)
    if row["exit"] in (INTERRUPTED, "time limit"):
        return outcome, None
    cells = table.cells(given, outcome)
    if text is not None and whole is not given:  # this version may spell out keys that are new
        cells["scenario_hash"] = digest(text)
    names = {name for name, value in row.items() if value is not None} | set(cells)
    if "verdict" not in row:  # of a version that had none, and fewer columns
        names = names.intersection(row).difference(JUDGED)
    differing = {name for name in names if cells.get(name) != row.get(name)}
    return outcome, sorted(differing - {*MEASURED, "version", "error", "columns_error"})


def _check_trusted(
    table: CampaignTable, number: int, is_trusted: bool, functions: Path | None
) -> None:
    called, place = table.campaign.functions, table.folder / "runs"
    for path in (place, place / str(number)):
        check_no_link(path, "a campaign")
    if functions is not None:
        for name in called:
            module, _, called_name = name.partition(":")
            if module != functions.stem or "." in called_name or not functions.is_file():
                raise InputError("--functions", f"{functions} is not the file of {name}")
    elif called and not is_trusted:
        reason = f"its runs call {join_names(called, 'and')}, which is code"
        raise InputError("", f"{table.folder}: {reason}; --trust runs it, or --functions FILE.py")


def _open(campaign: Campaign, folder: Path, resume: bool, allow_version: bool) -> CampaignTable:
    if not (folder / TABLE_FILE).exists():
        return CampaignTable.create(folder, campaign)
    table = CampaignTable(folder, is_writer=True)
    try:
        if len(table) and not resume:
            cure = "--resume, resume=True in Python, goes on with it; another out would do"
            raise InputError("", f"{folder}: holds a campaign; {cure}")
        if len(table):  # an empty one may be any campaign's
            _check_same(campaign, table, allow_version)
        table.redefine(campaign)
    except BaseException:
        table.close()
        raise
    return table


def _check_same(campaign: Campaign, table: CampaignTable, allow_version: bool) -> None:
    held, now = table.campaign, own_version()
    other = [name for name in campaign.differences(held) if name != "scenario"]
    if len(campaign.scenario) != len(held.scenario):  # rows would be those of others
        other.append("number of scenarios")
    if other:
        reason = f"holds another campaign, with another {join_names(other, 'and')}"
        raise InputError("", f"{table.folder}: {reason}; --out takes another place")
    if campaign.trials < held.trials:
        reason = f"holds {held.trials} trials, and {campaign.trials} are fewer"
        raise InputError("campaign.trials", f"{reason}; at least as many would do")
    if allow_version:
        return
    cure = "--allow-version goes on all the same, and rows tell their versions and scenarios"
    if table.version != now:
        reason = f"was begun by sato {table.version}, not {now}"
        raise InputError("", f"{table.folder}: {reason}; {cure}")
    if campaign.fingerprint != table.fingerprint or "scenario" in campaign.differences(held):
        reason = "was begun with another scenario or function"
        raise InputError("", f"{table.folder}: {reason}; {cure}")


@contextmanager
def _connected(scheduler: str | None, workers: int | None) -> Iterator[Callable[..., Flights]]:
    if scheduler is None:
        has_affinity = hasattr(os, "sched_getaffinity")  # to the cores that this process may use
        cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
        if workers and workers > MOST_WORKERS:
            raise InputError("workers", f"must be at most {MOST_WORKERS}, got {workers}")
        yield partial(fly_locally, workers or cores)
        return
    from sato.campaigns.cluster import connect, fly_on_cluster

    with connect(scheduler) as client:
        yield partial(fly_on_cluster, client)


@contextmanager
def _only_writer(folder: Path) -> Iterator[None]:
    # A lock of SQLite ends with its process, however that ends, and on every system.
    try:
        make_folder(folder)
    except OSError as error:
        raise TableError(f"{folder}: {error.strerror}") from error
    with closing(sqlite3.connect(folder / LOCK_FILE, timeout=0, isolation_level=None)) as lock:
        try:
            lock.execute("BEGIN EXCLUSIVE")
        except sqlite3.Error as error:
            reason = "another process flies this campaign now" if "locked" in str(error) else error
            raise TableError(f"{folder}: {reason}") from error
        yield
