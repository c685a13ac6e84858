"""What a run leaves behind: frames, stacked, in one file that explains itself."""

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.inertial import Inertial
from dynamics.plant import Modelled, Plant
from sato.record_variables import ELEMENTS, MAY_LACK, MEANING, dataset

if TYPE_CHECKING:  # xarray takes a second to load; the mission's package itself imports Frame
    import xarray

    import sato.check
    import sato.reconfiguration.mission

RUN_FILE, SUMMARY_FILE = "run.nc", "summary.json"


class RunFileError(ValueError):
    """A run file that cannot be read; the message names the file."""


class Frame(NamedTuple):
    """One control instant."""

    time: float  # [s]
    position: Float[Array, "agents d"]  # [m]
    velocity: Float[Array, "agents d"]  # [m/s]
    alive: Bool[Array, " agents"]
    component: Int[Array, " agents"]  # −1 while not alive
    control: Float[Array, "agents d"]  # commanded, held from now on; NaN where there is none [m/s²]
    applied_control: Float[Array, "agents d"]  # what the plant integrates [m/s²]
    leg: int  # under way from this instant on; the last frame keeps the last leg
    target: Int[Array, " agents"]  # held; −1 none
    believed: Int[Array, " agents"]  # how many targets each agent bids on
    measured: Float[Array, "agents n"] | None  # what the agents believe of their state, under noise
    events: tuple[dict[str, Any], ...]  # {"kind": …, "agents": […], …}; the record adds the time


@dataclass(frozen=True, eq=False)
class Run:
    """A run: everything that happened, and what is said of it."""

    data: "xarray.Dataset"
    summary: dict[str, Any]

    @classmethod
    def of(
        cls,
        frames: Iterable[Frame],
        mission: "sato.reconfiguration.mission.Reconfiguration",
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
            "system": "reconfiguration",
            "name": name,
            "seed": seed,
            "version": version,
            "wall_s": float(wall_s),
            "peak_memory_mib": float(peak_memory_mib),
        }
        about |= {"scenario": scenario_text, "complete": int(not stopped)} | limits(mission)
        if stopped:
            about["stopped"] = stopped
        variables = {**_over_time(frames), **_events(frames), **_over_legs(frames, mission)}
        variables |= _chief(frames, mission)
        data = dataset(variables, about)
        data.attrs["digest"] = digest(data)
        return cls(data, first_words(data.attrs))

    def save(self, folder: str | Path) -> Path:
        """Write run.nc and summary.json, each whole or not at all; returns the folder."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        packed = {name: {"zlib": True} for name, v in self.data.variables.items() if _packs(v)}
        words = json.dumps(self.summary, indent=2, default=plain, allow_nan=False) + "\n"
        with tempfile.TemporaryDirectory(prefix=".saving-", dir=folder) as workshop:
            run, summary = Path(workshop, RUN_FILE), Path(workshop, SUMMARY_FILE)
            self.data.to_netcdf(run, engine="h5netcdf", encoding=packed)
            summary.write_text(words, encoding="utf-8")
            os.replace(run, folder / RUN_FILE)
            os.replace(summary, folder / SUMMARY_FILE)
        return folder

    def check(self) -> "sato.check.Report":
        """Judge the run by recomputing what it promises."""
        from sato.check import judge

        return judge(self)

    def plot(self, folder: str | Path) -> list[Path]:
        """Draw the run's figures into a folder; returns their paths."""
        from sato.plots import plot

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
    lacking = [n for n in _REQUIRED if n not in data.variables]
    lacking += [n for n in _ATTRIBUTES if n not in data.attrs]
    if lacking:
        raise RunFileError(
            f"{file}: is not a run of this project, for it has no {', '.join(lacking)}"
        )
    return Run(data, _summary(file.with_name(SUMMARY_FILE)) or first_words(data.attrs))


def limits(mission: "sato.reconfiguration.mission.Reconfiguration") -> dict[str, float]:
    """The radii, limits and constants that a run file says in its attributes."""
    return {
        "comm_radius_m": mission.comm_radius,
        "collision_radius_m": mission.collision_radius,
        "max_control_m_s2": mission.max_control,
        "max_speed_m_s": mission.max_speed,
        **_gravity(mission.truth),
    }


def digest(data: "xarray.Dataset") -> str:
    """SHA-256 of all that a run says but what it took to compute: the same of the same flight."""
    said = hashlib.sha256()
    about = {str(k): v for k, v in data.attrs.items() if k not in _NOT_OF_THE_FLIGHT}
    said.update(json.dumps(about, sort_keys=True, default=plain).encode())
    for name in sorted(map(str, data.variables)):
        values = np.asarray(data.variables[name].values)
        said.update(f"{name} {values.shape}".encode())
        if values.dtype.kind in "biuf":
            said.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
        else:
            said.update("\0".join(map(str, values.ravel())).encode())
    return said.hexdigest()


def first_words(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """What a summary says before the run is judged."""
    words = {"system": attributes["system"], "scenario": attributes["name"]}
    for name in ("seed", "version", "wall_s", "peak_memory_mib", "stopped"):
        with suppress(KeyError):
            value = attributes[name]
            words[name] = value.item() if isinstance(value, np.generic) else value
    return words


def plain(value: object) -> object:
    """What JSON cannot write by itself: NumPy's arrays and scalars."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


_REQUIRED = [name for name in MEANING if name not in MAY_LACK]
_NOT_OF_THE_FLIGHT = ("digest", "wall_s", "peak_memory_mib")
_ATTRIBUTES = ("system", "scenario", "name", "seed", "version")


def _gravity(plant: Plant) -> dict[str, float]:
    orbit = plant.orbit if isinstance(plant, Inertial | Modelled) else None
    return {} if orbit is None else {"mu_m3_s2": orbit.mu, "k_j2_m5_s2": orbit.k_J2}


def _over_time(frames: Sequence[Frame]) -> dict[str, Array]:
    stacked = {
        name: np.array([getattr(f, name) for f in frames])
        for name in Frame._fields
        if name not in ("measured", "events")
    }
    # An interrupted flight commands nothing from its last instant on.
    for name in ("control", "applied_control"):
        stacked[name][-1] = np.nan
    stacked["control_instant"] = np.ones(len(frames), dtype=bool)
    if any(f.measured is not None for f in frames):
        d = frames[0].position.shape[1]
        seen = np.array([_belief(f) for f in frames])
        stacked["measured_position"], stacked["measured_velocity"] = seen[..., :d], seen[..., d:]
    return stacked


def _belief(frame: Frame) -> Float[Array, "agents n"]:
    if frame.measured is not None:
        return frame.measured
    return np.full((len(frame.position), 2 * frame.position.shape[1]), np.nan)


def _events(frames: Sequence[Frame]) -> dict[str, Array]:
    told = [
        json.dumps({"time": float(f.time), **event}, default=plain)
        for f in frames
        for event in f.events
    ]
    return {"event": np.array(told, dtype=object)}


def _over_legs(
    frames: Sequence[Frame], mission: "sato.reconfiguration.mission.Reconfiguration"
) -> dict[str, Array]:
    d, legs = mission.model.axes, mission.legs
    most = max(len(leg.targets) for leg in legs)
    targets = np.full((len(legs), most, 2 * d), np.nan)
    for states, leg in zip(targets, legs, strict=True):
        states[: len(leg.targets)] = leg.targets
    believed = np.full((len(legs), len(mission.start)), -1)
    for event in (e for f in frames for e in f.events if e["kind"] == "leg_end"):
        live = np.asarray(event["agents"], dtype=int)
        believed[event["leg"], live] = np.asarray(event["believed"])[live]
    return {
        "target_position": targets[..., :d],
        "target_velocity": targets[..., d:],
        "targets_believed": believed,
    }


def _chief(
    frames: Sequence[Frame], mission: "sato.reconfiguration.mission.Reconfiguration"
) -> dict[str, Array]:
    flown = [mission.truth.chief(frame.time) for frame in frames]
    known = [chief for chief in flown if chief is not None]
    return {"element": np.array(ELEMENTS), "chief": np.array(known)} if known else {}


def _packs(variable: "xarray.Variable") -> bool:
    return variable.ndim > 1 and variable.dtype.kind in "biuf"


def _summary(file: Path) -> dict[str, Any]:
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
