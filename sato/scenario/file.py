"""Missions, and the scenario files that they are read from: TOML, data only."""

import re
import tomllib
import unicodedata
from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import tomli_w
from pydantic import Field

from dynamics.callbacks import LIBRARY, Callback, as_kind
from dynamics.doors import checked
from sato import files
from sato.scenario.definition import Definition, In, errors_in
from sato.scenario.errors import InputError, ScenarioError, closest_name, format_value, join_names
from sato.scenario.overrides import Setting, Settings, list_settings, override, write_value
from sato.scenario.table import OWN, find_own, name_class, read_table, write_table
from sato.systems import definition_of

BUILT_IN = Path(__file__).parent.parent / "scenarios"
FONT_FILES = (".ttf", ".otf", ".ttc")

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Mission(Definition):
    """Mission of a system: a scenario, from Python or from a file."""

    system: ClassVar[str]
    callbacks: ClassVar = {
        "draw": Callback(
            "rng",
            lambda own, given, drawn: as_kind(drawn, type(own), f"a {type(own).__name__}, drawn"),
            InputError,
        ),
        "warnings": Callback("", lambda own, given, value: as_kind(value, list, "a list of text")),
    }

    name: Annotated[Name, In(""), "name of the scenario; by that of its file if absent"] = "mission"

    @classmethod
    def with_defaults(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Return the tables of a file, with defaults that depend on other keys filled in."""
        return data

    @abstractmethod
    def draw(self, rng: np.random.Generator) -> "Mission":
        """Return the mission with every random draw made and every "auto" replaced by a number.

        The same state of the generator gives the same mission; a drawn mission stays as it is.

        Raises:
            InputError: The mission cannot be flown.
        """

    @abstractmethod
    def warnings(self) -> list[str]:
        """List doubts about a drawn mission, a sentence each."""

    @abstractmethod
    def without_files(self) -> "Mission":
        """Return the same mission with the contents of files and fonts in place of their names."""

    def to_toml(self) -> str:
        """Write the mission as a scenario file that needs no other file."""
        plain = self.without_files()
        is_own = type(plain) is not definition_of(self.system)
        head = {"system": self.system, **(name_class(plain) if is_own else {})}
        return tomli_w.dumps(head | write_table(plain))


NO_MISSION = "no mission is given, and sato.load(path) takes it from the file"


def describe_own(text: str) -> str:
    """Say which parts of the TOML of a mission are of the user's own; "" if none."""
    from problems.solvers import load_adapters  # slow, and for this alone

    data = load_toml(text, "run.nc")
    found = [f"the {place} `{kind}`" if kind else f"the {place}" for place, kind in find_own(data)]
    is_own = all(kind.partition(".")[0] not in LIBRARY for _, kind in find_own(data))
    match data:
        case {"plan": {"solver": str(solver)}} if solver not in load_adapters():
            found.append(f"the plan.solver `{solver}`")
    verb, them = ("is", "it") if len(found) == 1 else ("are", "them")
    whose = "of your own" if is_own else "of Python, which no file holds"
    given = f"{verb} {whose}; sato.load(path, mission=...) gives {them}"
    return f"{join_names(found, 'and')} {given}" if found else ""


def scenarios() -> dict[str, str]:
    """Return the built-in scenarios: a line of description by name."""
    texts = {file.stem: file.read_text("utf-8") for file in sorted(BUILT_IN.glob("*.toml"))}
    return {name: text.split("\n")[0].lstrip("# ") for name, text in texts.items()}


@checked
def read(name: str | Path, overrides: Settings = ()) -> Mission:
    """Read a built-in scenario by its name, or a file.

    Args:
        name: A name that `scenarios` lists, or the path of a TOML file.
        overrides: Each "table.key=value", or a pair of key and value; or a dict of these. A table
            as a value takes the place of the whole table.

    Raises:
        ScenarioError: There is no such scenario, or it cannot be flown as it stands.
    """
    text, folder = _read_text(name)
    return parse(text, overrides, source=str(name), folder=folder)


@checked
def read_data(name: str | Path) -> dict[str, Any]:
    """Read the tables of a scenario as `from_dict` takes them; the name is as of `read`."""
    text, folder = _read_text(name)
    data: dict[str, Any] = _copied(load_toml(text, str(name)), folder.resolve())
    return data


def _read_text(name: str | Path) -> tuple[str, Path]:
    known = scenarios()
    file = BUILT_IN / f"{name}.toml" if str(name) in known else Path(name)
    if not file.is_file():
        close = closest_name(str(name), known)
        hint = f"did you mean {close}? Built in" if close else "built in"
        names = join_names(known, "and")
        raise ScenarioError(f'there is no scenario "{name}", and no such file; {hint} are {names}')
    return read_text(file), file.parent


@checked
def read_text(file: Path) -> str:
    """Read a file of text; a `ScenarioError` refuses any other."""
    try:
        return files.read_text(file)
    except InputError as error:
        raise ScenarioError(str(error)) from error
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise ScenarioError(f"{file}: cannot be read: {reason}") from error


@checked
def parse(
    text: str, overrides: Settings = (), *, source: str = "scenario", folder: Path | None = None
) -> Mission:
    """Read a scenario from its text.

    Args:
        text: TOML.
        overrides: As of `read`.
        source: Name of the text in messages.
        folder: Folder of files that the text names; the working folder without it.

    Raises:
        ScenarioError: It is no TOML, of no known system, or cannot be flown as it stands.
    """
    data = load_toml(text, source)
    if "campaign" in data and "system" not in data:
        raise ScenarioError(f"{source}: is a campaign, which `sato campaign run {source}` flies")
    try:
        return from_dict(data, overrides, folder=folder)
    except InputError as error:
        raise ScenarioError(f"{source}: {error}") from error


def parse_embedded(text: str) -> Mission:
    """Read the scenario in a run file, which must not name files or fonts of this computer."""
    data = load_toml(text, "scenario")
    if address := find_file(data):
        raise ScenarioError(f"scenario: {address}: names a file, and that of a run must not")
    return parse(text)


def find_file(value: Any, address: str = "") -> str:
    """Find the address of a key of tables or lists that names a file or a font; "" if none does."""
    parts = value.items() if isinstance(value, dict) else enumerate(value)
    for key, part in parts:
        if str(key).rpartition(".")[2] in ("file", "font"):
            return f"{address}{key}"
        if isinstance(part, dict | list) and (found := find_file(part, f"{address}{key}.")):
            return found
    return ""


@checked
def load_toml(text: str, source: str) -> dict[str, Any]:
    """Read TOML; what has no name is named after its source."""
    try:
        files.check_text("the text", len(text))
        data = tomllib.loads(text.removeprefix("\ufeff"))
    except InputError as error:
        raise ScenarioError(f"{source}: {error}") from error
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{source}: is not TOML: {error}") from error
    plain = unicodedata.normalize("NFKD", Path(source).stem).encode("ascii", "ignore").decode()
    letters = re.sub("[^A-Za-z0-9_.-]+", "_", plain).lstrip("_.-")
    data.setdefault("name", letters[:100] or "mission")
    return data


@checked
def from_dict(
    data: dict[str, Any], overrides: Settings = (), *, folder: Path | None = None
) -> Mission:
    """Build a mission from a dict with the keys of a scenario file.

    Args:
        data: As TOML has it; arrays may stand in place of lists.
        overrides: As of `read`.
        folder: Folder of files that the data name; the working folder without it.

    Raises:
        InputError: The keys or values are not those of a mission.
    """
    settings = list_settings(overrides)
    try:
        data = _copied(data, folder)
    except RecursionError as error:
        raise InputError("", "has tables or lists too deep, or within themselves") from error
    definition = definition_of(data.pop("system", ""))
    for setting in settings:
        override(data, setting, definition)
    for address, kind in find_own(data):
        reason = f'"{kind or OWN}" is of a mission in Python, which no file can hold'
        raise InputError(address, f"{reason}; sato.run(mission) would fly it")
    mission: Mission = read_table(definition, definition.with_defaults(data))
    return mission


@checked
def spell_out(name: str | Path, overrides: Iterable[Setting]) -> tuple[str, ...]:
    """Write overrides of a scenario as "table.key = value", each with all its tables."""
    data = load_toml(_read_text(name)[0], str(name))
    definition = definition_of(data.pop("system", ""))
    written = []
    for setting in overrides:
        address = override(data, setting, definition)
        with errors_in(address):
            told = setting.partition("=")[2].strip() if isinstance(setting, str) else None
            written.append(f"{address} = {write_value(setting[1]) if told is None else told}")
    return tuple(written)


def _copied(value: Any, folder: Path | None, key: str = "") -> Any:
    # Files that a scenario names lie beside it, wherever it is run from.
    if isinstance(value, dict):
        if names := [name for name in value if not isinstance(name, str)]:
            raise InputError(key, f"must have keys of text, got {format_value(names[0])}")
        return {name: _copied(part, folder, name) for name, part in value.items()}
    if type(value) in (list, tuple):
        return [_copied(part, folder) for part in value]
    if folder is not None and isinstance(value, str):
        if key == "file" or (key == "font" and value.lower().endswith(FONT_FILES)):
            return str(folder / value)
    return value
