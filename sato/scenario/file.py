"""Scenario files: TOML, data only."""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sato.scenario.errors import InputError, ScenarioError, closest_name, format_value, join_names
from sato.scenario.mission import Mission
from sato.scenario.overrides import override
from sato.scenario.table import read_table
from sato.systems import SYSTEMS, definition_of

BUILT_IN = Path(__file__).parent.parent / "scenarios"


def scenarios() -> dict[str, str]:
    """Return the built-in scenarios: a line of description by name."""
    files = sorted(BUILT_IN.glob("*.toml"))
    return {
        file.stem: file.read_text(encoding="utf-8").split("\n")[0].lstrip("# ") for file in files
    }


def read(name: str | Path, overrides: Iterable[str] = ()) -> Mission:
    """Read a built-in scenario by its name, or a file.

    Args:
        name: A name that `scenarios` lists, or the path of a TOML file.
        overrides: Each "table.key=value".

    Raises:
        ScenarioError: There is no such scenario, or it cannot be flown as it stands.
    """
    file, source = _find(name)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise ScenarioError(f"{source}: cannot be read: {reason}") from error
    return parse(text, overrides, source=source, folder=file.parent)


def parse(
    text: str,
    overrides: Iterable[str] = (),
    *,
    source: str = "scenario",
    folder: Path | None = None,
) -> Mission:
    """Read a scenario from its text.

    Args:
        text: TOML.
        overrides: Each "table.key=value".
        source: Name of the text in messages.
        folder: Folder of files that the text names; the working folder without it.

    Raises:
        ScenarioError: It is no TOML, of no known system, or cannot be flown as it stands.
    """
    try:
        data = tomllib.loads(text.removeprefix("\ufeff"))
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{source}: is not TOML: {error}") from error
    data.setdefault("name", Path(source).stem)
    try:
        return from_dict(data, overrides, folder=folder)
    except InputError as error:
        raise ScenarioError(f"{source}: {error}") from error


def from_dict(
    data: dict[str, Any], overrides: Iterable[str] = (), *, folder: Path | None = None
) -> Mission:
    """Build a mission from a dict with the keys of a scenario file.

    Args:
        data: As TOML has it; arrays may stand in place of lists.
        overrides: Each "table.key=value".
        folder: Folder of files that the data name; the working folder without it.

    Raises:
        InputError: The keys or values are not those of a mission.
    """
    if isinstance(overrides, str):
        raise InputError(
            "overrides",
            f'must be a list of texts, got {format_value(overrides)}; ["{overrides}"] would do',
        )
    data = _copied(data, folder)
    system = data.pop("system", None)
    if system is None:
        names = join_names(f'"{name}"' for name in SYSTEMS)
        raise InputError("system", f"is missing; write system = {names}")
    definition = definition_of(system)
    for setting in overrides:
        override(data, setting, definition)
    mission: Mission = read_table(definition, definition.with_defaults(data))
    return mission


def _find(name: str | Path) -> tuple[Path, str]:
    known = scenarios()
    if str(name) in known:
        return BUILT_IN / f"{name}.toml", str(name)
    file = Path(name)
    if file.is_file():
        return file, str(file)
    if file.suffix == ".toml" or len(file.parts) > 1:
        fault = "is a folder" if file.is_dir() else "there is no such file"
        names = join_names(known)
        raise ScenarioError(f"{file}: {fault}; a scenario is a TOML file, or one of {names}")
    close = closest_name(str(name), known)
    hint = f"did you mean {close}? There" if close else "there"
    raise ScenarioError(f'there is no scenario "{name}"; {hint} are {join_names(known, "and")}')


def _copied(value: Any, folder: Path | None, key: str = "") -> Any:
    # Files that a scenario names lie beside it, wherever it is run from.
    if isinstance(value, dict):
        return {name: _copied(part, folder, name) for name, part in value.items()}
    if isinstance(value, list):
        return [_copied(part, folder) for part in value]
    is_font_file = key == "font" and str(value).lower().endswith((".ttf", ".otf", ".ttc"))
    if folder is not None and isinstance(value, str) and (key == "file" or is_font_file):
        return str(folder / value)
    return value
