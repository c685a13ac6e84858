"""Export of trajectories: CCSDS orbit ephemeris messages (OEM), a table, or for Rerun.

An OEM holds a single object [CCSDS502, 5.1.3], so a swarm becomes a folder of them, one of
them of the chief. They are written here without a library: `oem` needs astropy and lxml, and
cannot write the comments that explain the axes; `ccsds-ndm` is under the GPL. The tests read
the messages back with `oem`.
"""

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.coordinate_frames import LVLH
from dynamics.doors import checked
from sato.atomic import replace_atomically
from sato.run_data import RunData
from sato.scenario.errors import InputError, join_names
from sato.terminal import as_line

if TYPE_CHECKING:
    from sato.scene import SwarmScene

# In the folder of a run.
DEFAULT_PATHS = {"oem": "oem", "csv": "trajectories.csv", "rrd": "run.rrd"}
DEFAULT_EPOCH = "2026-01-01T00:00:00"  # of time 0, of a run without an epoch [UTC]
INSTALL_RERUN = 'pip install "sato-swarm[rerun]"'
CHIEF_NAME = "chief"
EARTH = "EARTH"  # center of runs that name none
AXES_COMMENT = (
    "Axes: z along the axis of the center, x and y in its equator, as the scenario gives the",
    "orbit of the chief in them. They are inertial: the simulation has no precession, nutation",
    "or polar motion. About the Earth EME2000 is the label that is nearest.",
)
INTERPOLATION_COMMENT = (
    "Thrust is held from one state to the next and jumps there, so no interpolation is good",
    "across states: HERMITE of degree 3 takes two of them at a time.",
)


class Ephemeris(NamedTuple):
    """States of one object while it is alive."""

    name: str
    time: Float[Array, " k"]  # [s]
    relative: Float[Array, "k n"]  # in the chief's frame, or the scenario's axes [m, m/s]
    inertial: Float[Array, "k 6"] | None  # where there is a chief [m, m/s]


@checked
def export(
    data: RunData,
    path: str | Path,
    format: str = "oem",
    make_scene: "Callable[[], SwarmScene] | None" = None,
) -> Path:
    """Write the trajectories of a run for other tools.

    Args:
        data: Data of the run.
        path: A folder for "oem", a file for the others. What is there is replaced once all is
            written, and kept if that fails.
        format: "oem" is one CCSDS OEM an object, in inertial axes. "csv" is one table of all
            states, in the chief's frame and, where there is a chief, in inertial axes too. "rrd"
            is a recording for the viewer Rerun, with targets, links and obstacles.
        make_scene: Makes the scene of the run, for "rrd".

    Returns:
        The path.

    Raises:
        InputError: The run has no chief, and so no inertial states; there is something else at
            the path; or Rerun is not installed.
        OSError: The path cannot be written to.
    """
    path = Path(path)
    reason = _find_obstacle(data, path, format)
    if reason:
        raise InputError("", reason)
    if format == "rrd" and make_scene is not None:
        from sato.recording import write_recording

        return write_recording(make_scene(), str(data.attrs["name"]), path)
    with replace_atomically(path) as new:
        (_write_oem if format == "oem" else _write_csv)(data, new)
    return path


@contextmanager
def _damage_told() -> Iterator[None]:
    try:
        yield
    except (ValueError, ArithmeticError) as error:
        raise InputError("", f"the epoch or the body of the run is damaged: {error}") from error


def iterate_ephemerides(data: RunData) -> Iterator[Ephemeris]:
    """Yield the objects of a run: the chief where there is one, then every agent."""
    time = np.asarray(data["time"], dtype=float)
    parts = [np.asarray(data[name], dtype=float) for name in ("position", "velocity")]
    relative, alive = np.concatenate(parts, axis=-1), np.asarray(data["alive"], dtype=bool)
    inertial = None
    if "chief" in data:
        six = np.asarray(data["chief"], dtype=float)
        with _damage_told():
            frame = LVLH.from_polar_nodal(six, float(data.attrs["k_j2_m5_s2"]))
        inertial = frame.to_inertial(relative)
        yield Ephemeris(CHIEF_NAME, time, np.zeros_like(relative[:, 0]), frame.chief_state)
    digits = len(str(alive.shape[1] - 1))
    for j, there in enumerate(alive.T):
        if there.any():
            states = None if inertial is None else inertial[there, j]
            yield Ephemeris(f"agent-{j:0{digits}}", time[there], relative[there, j], states)


def format_utc(data: RunData, time: Float[Array, " k"]) -> list[str]:
    """Format times of a run in UTC, in milliseconds, or nanoseconds where it takes them.

    Leap seconds are not counted.
    """
    text = str(data.attrs.get("epoch", DEFAULT_EPOCH))
    with _damage_told():
        epoch = datetime.fromisoformat(text)
    # In nanoseconds alone, 64 bits reach from 1677 to 2262.
    parts = np.round(time * 1e9).astype(np.int64) + 1000 * epoch.microsecond
    seconds, parts = np.divmod(parts, 1_000_000_000)
    whole = np.datetime64(epoch.replace(microsecond=0), "s") + seconds.astype("timedelta64[s]")
    length = len("2026-01-01T00:00:00.000") + (6 if (parts % 1_000_000).any() else 0)
    texts = zip(np.datetime_as_string(whole), parts.tolist(), strict=True)
    return [f"{text}.{part:09d}"[:length] for text, part in texts]


def format_oem(data: RunData, track: Ephemeris) -> str:
    """Format an object's trajectory as a CCSDS OEM in key-value notation [CCSDS502, 5]."""
    times, about = format_utc(data, track.time), data.attrs
    center = _as_field(str(about.get("center", EARTH)))
    title = f"{about['name']}, seed {about['seed']}, by sato {about['version']}"
    meta = {
        "OBJECT_NAME": track.name,
        "OBJECT_ID": track.name,
        "CENTER_NAME": center,
        "REF_FRAME": "EME2000" if center == EARTH else f"{center}_EQUATOR_INERTIAL",
        "TIME_SYSTEM": "UTC",
        "START_TIME": times[0],
        "STOP_TIME": times[-1],
    }
    if len(times) > 1:
        meta |= {"INTERPOLATION": "HERMITE", "INTERPOLATION_DEGREE": "3"}
    lines = [
        "CCSDS_OEM_VERS = 2.0",
        f"COMMENT {_as_field(title)}",
        f"CREATION_DATE = {datetime.now(UTC):%Y-%m-%dT%H:%M:%S}",
        "ORIGINATOR = SATO",
        "",
        "META_START",
        *(f"COMMENT {line}" for line in AXES_COMMENT),
        *(f"{key} = {value}" for key, value in meta.items()),
        "META_STOP",
        "",
        *(f"COMMENT {line}" for line in INTERPOLATION_COMMENT),
    ]
    # The standard allows 16 digits [CCSDS502, 7.5], which keep a nanometer.
    states = (track.inertial / 1000).tolist() if track.inertial is not None else []
    for time, state in zip(times, states, strict=True):
        lines.append(" ".join([time, *(f"{value:.15e}" for value in state)]))
    return "\n".join(lines) + "\n"


def _as_field(text: str) -> str:
    return as_line(text).encode("ascii", "replace").decode()


def _write_oem(data: RunData, folder: Path) -> None:
    folder.mkdir()
    for track in iterate_ephemerides(data):
        (folder / f"{track.name}.oem").write_text(format_oem(data, track), encoding="ascii")


def _write_csv(data: RunData, file: Path) -> None:
    with file.open("w", encoding="utf-8", newline="") as out:
        table = csv.writer(out, lineterminator="\n")
        for i, track in enumerate(iterate_ephemerides(data)):
            if not i:
                table.writerow(_csv_header(track))
            rows: list[list[object]] = np.column_stack([track.time, track.relative]).tolist()
            if track.inertial is not None:
                more = zip(format_utc(data, track.time), track.inertial.tolist(), strict=True)
                rows = [[*row, time, *state] for row, (time, state) in zip(rows, more, strict=True)]
            table.writerows([track.name, *row] for row in rows)


def _csv_header(track: Ephemeris) -> list[str]:
    axes = "xyz"[: track.relative.shape[1] // 2]
    state = [*(f"{a}_m" for a in axes), *(f"v{a}_m_s" for a in axes)]
    if track.inertial is None:
        return ["object", "time_s", *state]
    frames = [f"{frame}_{name}" for frame in ("lvlh", "inertial") for name in state]
    return ["object", "time_s", *frames[:6], "utc", *frames[6:]]


def _find_obstacle(data: RunData, path: Path, format: str) -> str:
    if format not in DEFAULT_PATHS:
        return f'there is no format "{format}", only {join_names(DEFAULT_PATHS, "and")}'
    if format == "rrd" and find_spec("rerun") is None:
        return f"the format rrd needs Rerun, which is not installed; {INSTALL_RERUN} would do"
    if format != "oem":
        written = "a table" if format == "csv" else "a recording"
        return f"{path}: is a folder, and {written} goes into a file" if path.is_dir() else ""
    if "chief" not in data:
        return "an OEM needs a [chief], and this run has none; the format csv needs no chief"
    if path.exists() and not path.is_dir():
        return f"{path}: is a file, and OEMs, one an object, go into a folder"
    others = sorted(found.name for found in path.glob("*") if found.suffix != ".oem")
    return f"{path}: holds {others[0]}, not OEMs alone; another folder would do" if others else ""
