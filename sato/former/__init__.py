"""Scenario files: read, checked, and turned into what is flown. Data only."""

import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from sato.former.connectivity import ConnectivityFile
from sato.former.file import ScenarioFile
from sato.former.overrides import override
from sato.former.refusal import Refusal, ScenarioError, explain, listed, nearest

SYSTEMS: dict[str, type[ScenarioFile]] = {
    "connectivity": ConnectivityFile,
}
BUILT_IN = Path(__file__).parent.parent / "scenarios"

__all__ = ["ScenarioError", "ScenarioFile", "names", "parse", "read"]


def names() -> dict[str, str]:
    """The built-in scenarios, each with a line that says what it shows."""
    files = sorted(BUILT_IN.glob("*.toml"))
    return {
        file.stem: file.read_text(encoding="utf-8").split("\n")[0].lstrip("# ") for file in files
    }


def read(name: str | Path, overrides: Iterable[str] = ()) -> Any:
    """Read a built-in scenario by its name, or a file.

    Args:
        name: A name that `names` knows, or the path of a TOML file.
        overrides: Each "table.key=value".

    Raises:
        ScenarioError: There is no such scenario, or it cannot be run as it stands.
    """
    file, source = _find(name)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "not UTF-8 text"
        raise ScenarioError(f"{source}: cannot be read: {why}") from error
    return parse(text, overrides, source=source, folder=file.parent)


def parse(
    text: str,
    overrides: Iterable[str] = (),
    *,
    source: str = "scenario",
    folder: Path | None = None,
) -> Any:
    """Read a scenario from its text.

    Args:
        text: TOML.
        overrides: Each "table.key=value".
        source: What to call the text in messages.
        folder: From which the paths of files in the text start; the working folder without it.

    Raises:
        ScenarioError: It is no TOML, of no known system, or cannot be run as it stands.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{source}: is not TOML: {error}") from error
    data.setdefault("name", Path(source).stem)
    if data.get("system") not in list(SYSTEMS):
        from sato.scenario.file import parse as parse_mission

        return parse_mission(text, overrides, source=source, folder=folder)
    if folder is not None:
        data = _located(data, folder)
    try:
        for setting in overrides:
            override(data, setting, ConnectivityFile)
        return ConnectivityFile.model_validate(data, context={"source": source})
    except Refusal as refusal:
        raise ScenarioError(f"{source}: {refusal}") from refusal
    except ValidationError as error:
        raise ScenarioError(f"{source}: {explain(error, data)}") from error


def _find(name: str | Path) -> tuple[Path, str]:
    known = names()
    if str(name) in known:
        return BUILT_IN / f"{name}.toml", str(name)
    file = Path(name)
    if file.is_file():
        return file, str(file)
    if file.suffix == ".toml" or len(file.parts) > 1:
        what = "is a folder" if file.is_dir() else "there is no such file"
        raise ScenarioError(f"{file}: {what}; a scenario is a TOML file, or one of {listed(known)}")
    meant = nearest(str(name), known)
    hint = f"did you mean {meant}? There" if meant else "there"
    raise ScenarioError(f'there is no scenario "{name}"; {hint} are {listed(known, "and")}')


def _located(value: Any, folder: Path, key: str = "") -> Any:
    # Files that a scenario names lie beside it, wherever it is run from.
    if isinstance(value, dict):
        return {name: _located(part, folder, name) for name, part in value.items()}
    if isinstance(value, list):
        return [_located(part, folder) for part in value]
    font_file = key == "font" and str(value).lower().endswith((".ttf", ".otf", ".ttc"))
    return str(folder / value) if isinstance(value, str) and (key == "file" or font_file) else value
