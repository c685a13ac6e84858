"""One run of a campaign, as a worker flies it: a trial in, the cells of its row out."""

import json
import os
import socket
import tomllib
import traceback
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple, cast

import numpy as np
from threadpoolctl import threadpool_limits

from dynamics.callbacks import CallbackError, as_kind, call
from sato.campaigns.functions import add_modules, find_function
from sato.resource_usage import peak_memory_mib, reset_peak_memory
from sato.run_data import json_default
from sato.runs import Run, run
from sato.scenario.errors import InputError, ScenarioError
from sato.scenario.file import Mission, from_dict

THREAD_VARIABLES = [f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")]
MOST_CELLS = 1000  # of a function of the user's; SQLite takes 2,000 columns
ERROR_LENGTH = 2000  # of the end of a traceback that is kept
# Exit of a run by its verdict, which is "unchecked" where the check failed.
EXITS = {"kept": "reached", "not reached": "not reached", "broken": "broken", "unchecked": "error"}

Source = str | dict[str, Any] | Mission  # a function, the tables of a scenario, or a mission
# Cells of a row by column; summary and further columns are dicts of them.
Outcome = dict[str, Any]
TrialFunction = Callable[["Trial"], Outcome]
Flights = Generator[tuple["Trial", Outcome], None, None]  # as they end


def name_of_source(source: Any) -> str:
    """Return the name of a scenario, or of the function that draws it."""
    if isinstance(source, str):
        return source.partition(":")[2]
    return source.name if isinstance(source, Mission) else str(source.get("name", ""))


class Trial(NamedTuple):
    """Run to be made: all that a worker needs."""

    row: int
    source: Source
    parameters: dict[str, Any]  # by key of the scenario, those of the case among them
    seed: int  # of the run
    stream: tuple[int, int]  # seed of the campaign, and number of the trial
    function: str = ""  # "module:function", in place of a run
    columns: str = ""  # "module:function"
    keep: str = "none"
    folder: str = ""  # of the campaign
    case: str = ""
    modules: str = ""  # folder of the modules of functions
    scenario_name: str = ""  # by which runs are told apart

    def build_mission(self) -> Mission:
        """Build the mission; refuse wrong parameters, and chance but for that of the generator."""
        mission = self._build()
        if isinstance(self.source, str) and self._build() != mission:
            name = self.source
            raise InputError("", f"{name} draws two missions from one seed; rng alone would do")
        return mission

    def _build(self) -> Mission:
        source: Any = self.source
        if isinstance(source, str):
            name, rng = source, generator(*self.stream, 1)
            source = call(name, find_function(name), rng, passes=(InputError,), check=_check_source)
        if isinstance(source, Mission):
            if not self.parameters:
                return source
            source = tomllib.loads(source.to_toml())
        return from_dict(dict(source), tuple(self.parameters.items()))


@cache
def own_version() -> str:
    """Return the version of this toolkit, which takes a millisecond to find."""
    return version("sato-swarm")


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return the generator of a stream of random numbers, independent of all others."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def run_trial(trial: Trial) -> Outcome:
    """Fly a trial in this process, on one thread; errors become part of the outcome.

    A function that cannot be imported here is refused, as no other trial could be flown either.
    """
    add_modules(trial.modules)
    for name in (trial.function, trial.columns, trial.source):
        if name and isinstance(name, str):
            find_function(name)
    reset_peak_memory()
    began = perf_counter()
    outcome: Outcome = {"exit": "error", "error": None, "version": own_version()}
    with threadpool_limits(1), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", UserWarning)  # others depend on what the process did before
        try:
            (_call if trial.function else _fly)(trial, outcome)
        except (Exception, SystemExit):  # whatever it is, it ends this run alone
            outcome |= {"exit": "error", "error": last_lines()}
    if caught:
        outcome["warnings"] = "; ".join(dict.fromkeys(str(each.message) for each in caught))
    measured = {"wall_s": perf_counter() - began, "peak_memory_mib": peak_memory_mib()}
    return outcome | measured | {"worker": f"{socket.gethostname()}:{os.getpid()}"}


def _call(trial: Trial, outcome: Outcome) -> None:
    rng = generator(*trial.stream, 1)
    function = partial(find_function(trial.function), **trial.parameters)
    columns = call(trial.function, function, rng, check=_as_columns)
    outcome |= {"exit": "done", "columns": columns}


def _fly(trial: Trial, outcome: Outcome) -> None:
    try:
        mission = trial.build_mission()
        outcome["scenario"] = mission.to_toml()
        flown = run(mission, seed=trial.seed)
    except CallbackError:
        raise
    except (InputError, ScenarioError) as error:
        outcome |= {"exit": "refused", "error": str(error)}
        return
    outcome |= judge(flown)
    if trial.keep == "all" or (trial.keep == "failures" and outcome["exit"] != "reached"):
        try:
            flown.save(Path(trial.folder, "runs", str(trial.row)))
        except OSError as error:
            warnings.warn(f"the run could not be kept: {error}", stacklevel=1)
    if trial.columns:  # last, for it is the user's, and may change the summary
        outcome["columns"] = more_columns(trial.columns, flown)


def judge(flown: Run) -> Outcome:
    """Return the exit of a run by the verdict of its check, its line, and the summary."""
    report = flown.report
    error = None if report.kept else report.line
    return {"exit": EXITS[report.verdict], "error": error, "summary": flatten(flown.summary)}


def flatten(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Turn a summary into cells: tables key by key, lists as JSON."""
    cells: dict[str, Any] = {}
    for key, value in summary.items():
        if isinstance(value, Mapping):
            cells |= {f"{key}.{name}": cell for name, cell in flatten(value).items()}
        else:
            cells[str(key)] = as_cell(value)
    return cells


def as_cell(value: Any) -> Any:
    """Convert a value to one that a column can hold; not-a-number is NULL."""
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, float):
        return None if value != value else value
    if isinstance(value, int) and not isinstance(value, bool):  # of 64 bits at most
        return int(value) if abs(value) < 2**63 else float(value)
    if isinstance(value, str):  # without halves of characters, which no file can hold
        return value.encode(errors="replace").decode()
    if value is None or isinstance(value, bool):
        return value
    text = json.dumps(value, default=json_default)
    return json.dumps(json.loads(text, parse_constant=lambda _: None))  # SQLite reads no NaN


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let processes that start meanwhile use one thread each."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def last_lines() -> str:
    """Return the end of the traceback of the error that is being handled."""
    return traceback.format_exc()[-ERROR_LENGTH:]


def more_columns(function: str, flown: Any) -> Outcome:
    """Apply a function to a run; a fault in it becomes a column, and the run stands."""
    try:
        return cast(Outcome, call(function, find_function(function), flown, check=_as_columns))
    except (Exception, SystemExit) as error:  # whatever a function of the user's raises
        is_refused = isinstance(error, CallbackError) and error.__cause__ is None
        return {"columns_error": str(error) if is_refused else last_lines()}


def _check_source(source: Any) -> Any:
    return as_kind(source, Mission | Mapping, "a mission, or a dict with its keys")


def _as_columns(result: Any) -> dict[str, Any]:
    as_kind(result, Mapping, "a dict of columns")
    try:
        cells = flatten(result)
    except Exception as error:  # of objects, numbers without end and lists that hold themselves
        raise InputError("", f"must be a dict of numbers, text and lists: {error}") from error
    if len(cells) > MOST_CELLS or not all(name and name.isprintable() for name in cells):
        raise InputError("", f"must be at most {MOST_CELLS} columns with printable names")
    if len(set(map(str.lower, cells))) < len(cells):  # SQLite would keep the last of them
        raise InputError("", "must not have names of columns that differ by their case alone")
    return cells
