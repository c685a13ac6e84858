"""What a run leaves behind: frames, stacked, in one file that explains itself."""

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray as Array

from sato.interfaces import Frame, FrameT, MissionT, System, Variable
from sato.systems import UnknownSystemError, load_system

if TYPE_CHECKING:  # xarray takes a second to load
    import xarray

    import sato.check

RUN_FILE, SUMMARY_FILE = "run.nc", "summary.json"

_PER_AGENT = ("time", "agent")
COMMON_VARIABLES = {  # to the runs of all systems
    "time": Variable(("time",), "s", "time since the start"),
    "control_instant": Variable(("time",), "1", "whether a control is commanded at this time"),
    "position": Variable((*_PER_AGENT, "axis"), "m", "true position"),
    "velocity": Variable((*_PER_AGENT, "axis"), "m/s", "true velocity"),
    "alive": Variable(_PER_AGENT, "1", "whether the agent takes part"),
    "component": Variable(_PER_AGENT, "1", "connected component of the network, -1 not alive"),
    "event": Variable(("event",), "1", "what happened, as JSON with time and agents"),
}


class RunFileError(ValueError):
    """A run file that cannot be read; the message names the file."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run: everything that happened, and what is said of it."""

    data: "xarray.Dataset"
    summary: dict[str, Any]

    @classmethod
    def from_frames(
        cls,
        system: System[MissionT, FrameT],
        frames: Iterable[FrameT],
        mission: MissionT,
        scenario_text: str,
        *,
        name: str,
        seed: int,
        version: str,
        wall_s: float,
        peak_memory_mib: float,
        stopped: str = "",
    ) -> "Run":
        """Collect a run from the frames of a system.

        Args:
            system: Whose frames they are, and what they mean.
            frames: One a control instant, in the order of time; at least one.
            mission: What was flown.
            scenario_text: The whole scenario as TOML, so that the run can be repeated.
            name: Name of the scenario.
            seed: Seed of everything that was drawn.
            version: Version of this library.
            wall_s: How long the flight took to compute [s].
            peak_memory_mib: The most memory that it took [MiB].
            stopped: Why the flight ended before it was over; empty where it did not.
        """
        frames = list(frames)
        if not frames:
            raise ValueError("a run needs at least one frame")
        about = {
            "system": system.name,
            "name": name,
            "seed": seed,
            "version": version,
            "wall_s": float(wall_s),
            "peak_memory_mib": float(peak_memory_mib),
        }
        about |= {"scenario": scenario_text, "complete": int(not stopped)}
        about |= system.attributes(mission)
        if stopped:
            about["stopped"] = stopped
        variables = _stack_common_variables(frames) | system.stack_variables(frames, mission)
        data = _build_dataset(variables, {**COMMON_VARIABLES, **system.variable_definitions}, about)
        data.attrs["digest"] = compute_digest(data)
        return cls(data, initial_summary(data.attrs))

    def save(self, folder: str | Path) -> Path:
        """Write run.nc and summary.json, each whole or not at all; returns the folder."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        packed = {
            name: {"zlib": True} for name, v in self.data.variables.items() if _is_compressible(v)
        }
        words = json.dumps(self.summary, indent=2, default=json_default, allow_nan=False) + "\n"
        with tempfile.TemporaryDirectory(prefix=".saving-", dir=folder) as workshop:
            run, summary = Path(workshop, RUN_FILE), Path(workshop, SUMMARY_FILE)
            self.data.to_netcdf(run, engine="h5netcdf", encoding=packed)
            summary.write_text(words, encoding="utf-8")
            os.replace(run, folder / RUN_FILE)
            os.replace(summary, folder / SUMMARY_FILE)
        return folder

    def check(self) -> "sato.check.Report":
        """Judge the run by recomputing what it promises."""
        from sato.verify import verify_run

        return verify_run(self)

    def plot(self, folder: str | Path) -> list[Path]:
        """Draw the run's figures into a folder; returns their paths."""
        from sato.figures import plot

        return plot(self, Path(folder))

    def export(self, path: str | Path, format: str = "oem") -> Path:
        """Write the trajectories for other tools, see `sato.export`."""
        from sato.export import export

        return export(self, path, format)

    def events(self, *kinds: str) -> list[dict[str, Any]]:
        """Everything that happened, in the order of time; of the given kinds only, if any."""
        heard = [json.loads(str(e)) for e in self.data["event"].values]
        return [e for e in heard if not kinds or e["kind"] in kinds]


def load(path: str | Path) -> Run:
    """Read a run from its folder, or from the run file itself.

    Raises:
        RunFileError: The file is missing, damaged, or not a run.
    """
    import xarray

    path = Path(path)
    file = path / RUN_FILE if path.is_dir() else path
    if not file.is_file():
        raise RunFileError(f"{file}: there is no such run file; `sato run` writes one")
    try:
        data = xarray.load_dataset(file, engine="h5netcdf")
    except Exception as error:  # a damaged file makes h5py raise whatever it stumbles over
        raise RunFileError(
            f"{file}: cannot be read as netCDF-4, so it is damaged, cut short or something else; "
            "fly the scenario again"
        ) from error
    _raise_if_missing(
        file,
        _missing_variables(data, COMMON_VARIABLES)
        + [n for n in _REQUIRED_ATTRIBUTES if n not in data.attrs],
    )
    try:
        own = load_system(str(data.attrs["system"])).variable_definitions
    except UnknownSystemError as error:
        raise RunFileError(f"{file}: {error}; a newer version of sato may know it") from error
    _raise_if_missing(file, _missing_variables(data, own))
    return Run(data, _read_summary(file.with_name(SUMMARY_FILE)) or initial_summary(data.attrs))


def compute_digest(data: "xarray.Dataset") -> str:
    """SHA-256 of all that a run says but what it took to compute: the same of the same flight."""
    said = hashlib.sha256()
    about = {str(k): v for k, v in data.attrs.items() if k not in _NOT_IN_DIGEST}
    said.update(json.dumps(about, sort_keys=True, default=json_default).encode())
    for name in sorted(map(str, data.variables)):
        values = np.asarray(data.variables[name].values)
        said.update(f"{name} {values.shape}".encode())
        if values.dtype.kind in "biuf":
            said.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        else:
            said.update("\0".join(map(str, values.ravel())).encode())
    return said.hexdigest()


def initial_summary(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """What a summary says before the run is judged."""
    words = {"system": attributes["system"], "scenario": attributes["name"]}
    for name in ("seed", "version", "wall_s", "peak_memory_mib", "stopped"):
        with suppress(KeyError):
            value = attributes[name]
            words[name] = value.item() if isinstance(value, np.generic) else value
    return words


def json_default(value: object) -> object:
    """What JSON cannot write by itself: NumPy's arrays and scalars."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


_NOT_IN_DIGEST = ("digest", "wall_s", "peak_memory_mib")
_REQUIRED_ATTRIBUTES = ("system", "scenario", "name", "seed", "version")


def _stack_common_variables(frames: Sequence[Frame]) -> dict[str, Array]:
    names = ("time", "position", "velocity", "alive", "component")
    stacked = {name: np.array([getattr(f, name) for f in frames]) for name in names}
    told = [
        json.dumps({"time": float(f.time), **event}, default=json_default)
        for f in frames
        for event in f.events
    ]
    instants = np.ones(len(frames), dtype=bool)  # unless the system knows better
    return stacked | {"control_instant": instants, "event": np.array(told, dtype=object)}


def _build_dataset(
    variables: Mapping[str, Array], meaning: Mapping[str, Variable], attributes: dict[str, Any]
) -> "xarray.Dataset":
    import xarray

    arrays = {}
    for name, values in variables.items():
        of = meaning[name]
        arrays[name] = (of.dims, values, {"units": of.unit, "long_name": of.long_name})
    return xarray.Dataset(arrays, attrs=attributes)


def _missing_variables(data: "xarray.Dataset", meaning: Mapping[str, Variable]) -> list[str]:
    return [n for n, of in meaning.items() if not of.optional and n not in data.variables]


def _raise_if_missing(file: Path, lacking: list[str]) -> None:
    if lacking:
        raise RunFileError(
            f"{file}: is not a run of this project, for it has no {', '.join(lacking)}"
        )


def _is_compressible(variable: "xarray.Variable") -> bool:
    return variable.ndim > 1 and variable.dtype.kind in "biuf"


def _read_summary(file: Path) -> dict[str, Any]:
    if not file.is_file():
        return {}
    try:
        said = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(said, dict):
            raise ValueError("not a table")
        return said
    except (ValueError, OSError) as error:
        raise RunFileError(
            f"{file}: is not readable JSON; delete it, the run file beside it is enough"
        ) from error
