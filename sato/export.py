"""Trajectories for other tools: CCSDS orbit ephemeris messages, and a table.

An orbit ephemeris message (OEM) holds a single object [CCSDS502, 5.1.3], so a swarm becomes
a folder of them, the chief's among them. They are written here, for it takes few lines: of
the libraries that could, `oem` brings astropy and lxml along and leaves out comments, in
which a reader is told what the axes are, and `ccsds-ndm` is under the GPL. The first reads
them back in the tests.
"""

import csv
import os
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.coordinate_frames import LVLH
from sato.record import Run

DEFAULT_PATHS = {"oem": "oem", "csv": "trajectories.csv"}  # in the folder of a run
DEFAULT_EPOCH = "2026-01-01T00:00:00"  # of time 0 where the scenario says nothing else [UTC]
CHIEF_NAME = "chief"
AXES_COMMENT = (
    "Axes: z along the axis of the Earth, x and y in its equator, as the scenario gives the",
    "orbit of the chief in them. They are inertial, and EME2000 is the label that is nearest:",
    "the simulation knows no precession, nutation or motion of the pole.",
)
INTERPOLATION_COMMENT = (
    "Thrust is held from one state to the next and jumps there, so no interpolation is good",
    "across states: HERMITE of degree 3 takes two of them at a time.",
)


class Ephemeris(NamedTuple):
    """Where one object was, as long as it was there."""

    name: str
    time: Float[Array, " k"]  # [s]
    relative: Float[Array, "k n"]  # in the chief's frame, or in the scenario's own [m, m/s]
    inertial: Float[Array, "k 6"] | None  # where there is a chief [m, m/s]


def export(run: Run, path: str | Path, format: str = "oem") -> Path:
    """Write the trajectories of a run for other tools.

    Args:
        run: The run.
        path: A folder for "oem", a file for "csv". What is there is replaced once all is
            written, and kept if that fails.
        format: "oem" is one CCSDS OEM an object, in inertial axes. "csv" is one table of all
            states, in the chief's frame and, where there is a chief, in inertial axes too.

    Returns:
        The path.

    Raises:
        ValueError: The run has no chief, and so no inertial states; or what is at the path
            is not for this format to replace.
        OSError: The path cannot be written to.
    """
    path = Path(path)
    if format not in DEFAULT_PATHS:
        raise ValueError(f'there is no format "{format}", only {" and ".join(DEFAULT_PATHS)}')
    if format == "oem":
        _validate_oem_target(run, path)
    elif path.is_dir():
        raise ValueError(f"{path}: is a folder, and a table goes into a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".exporting-", dir=path.parent) as workshop:
            made, former = Path(workshop, "made"), Path(workshop, "former")
            (_write_oem if format == "oem" else _write_csv)(run, made)
            _replace_path(made, path, former)
    except OSError as error:  # which names a file of the workshop
        raise OSError(error.errno, error.strerror, str(path)) from error
    return path


def iterate_ephemerides(run: Run) -> Iterator[Ephemeris]:
    """The objects of a run: the chief where there is one, then every agent that was there."""
    data = run.data
    time = np.asarray(data["time"], dtype=float)
    parts = [np.asarray(data[name], dtype=float) for name in ("position", "velocity")]
    relative, alive = np.concatenate(parts, axis=-1), np.asarray(data["alive"], dtype=bool)
    inertial = None
    if "chief" in data:
        six = np.asarray(data["chief"], dtype=float)
        frame = LVLH.from_polar_nodal(six, float(data.attrs["k_j2_m5_s2"]))
        inertial = frame.to_inertial(relative)
        yield Ephemeris(
            CHIEF_NAME, time, np.zeros((len(time), relative.shape[-1])), frame.chief_state
        )
    digits = len(str(alive.shape[1] - 1))
    for j, there in enumerate(alive.T):
        if there.any():
            states = None if inertial is None else inertial[there, j]
            yield Ephemeris(f"agent-{j:0{digits}}", time[there], relative[there, j], states)


def format_utc(run: Run, time: Float[Array, " k"]) -> list[str]:
    """Times of a run in UTC, to the nanosecond if a millisecond does not do.

    Leap seconds are not counted.
    """
    chief = tomllib.loads(str(run.data.attrs["scenario"])).get("chief", {})
    epoch = np.datetime64(datetime.fromisoformat(chief.get("epoch", DEFAULT_EPOCH)), "ns")
    since = np.round(time * 1e9).astype(np.int64)
    unit: Literal["ms", "ns"] = "ms"
    if (since % 1_000_000).any() or int(epoch.astype(np.int64)) % 1_000_000:
        unit = "ns"
    return [str(np.datetime_as_string(epoch + np.timedelta64(int(t), "ns"), unit)) for t in since]


def format_oem(run: Run, track: Ephemeris) -> str:
    """An object's trajectory as a CCSDS OEM in key-value notation [CCSDS502, 5]."""
    when = format_utc(run, track.time)
    about = run.data.attrs
    meta = {
        "OBJECT_NAME": track.name,
        "OBJECT_ID": track.name,
        "CENTER_NAME": "EARTH",
        "REF_FRAME": "EME2000",
        "TIME_SYSTEM": "UTC",
        "START_TIME": when[0],
        "STOP_TIME": when[-1],
    }
    if len(when) > 1:
        meta |= {"INTERPOLATION": "HERMITE", "INTERPOLATION_DEGREE": "3"}
    lines = [
        "CCSDS_OEM_VERS = 2.0",
        f"COMMENT {_to_ascii(about['name'])}, seed {about['seed']}, by sato {about['version']}",
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
    # No more than 16 digits are allowed [CCSDS502, 7.5], and they do not lose a bit that counts.
    kilo = (track.inertial / 1000).tolist() if track.inertial is not None else []
    for moment, state in zip(when, kilo, strict=True):
        lines.append(" ".join([moment, *(f"{value:.15e}" for value in state)]))
    return "\n".join(lines) + "\n"


def _write_oem(run: Run, folder: Path) -> None:
    folder.mkdir()
    for track in iterate_ephemerides(run):
        (folder / f"{track.name}.oem").write_text(format_oem(run, track), encoding="ascii")


def _write_csv(run: Run, file: Path) -> None:
    with file.open("w", encoding="utf-8", newline="") as out:
        table = csv.writer(out, lineterminator="\n")
        for i, track in enumerate(iterate_ephemerides(run)):
            if not i:
                table.writerow(_csv_header(track))
            rows: list[list[object]] = np.column_stack([track.time, track.relative]).tolist()
            if track.inertial is not None:
                more = zip(format_utc(run, track.time), track.inertial.tolist(), strict=True)
                rows = [[*row, when, *state] for row, (when, state) in zip(rows, more, strict=True)]
            table.writerows([track.name, *row] for row in rows)


def _csv_header(track: Ephemeris) -> list[str]:
    axes = "xyz"[: track.relative.shape[1] // 2]
    state = [*(f"{a}_m" for a in axes), *(f"v{a}_m_s" for a in axes)]
    if track.inertial is None:
        return ["object", "time_s", *state]
    frames = [f"{frame}_{name}" for frame in ("lvlh", "inertial") for name in state]
    return ["object", "time_s", *frames[:6], "utc", *frames[6:]]


def _validate_oem_target(run: Run, path: Path) -> None:
    if "chief" not in run.data:
        raise ValueError(
            "this run has no chief, and so no inertial states to put into an OEM; only scenarios "
            "with a [chief] fly in orbit, and the format csv takes the others"
        )
    if path.exists() and not path.is_dir():
        raise ValueError(f"{path}: is a file, and OEMs, one an object, go into a folder")
    if path.is_dir():
        others = sorted(p.name for p in path.iterdir() if p.suffix != ".oem")
        if others:
            raise ValueError(
                f"{path}: would be replaced as a whole, but holds {others[0]} and not OEMs alone; "
                "another folder would do"
            )


def _replace_path(made: Path, path: Path, former: Path) -> None:
    if not path.is_dir():
        os.replace(made, path)
        return
    os.rename(path, former)
    try:
        os.rename(made, path)
    except BaseException:
        with suppress(FileNotFoundError):
            os.rename(former, path)
        raise


def _to_ascii(text: object) -> str:
    return str(text).encode("ascii", "replace").decode()
