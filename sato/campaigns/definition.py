"""Definition of a campaign: scenarios, values of their keys, and seeds, from which rows follow."""

import inspect
import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from hashlib import sha256
from itertools import combinations
from math import prod
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy import ndarray as Array

from dynamics.callbacks import CallbackError
from dynamics.units import Unit
from sato.campaigns.distributions import Distribution, as_distribution
from sato.campaigns.functions import FUNCTION, add_modules, find_function, name_of_function
from sato.campaigns.trial import Source, Trial, generator, name_of_source
from sato.scenario.definition import Convert, Definition, In, NotNegative, Positive, errors_in
from sato.scenario.errors import InputError, ScenarioError, closest_name, format_value
from sato.scenario.file import Mission, Name, load_toml, read_data, read_text
from sato.scenario.overrides import find_places, override
from sato.scenario.table import read_table, write_table
from sato.systems import definition_of

# Fields that may change when a campaign is resumed.
EXTENDABLE = ("name", "modules", "trials", "keep", "by", "show")


def _as_sources(value: Any) -> tuple[Source, ...]:
    return tuple(map(_as_source, value if isinstance(value, list | tuple) else [value]))


def _as_source(value: Any) -> Source:
    # Files are read here, so that workers on other machines need none.
    if isinstance(value, Mission) or (isinstance(value, str) and FUNCTION.fullmatch(value)):
        return value
    if isinstance(value, Mapping):
        return dict(value)
    if callable(value):
        return name_of_function(value)
    if isinstance(value, str | Path):
        return read_data(value)
    got = f"an object of type {type(value).__name__}"
    raise InputError("", f"must be a name, a path, a mission, a dict or a function, got {got}")


def _as_function(value: Any) -> str:
    is_name = isinstance(value, str) and (not value or FUNCTION.fullmatch(value))
    return str(value) if is_name else name_of_function(value)


def _as_lists(value: Any) -> dict[str, tuple[Any, ...]]:
    grid = {}
    for key, values in _flatten_tables(value or {}):
        values = values.tolist() if type(values) is Array else values
        if not isinstance(values, list | tuple | range):
            raise InputError(key, f"must be a list of values, got {format_value(values)}")
        if not values:
            raise InputError(key, "must have at least one value")
        grid[key] = tuple(values)
    return grid


def _as_cases(value: Any) -> dict[str, dict[str, Any]]:
    return _convert_each(_as_table(value).items(), lambda table: dict(_flatten_tables(table)))


def _as_distributions(value: Any) -> dict[str, Distribution]:
    return _convert_each(_flatten_tables(value or {}), as_distribution)


def _convert_each(pairs: Iterable[tuple[str, Any]], convert: Any) -> dict[str, Any]:
    found = {}
    for key, value in pairs:
        with errors_in(key):
            found[key] = convert(value)
    return found


def _as_table(value: Any) -> Mapping[str, Any]:
    if not isinstance(value or {}, Mapping):
        raise InputError("", f"must be a table, got {format_value(value)}")
    return value or {}


def _flatten_tables(value: Any, head: str = "") -> Iterator[tuple[str, Any]]:
    # "swarm.agents" may be a key in quotes, or a key in a table; a table with a kind is a value.
    for key, part in _as_table(value).items():
        address = f"{head}{key}"
        if isinstance(part, Mapping) and not isinstance(part.get("kind"), str):
            yield from _flatten_tables(part, f"{address}.")
        else:
            yield address, part


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Campaign(Definition):
    """Many runs: scenarios × values of their keys × seeds.

    Row and campaign alone decide the parameters and the seed of a run. A trial has the same seed,
    and the same drawn values, at every point of the grid and in every scenario, so that points
    can be compared run by run. More trials add rows after all others.
    """

    name: Annotated[Name, In("campaign"), "name of the campaign"] = "campaign"
    scenario: Annotated[
        Any, In("campaign"), Convert(_as_sources),
        'scenario, file, or function "module:function" of a generator; or a list of them',
    ] = ()  # fmt: skip
    function: Annotated[
        str, In("campaign"), Convert(_as_function),
        'in place of a scenario, function "module:function" of a generator and the keys below, '
        "which returns a dict of columns",
    ] = ""  # fmt: skip
    modules: Annotated[
        str, In("campaign"), "folder of the modules of functions; that of the file"
    ] = ""
    trials: Annotated[int, In("campaign"), Positive, "number of seeds"] = 1
    seed: Annotated[int, In("campaign"), NotNegative, "first seed"] = 0
    time_limit: Annotated[
        float | None, Unit("s"), In("campaign"), Positive, "time after which a run is ended"
    ] = None
    columns: Annotated[
        str, In("campaign"), Convert(_as_function),
        'function "module:function" of a run, which returns a dict of more columns',
    ] = ""  # fmt: skip
    keep: Annotated[
        Literal["failures", "all", "none"], In("campaign"), "runs whose files are kept"
    ] = "none"
    case: Annotated[Any, Convert(_as_cases), "values of keys that belong together, by name"] = ()
    grid: Annotated[Any, Convert(_as_lists), "values of keys, all combined"] = ()
    draw: Annotated[Any, Convert(_as_distributions), "distributions of keys"] = ()
    by: Annotated[
        tuple[str, ...], In("table"), "columns by which runs are grouped in tables and figures"
    ] = ()
    show: Annotated[
        tuple[str, ...], In("table"), "columns, ratios and conditions in tables and figures"
    ] = ()

    def check(self) -> None:
        """Refuse keys that are given twice, and scenarios beside a function."""
        if bool(self.scenario) == bool(self.function):
            raise InputError("campaign.scenario", "is needed, or a function, and not both")
        if self.function and (self.columns or self.keep != "none"):
            raise InputError("campaign.function", "has no runs for columns and keep")
        places = {f"case.{name}": settings for name, settings in self.case.items()}
        places |= {"grid": self.grid, "draw": self.draw}
        for one, two in combinations(places, 2):
            both = sorted(set(places[one]) & set(places[two]))
            if both and not two.startswith("case."):
                raise InputError(both[0], f"stands in [{one}] and in [{two}]; one is enough")

    @property
    def functions(self) -> list[str]:
        """Functions of the user's that its runs call, as "module:function"."""
        sources = [source for source in self.scenario if isinstance(source, str)]
        return [name for name in (self.function, self.columns, *sources) if name]

    @property
    def points(self) -> int:
        """Number of runs with the same seed."""
        return prod(self._shape)

    @property
    def _shape(self) -> list[int]:
        return [max(1, len(self.scenario)), max(1, len(self.case)), *map(len, self.grid.values())]

    @property
    def runs(self) -> int:
        """Number of runs."""
        return self.trials * self.points

    def trial(self, row: int, folder: str = "") -> Trial:
        """Return the run of a row, from 0, for a folder of the campaign.

        Trials follow each other, and in each the points of the grid, the last key first.
        """
        number, point = divmod(row, self.points)
        first, second, *indices = (int(index) for index in np.unravel_index(point, self._shape))
        case = list(self.case)[second] if self.case else ""
        pairs = zip(self.grid.items(), indices, strict=True)
        rng = generator(self.seed, number, 0)
        return Trial(
            row=row,
            source=self.scenario[first] if self.scenario else {},
            case=case,
            parameters=self.case.get(case, {})
            | {key: values[index] for (key, values), index in pairs}
            | {key: distribution.draw(rng) for key, distribution in self.draw.items()},
            seed=self.seed + number,
            stream=(self.seed, number),
            function=self.function,
            columns=self.columns,
            keep=self.keep,
            folder=folder,
            modules=self.modules,
            scenario_name=self._scenario_names[first] if self.scenario else "",
        )

    @cached_property
    def _scenario_names(self) -> list[str]:
        """Names of the scenarios; of those that come again, with a number behind."""
        names = [name_of_source(source) for source in self.scenario]
        times = [names[: i + 1].count(name) for i, name in enumerate(names)]
        return [f"{name} {n}" if n > 1 else name for name, n in zip(names, times, strict=True)]

    def check_keys(self) -> None:
        """Refuse functions that are not there, and unknown keys, of which the nearest is named."""
        tables = {"grid": self.grid} | {f"case.{name}": case for name, case in self.case.items()}
        for place, table in tables.items():
            for key, value in table.items():
                with errors_in(place), errors_in(key):
                    _to_json(value)  # refuses what no table holds
        self.to_json()
        add_modules(self.modules)
        if self.columns:
            with errors_in("campaign.columns"):
                find_function(self.columns)
        if self.function:
            return self._check_arguments()
        for trial in self._first_trials():
            with errors_in("campaign.scenario"):
                data = json.loads(_to_json(_tables_of(trial)))
                definition = definition_of(data.pop("system", ""))
            settings: dict[str, set[Any]] = {}  # the places that each key fills
            for key, value in trial.parameters.items():
                with errors_in(self._place_of(key, trial)):
                    settings[key] = find_places(data, key, definition)
                    override(data, (key, value), definition)
            for one, two in combinations(settings, 2):  # of which the second would win
                if settings[one] <= settings[two]:
                    place, other = self._place_of(two, trial), self._place_of(one, trial)
                    reason = f"stands in [{place}], and as {one} in [{other}]; one is enough"
                    raise InputError(two, reason)

    def _check_arguments(self) -> None:
        with errors_in("campaign.function"):
            signature = inspect.signature(find_function(self.function))
        for trial in self._first_trials():
            first = next(iter(signature.parameters), "rng")
            if first != "rng" and first in trial.parameters:
                reason = f"{self.function} begins with {first}, and rng comes first"
                raise InputError("campaign.function", f"{reason}: def study(rng, {first}), say")
            try:
                signature.bind(None, **trial.parameters)
            except TypeError as error:
                names = list(signature.parameters)[1:]
                key = next((key for key in trial.parameters if key not in names), "")
                near = closest_name(key, names)
                hint = f'; did you mean "{near}"?' if near else ""
                place = f"{self._place_of(key, trial)}.{key}" if key else "campaign.function"
                raise InputError(place, f"{self.function} {error}{hint}") from error

    def _place_of(self, key: str, trial: Trial) -> str:
        places = {**dict.fromkeys(self.grid, "grid"), **dict.fromkeys(self.draw, "draw")}
        return places.get(key, f"case.{trial.case}")

    @cached_property
    def fingerprint(self) -> str:
        """Digest of the functions, and of the first mission of each scenario and case."""
        texts = [_code_of(name) for name in (self.function, self.columns) if name]
        for trial in () if self.function else self._first_trials():
            try:
                texts.append(trial.build_mission().to_toml())
            except InputError as error:
                texts.append(str(error))
        return digest("\0".join(texts))

    def _first_trials(self) -> Iterator[Trial]:
        step = prod(self._shape[2:])  # the first point of the grid in each scenario and case
        yield from map(self.trial, range(0, self.points, step))

    def to_json(self) -> str:
        """Write the definition as JSON, with the scenarios, so that it needs no other file."""
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        draws = {key: write_table(distribution) for key, distribution in self.draw.items()}
        return _to_json(plain | {"draw": draws})

    @classmethod
    def from_json(cls, text: str) -> "Campaign":
        """Read what `to_json` wrote; refuse keys that this version does not know."""
        try:
            plain = json.loads(text)
            sources = [source for source in plain["scenario"] if isinstance(source, str)]
            if not all(map(FUNCTION.fullmatch, sources)):
                raise TypeError("a scenario is neither a table nor a function")
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            reason = f"its definition is damaged: {type(error).__name__}: {error}"
            raise InputError("", reason) from error
        if unknown := sorted(set(plain) - {field.name for field in fields(cls)}):
            raise InputError(unknown[0], "is a key of another version of sato")
        return cls(**plain)

    def differences(self, other: "Campaign") -> list[str]:
        """List the fields that differ, other than those that may when a campaign is resumed."""
        one, two = json.loads(self.to_json()), json.loads(other.to_json())
        # As text: the order of keys decides the rows, and not-a-number is not equal to itself.
        differing = [name for name in one if json.dumps(one[name]) != json.dumps(two[name])]
        return [name for name in differing if name not in EXTENDABLE]


def read_campaign(path: Path, **changes: Any) -> Campaign:
    """Read a campaign's TOML file; files that it names lie beside it.

    Changes are of keys of its table [campaign]; None leaves one as it is. A `ScenarioError` says
    that it cannot be read, or is no campaign.
    """
    data = load_toml(read_text(path), str(path))
    if "system" in data and "campaign" not in data:
        reason = f"is a scenario, which `sato run {path}` flies"
        raise ScenarioError(f'{path}: {reason}; a campaign has it as scenario = "{path.name}"')
    try:
        name, table = data.pop("name"), data.setdefault("campaign", {})
        if isinstance(table, dict):
            table.setdefault("name", name)
            table |= {key: value for key, value in changes.items() if value is not None}
            if isinstance(modules := table.get("modules", ""), str):
                table["modules"] = str((path.parent / modules).resolve())
            given = table.get("scenario")
            if given is not None:
                parts = given if isinstance(given, list) else [given]
                table["scenario"] = [_beside(part, path.parent) for part in parts]
        campaign: Campaign = read_table(Campaign, data)
    except InputError as error:
        raise ScenarioError(f"{path}: {error}") from error
    return campaign


def digest(text: str) -> str:
    """Return a short digest of a text."""
    return sha256(text.encode()).hexdigest()[:16]


def _tables_of(trial: Trial) -> Any:
    if not isinstance(trial.source, str):
        return trial.source
    find_function(trial.source)
    try:
        return trial._replace(parameters={}).build_mission()
    except CallbackError:
        raise
    except (Exception, SystemExit) as error:  # whatever a function of the user's raises
        reason = f"{trial.source} raises {type(error).__name__}: {error}"
        raise InputError("", reason) from error


def _code_of(function: str) -> str:
    try:
        return inspect.getsource(find_function(function))
    except (OSError, TypeError):  # compiled, or a partial function
        return function


def _beside(name: Any, folder: Path) -> Any:
    is_file = isinstance(name, str) and (folder / name).is_file()
    return str(folder / name) if is_file else name


def _to_json(value: Any) -> str:
    def default(part: Any) -> Any:
        if isinstance(part, Mission):
            return tomllib.loads(part.to_toml())
        if type(part) is Array or isinstance(part, np.generic):
            return part.tolist()
        raise InputError(
            "", f"no file holds {format_value(part)}; numbers, texts, lists and tables would do"
        )

    return json.dumps(value, default=default)
