"""Operator's stick: velocity commands to the leader over time."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import Callback, as_kind, as_shape
from dynamics.labels import to_plain
from dynamics.units import Key, Length, Speed, Time, Unit
from sato.connectivity.obstacles import Rows
from sato.scenario.csv_file import read_columns
from sato.scenario.definition import LATER, Definition, NotNegative, Positive, Vector
from sato.scenario.errors import InputError

CLOCK_OF_ITS_OWN = 1e8  # times from which on count from the first: 1973 in Unix seconds [s]
MILLISECONDS = 1e11  # the same in Unix milliseconds: 1973 too, or 5138 in seconds [s]
COLUMNS = {"t": "s", "vx": "m_s", "vy": "m_s", "vz": "m_s"}  # of a recording
MAX_TURN = 1.0  # between two drawn legs [rad]
Vector3 = Float[Array, " 3"]


@dataclass(frozen=True, eq=False, repr=False)
class Stick(Definition):
    """Operator's stick; methods of a user's own are checked."""

    callbacks: ClassVar = {
        "command_velocity": Callback(
            "time position waypoints_reached", lambda own, given, value: as_shape(value, (3,))
        ),
        "has_arrived": Callback(
            "position waypoints_reached",
            lambda own, given, value: bool(as_kind(value, bool | np.bool_, "True or False")),
        ),
        "draw": Callback("leader rng", lambda own, given, drawn: as_kind(drawn, Stick, "a stick")),
    }


@dataclass(frozen=True, eq=False, repr=False)
class WaypointStick(Stick):
    """An operator that steers for one waypoint after another, and lets go now and then."""

    kind: ClassVar[str] = "waypoints"
    waypoints: Annotated[Rows, Unit("m"), "waypoints in the world frame; drawn if absent"] = LATER
    count: Annotated[int, Positive, "number of waypoints that are drawn"] = 4
    spacing: Annotated[Length, Positive, "distance of two drawn waypoints"] = 20.0
    speed: Annotated[Speed, Positive, "commanded speed"] = 2.5
    start_time: Annotated[
        Time, Key("start"), NotNegative, "time at which the stick is first held"
    ] = 5.0
    hold_time: Annotated[Time, Key("on"), Positive, "time for which the stick is held"] = 25.0
    release_time: Annotated[Time, Key("off"), NotNegative, "time for which it is then let go"] = 5.0
    arrival_radius: Annotated[
        Length, Key("near"), Positive, "distance at which a waypoint is reached"
    ] = 1.0
    time_constant: Annotated[
        Time, Key("slow"), Positive, "time constant of the approach to a waypoint"
    ] = 0.5

    def draw(self, leader: Vector3, rng: np.random.Generator) -> "WaypointStick":
        """Return the stick with waypoints; drawn ones are level with the leader's start."""
        if self.waypoints is not None:
            return self
        turns = rng.uniform(-np.pi, np.pi), rng.uniform(-MAX_TURN, MAX_TURN, self.count - 1)
        angle = np.cumsum(np.append(*turns))
        legs = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(self.count)])
        return replace(self, waypoints=leader + self.spacing * np.cumsum(legs, axis=0))

    def command_velocity(self, time: float, position: Vector3, waypoints_reached: int) -> Vector3:
        """Compute the velocity commanded at a time [s] and a place of the leader [m], in m/s."""
        held = time - self.start_time
        is_held = held >= 0 and held % (self.hold_time + self.release_time) < self.hold_time
        if waypoints_reached >= len(self.waypoints) or not is_held:
            return np.zeros(3)
        gap = self.waypoints[waypoints_reached] - position
        far = max(np.linalg.norm(gap), self.speed * self.time_constant)
        return np.asarray(gap * self.speed / far)

    def has_arrived(self, position: Vector3, waypoints_reached: int) -> bool:
        """Tell whether the leader is at its next waypoint."""
        if waypoints_reached >= len(self.waypoints):
            return False
        gap = self.waypoints[waypoints_reached] - position
        return bool(np.linalg.norm(gap) < self.arrival_radius)


@dataclass(frozen=True, eq=False, repr=False)
class RecordedStick(Stick):
    """A recorded stick; each velocity holds until the next.

    Times are those of the flight. From `CLOCK_OF_ITS_OWN` on they are of a clock of the recorder's
    own, as Unix seconds are, and the flight begins with the first of them.
    """

    kind: ClassVar[str] = "recorded"
    times: Annotated[Vector, Unit("s"), "increasing times"] = LATER
    velocities: Annotated[Rows, Unit("m_s"), "velocity from each time on, in the world frame"] = (
        LATER
    )
    file: Annotated[str | None, "CSV file with rows of time, v_x, v_y, v_z; in s and m/s"] = None

    def __post_init__(self) -> None:
        """Refuse velocities of xarray whose labels are other times."""
        coordinates: Any = getattr(self.velocities, "coords", {})
        labels = to_plain(coordinates["time"], "s") if "time" in coordinates else None
        super().__post_init__()
        if labels is not None and not np.array_equal(np.sort(labels), self.times):
            raise InputError("velocities_m_s", "has other times as labels than times_s; drop one")

    def check(self) -> None:
        """Refuse other than one velocity for each of increasing times."""
        given = [name for name in ("times", "velocities") if getattr(self, name) is not None]
        if self.file is not None and given:
            raise InputError("file", f"has the recording, and {given[0]} too; give one of the two")
        if self.file is not None:
            return
        if len(given) < 2:
            raise InputError("", "needs a file, or times_s and velocities_m_s")
        if len(self.times) != len(self.velocities):
            text = f"has {len(self.times)} times for {len(self.velocities)} velocities"
            raise InputError("times_s", text)
        late = np.flatnonzero(~(np.diff(self.times) > 0))
        if len(late):
            before, after = self.times[late[0] : late[0] + 2].tolist()
            reason = f"must increase from one to the next, got {before:.12g} and then {after:.12g}"
            raise InputError("times_s", reason)
        if abs(self.times[0]) >= MILLISECONDS:
            reason = f"begins at {self.times[0]:.4g} s, milliseconds or less of some clock"
            raise InputError("times_s", f"{reason}; times in seconds would do")

    def draw(self, leader: Vector3, rng: np.random.Generator) -> "RecordedStick":
        """Return the stick with the contents of its file, and the times of the flight."""
        stick = self.without_file()
        if stick.times[0] < CLOCK_OF_ITS_OWN:
            return stick
        return replace(stick, times=stick.times - stick.times[0])

    def require_command(self, duration: float) -> None:
        """Refuse a drawn stick that begins after a flight of this duration [s], or ends before."""
        first, last = self.times[[0, -1]].tolist()
        if last < 0 and not self.velocities[-1].any():
            reason = f"lie from {first:.10g} to {last:.10g} s, before the flight, which begins at 0"
            raise InputError("times_s", f"{reason}; times that are more by {-first:.10g} would do")
        if first >= duration:
            raise InputError(
                "times_s",
                f"lie from {first:.10g} to {last:.10g} s, after the flight of {duration:g} s; "
                f"times that are less by {first:.10g}, or a longer run.duration_s, would do",
            )

    def doubt_end(self, duration: float, step: float) -> list[str]:
        """Say where a command goes on after a drawn recording, or most come elsewhere."""
        if len(self.times) > 1 and (lasting := np.ptp(self.times)) < 2 * step:
            steps = f"{lasting:.3g} s, and a step of the flight {step:g} s"
            return [f"the stick's recording takes {steps}; are the times in s?"]
        flown = int((self.times < duration).sum())
        if 2 * flown <= len(self.times):
            return [
                f"the stick's recording ends at {self.times[-1]:.4g} s, and the flight at "
                f"{duration:g} s, with {flown} of {len(self.times)} commands; are the times in s?"
            ]
        speed, last = float(np.linalg.norm(self.velocities[-1])), float(self.times[-1])
        usual = float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0
        if last + usual >= duration or not speed:
            return []
        return [
            f"the stick's recording ends at {last:.4g} s of {duration:g} s, and its last command "
            f"of {speed:.3g} m/s holds until the end; a last row of zeros would let it go"
        ]

    def without_file(self) -> "RecordedStick":
        """Return the same stick with the contents of its file."""
        if self.file is None:
            return self
        try:
            time, *velocity = read_columns(Path(self.file), "commands", COLUMNS, (4,))[0].values()
            stacked = np.stack(velocity, axis=1)
            return replace(self, times=time, velocities=stacked, file=None)
        except ValueError as error:
            raise InputError("file", f'"{self.file}" cannot be read: {error}') from error

    @property
    def waypoints(self) -> Float[Array, "0 3"]:
        """No waypoints."""
        return np.zeros((0, 3))

    @property
    def speed(self) -> float:
        """Largest commanded speed [m/s]."""
        return float(np.linalg.norm(self.velocities, axis=1).max())

    def command_velocity(self, time: float, position: Vector3, waypoints_reached: int) -> Vector3:
        """Return the recorded velocity, in the world frame [m/s]."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        return self.velocities[k].copy() if k >= 0 else np.zeros(3)

    def has_arrived(self, position: Vector3, waypoints_reached: int) -> bool:
        """Return False: there are no waypoints."""
        return False
