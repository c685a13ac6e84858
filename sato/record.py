"""Run files: frames stacked to the data of a run, which is written and read as netCDF-4."""

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Generic,
    NamedTuple,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array

from dynamics.callbacks import as_kind
from dynamics.doors import check_methods, checked
from sato.atomic import RECORD, remove_leftovers, replace_atomically
from sato.check.common import EventLog
from sato.check.report import finite_or_none
from sato.files import check_no_link, read_text
from sato.interfaces import HELD, Frame, FrameT, MissionT, Recorded, System
from sato.run_data import RunData, Variable, json_default
from sato.scenario.errors import InputError
from sato.systems import load_system

RUN_FILE, SUMMARY_FILE = RECORD
MAX_FRAMES = 300  # of a film, unless more are asked for
DRAWN_FORMATS = ("png", "pdf", "mp4", "gif", "html")
READS = 5  # until a run file and a summary are of one run
MARKED = 1 << 16  # bytes at either end of a file, in which its mark is
AXIS_NAMES = ("x", "y", "z")

_REQUIRED_ATTRIBUTES = ("system", "scenario", "name", "seed", "version")
_MEASURED = ("wall_s", "peak_memory_mib")
_SINGLE_ATTRIBUTES = (*_REQUIRED_ATTRIBUTES, *_MEASURED, "format", "complete", "stopped", "digest")
DTYPES = {float: float, Float: float, bool: bool, Bool: bool, int: int, Int: int}
FORMAT = 2  # of the run file; files of sato 0.1 have no such attribute

FieldsT = TypeVar("FieldsT")
VariablesT = TypeVar("VariablesT")
RecordT = TypeVar("RecordT", bound="RunRecord[Any, Any, Any]")


class CommonVariables(NamedTuple):
    """Variables of every run beside those of its frames."""

    control_instant: Annotated[Bool[Array, " time"], "1", "true at a control instant"]
    event: Annotated[Shaped[Array, " event"], "1", "event as JSON, with its time and agents"]
    axis: Annotated[Shaped[Array, " axis"], "1", "axis of the coordinate frame"]


class RunFileError(ValueError):
    """A run file that cannot be read; the message names the file."""


@checked
def collect_run_data(
    system: System[MissionT, FrameT],
    frames: Sequence[FrameT],
    mission: MissionT,
    stopped: str = "",  # reason why the flight ended early
    **attributes: str | int | float,
) -> RunData:
    """Collect the data of a run from its frames, one an instant, and its drawn mission.

    Attributes are the name of the scenario, its file as `scenario`, from which the run can be
    repeated, its `origin` (`sato.scenario.origin`), seed and version; and wall_s and
    peak_memory_mib, the time [s] and memory [MiB] that the simulation took.
    """
    if not frames:
        raise ValueError("a run needs at least one frame")
    attributes |= {"format": FORMAT, "system": system.name, "complete": int(not stopped)}
    attributes |= {"stopped": stopped} if stopped else {}
    events = [
        json.dumps({"time": float(frame.time), **event}, default=json_default)
        for frame in frames
        for event in frame.events
    ]
    common = CommonVariables(
        control_instant=np.ones(len(frames), dtype=bool),
        event=np.array(events, dtype=object),
        axis=np.array(AXIS_NAMES[: frames[0].position.shape[1]]),
    )
    variables = stack(frames) | write_variables(common)
    if system.collect is not None:
        variables |= write_variables(system.collect(frames, mission))
    constants = as_kind(system.attributes(mission), Mapping, "a dict of System.attributes")
    return RunData(variables, attributes | dict(constants)).seal()


@checked
def save(data: RunData, summary: Mapping[str, Any], folder: Path) -> None:
    """Write run.nc and summary.json, each whole or not at all.

    What was there is kept if that fails. Figures, films and players of another run are removed:
    none is ever beside another's.
    """
    plain = json.loads(json.dumps(summary, default=json_default))
    plain |= {"digest": data.attrs["digest"]} if "digest" in data.attrs else {}
    text = json.dumps(finite_or_none(plain), indent=2, allow_nan=False) + "\n"
    others = _iterate_others(folder, data.attrs.get("digest", "without a digest"))
    with replace_atomically(folder / RUN_FILE, others, is_record=True) as file:
        file.write_bytes(data.to_netcdf())
    with replace_atomically(folder / SUMMARY_FILE, is_record=True) as file:
        file.write_text(text, encoding="utf-8")


def _iterate_others(folder: Path, digest: object) -> Iterator[Path]:
    yield from {*find_drawn(folder), folder / SUMMARY_FILE}.difference(find_drawn(folder, digest))


def drawn_mark(digest: object = "") -> str:
    """Return the mark in figures, films and players, by which those of a run are found."""
    return f"drawn by sato from run {digest}"


def find_drawn(folder: Path, digest: object = "") -> list[Path]:
    """Find the figures, films and players in a folder: all, or those of the run with a digest."""
    mark = drawn_mark(digest).encode()
    paths = (path for end in DRAWN_FORMATS for path in sorted(folder.glob(f"*.{end}")))
    return [path for path in paths if mark in _read_ends(path)]


def _read_ends(path: Path) -> bytes:
    """Read the first and last bytes of a file, where marks are; none of what cannot be read."""
    if not (path.is_file() and os.access(path, os.R_OK)):
        return b""
    with path.open("rb") as file:
        first = file.read(MARKED)
        file.seek(max(path.stat().st_size - MARKED, len(first)))
        return first + file.read()


@checked
def load(path: Path) -> tuple[RunData, dict[str, Any]]:
    """Read the data and the summary of a run from its folder, or from the run file itself.

    A file of another name than run.nc has no summary beside it, for that may be another run's. The
    summary of another run, but for one that is written meanwhile, counts as empty. A `RunFileError`
    says that it is missing, damaged, or not a run.
    """
    remove_leftovers(path if path.is_dir() else path.parent)
    file = path / RUN_FILE if path.is_dir() else path
    beside = file.with_name(SUMMARY_FILE)
    for _ in range(READS):
        data = _read_data(path, file)
        summary = _read_summary(beside) if file.name == RUN_FILE else None
        summary = initial_summary(data.attrs) if summary is None else summary
        digest = data.attrs.get("digest")
        if summary.pop("digest", digest) == digest:
            return data, summary
    return data, {}


def _read_data(path: Path, file: Path) -> RunData:
    from sato.run_file import read_run_file

    if not file.exists():
        raise RunFileError(f"{file}: there is no such run file; `sato run` writes one")
    try:
        if path.is_dir():
            check_no_link(file, "the folder of a run")
        data = read_run_file(file)
    except InputError as error:
        raise RunFileError(str(error)) from error
    except Exception as error:  # a damaged file makes h5py raise errors of many kinds
        text = f"{file}: cannot be read as netCDF-4: it is damaged or another kind of file"
        raise RunFileError(text) from error
    check_format(file, data)
    return data


def initial_summary(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Begin the summary of a run, with what no check gives."""
    summary = {"system": attributes["system"], "scenario": attributes["name"]}
    for name in ("seed", "version", *_MEASURED, "stopped"):
        if name in attributes:
            value = attributes[name]
            summary[name] = value.item() if isinstance(value, np.generic) else value
    return summary


@check_methods
@dataclass(frozen=True, eq=False)
class RunRecord(Generic[MissionT, FrameT, VariablesT]):
    """A run as recorded, and the mission as drawn again from its scenario."""

    mission: MissionT
    frames: FrameT  # with time as the leading axis of each field
    variables: VariablesT
    attributes: dict[str, Any]

    @classmethod
    def from_data(cls: type[RecordT], data: RunData, mission: Any) -> RecordT:
        """Read the data of a run; fields of its frames that are not recorded are None."""
        system = load_system(data.attrs["system"])
        frames: Any = read_variables(system.frame, data)
        frames = frames._replace(events=EventLog.from_data(data).events)
        variables: Any = system.run_variables and read_variables(system.run_variables, data)
        return cls(mission, frames, variables, dict(data.attrs))

    @property
    def time(self) -> Float[Array, " instants"]:
        """Time of each instant [s]."""
        return np.asarray(self.frames.time)

    @property
    def leg_index(self) -> Int[Array, " instants"]:
        """Leg under way at each instant, of a system with legs."""
        frames: Any = self.frames
        return np.asarray(frames.leg_index)

    @cached_property
    def events(self) -> EventLog:
        """Events of the run, by instant."""
        return EventLog(self.time, self.frames.events)


def stack(frames: Sequence[Frame]) -> dict[str, Variable]:
    """Stack the recorded fields of frames of one type, at least one, over time."""
    found: dict[str, Variable] = {}
    for name, field in recorded_fields(type(frames[0])).items():
        values = [getattr(frame, name) for frame in frames]
        known = next((value for value in values if value is not None), None)
        if known is not None:
            stacked = np.array([known * np.nan if v is None else v for v in values])
            if field.is_held:
                stacked[-1] = np.nan
            found[name] = _variable(stacked, field, "time")
    return found


def write_variables(values: object) -> dict[str, Variable]:
    """Describe the recorded fields of a named tuple; those that are None are left out."""
    fields = recorded_fields(type(values))
    found = {name: getattr(values, name) for name in fields}
    return {
        name: _variable(np.asarray(value), fields[name])
        for name, value in found.items()
        if value is not None
    }


def read_variables(kind: type[FieldsT], data: RunData) -> FieldsT:
    """Read a named tuple of recorded fields; None where the run does not have a field."""
    # The file keeps the kind of a number, but a user's own tool may have written doubles.
    values: dict[str, Any] = dict.fromkeys(get_type_hints(kind))
    for name, field in recorded_fields(kind).items():
        if name in data:
            values[name] = np.asarray(data[name], dtype=field.dtype)
    return kind(**values)


def recorded_fields(kind: type) -> dict[str, Recorded]:
    """Return the declarations of the recorded fields of a named tuple."""
    found = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        if get_origin(hint) is Annotated:
            declared, unit, meaning, *marks = get_args(hint)
            options = get_args(declared) or (declared,)
            dims = tuple(getattr(options[0], "dim_str", "").split())
            scalar = getattr(options[0], "dtype", options[0])
            dtype = DTYPES.get(scalar)
            is_optional, is_held = type(None) in options, HELD in marks
            found[name] = Recorded(dims, unit, meaning, is_optional, is_held, dtype)
    return found


def _variable(values: Array, field: Recorded, *leading: str) -> Variable:
    return Variable(
        (*leading, *field.dims), values, {"units": field.unit, "long_name": field.meaning}
    )


def check_format(file: Path | str, data: RunData) -> None:
    """Refuse data that are not those of a run; the file is named in the message."""
    lacking = [name for name in ("time", "position", "event") if name not in data]
    lacking += [name for name in _REQUIRED_ATTRIBUTES if name not in data.attrs]
    _raise_if_missing(file, lacking)
    for name in filter(data.attrs.__contains__, _SINGLE_ATTRIBUTES):
        value = data.attrs[name]
        is_whole = isinstance(value, int | np.integer) and 0 <= value < 2**64
        is_digest = isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None
        is_wrong = (name in ("seed", "format") and not is_whole) or np.ndim(value)
        if is_wrong or (name == "digest" and not is_digest):
            raise RunFileError(f"{file}: is damaged, for its {name} is {value!r}")
    version = int(data.attrs.get("format", 1))
    if version != FORMAT:
        reads = "which reads it; for this version, fly the scenario again"
        reads = reads if version < FORMAT else "and this version is too old for it"
        raise RunFileError(f"{file}: was written by sato {data.attrs['version']}, {reads}")
    try:
        system = load_system(str(data.attrs["system"]))
    except InputError as error:
        text = f"{file}: {error.reason}; a newer version of sato may know it"
        raise RunFileError(text) from error
    kinds = [system.frame, CommonVariables, *filter(None, [system.run_variables])]
    fields = {name: field for kind in kinds for name, field in recorded_fields(kind).items()}
    needed = sorted(name for name, field in fields.items() if not field.is_optional)
    _raise_if_missing(file, [name for name in needed if name not in data])


def _raise_if_missing(file: Path | str, lacking: list[str]) -> None:
    if lacking:
        raise RunFileError(f"{file}: is not a run of sato, for it has no {', '.join(lacking)}")


def _read_summary(file: Path) -> dict[str, Any] | None:
    if not file.is_file() or file.is_symlink():
        return None
    try:
        summary = json.loads(read_text(file))
        if not isinstance(summary, dict):
            raise ValueError("not a table")
        return summary
    except FileNotFoundError:  # taken away meanwhile
        return None
    except (ValueError, OSError, RecursionError) as error:
        text = f"{file}: is not readable JSON; delete it, the run file beside it is enough"
        raise RunFileError(text) from error
