"""Settings of a formation flight: control, avoidance, assignment, frames and supervision."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Le, Len
from jaxtyping import Complex, Float
from numpy import ndarray as Array
from pydantic import BeforeValidator

from dynamics.doors import checked
from dynamics.labels import to_plain
from dynamics.units import Acceleration, Angle, Length, Speed, Time, Unit
from sato.scenario.definition import (
    HALF_TURN,
    TURNS,
    Convert,
    Coordinates,
    Definition,
    Key,
    NotNegative,
    Positive,
    as_array,
)
from sato.scenario.errors import InputError

BLOCKED_SPEED_SHARE = 0.2  # of the largest speed: slower than this an agent counts as stopped


@checked
class ControlLaw(NamedTuple):
    """Numbers of the control law [Lusk2020, eq. 2, and Sec. III-C for the size]."""

    gain: Annotated[float, Positive, "gain of the velocity command"] = 1.5
    size_rate: Annotated[float, Key("size"), Positive, "decay of errors of size [1/s]"] = 0.6
    upright: Annotated[bool, "heights as in the formation; else its mirror image will do"] = True


@checked
class CollisionAvoidance(NamedTuple):
    """Numbers of the collision avoidance; the legacy one uses its range alone."""

    avoidance_range: Annotated[Length, Key("notice"), Positive, "range of the avoidance"] = 3.0
    margin: Annotated[Length, NotNegative, "distance kept beyond keep_out_m, for noise"] = 0.05
    braking: Annotated[Acceleration, Key("brake"), Positive, "assumed deceleration"] = 0.25
    horizon: Annotated[Time, Key("ahead"), Positive, "time for which others are to be passed"] = 2.0
    right_turn_bias: Annotated[
        Angle,
        Key("aside"),
        NotNegative,
        HALF_TURN,
        "turn to the right of a command that has to change",
    ] = 0.2
    blocked_time: Annotated[Time, Positive, "time for which a vehicle lets others stop it"] = 3.0
    wander_time: Annotated[
        Time, Positive, "time of flight away from them then; longer each time"
    ] = 4.0
    legacy: Annotated[
        bool, Key("legacy_avoidance"), "avoidance, limits and size control of the paper's code"
    ] = False
    unwrapped_angles: Annotated[bool, "with legacy_avoidance: angles do not wrap"] = False


@checked
class AssignmentSettings(NamedTuple):
    """Assignment of points to agents, and when it is repeated."""

    method: Annotated[
        Literal["vsdaa", "cbaa", "hungarian", "none"], Key("kind"), "method of assignment"
    ] = "vsdaa"
    first_delay: Annotated[Time, Key("first"), NotNegative, "time until the first auction"] = 1.5
    period: Annotated[Time, Positive, "time between two auctions"] = 2.0
    relative_epsilon: Annotated[
        float, Key("fineness"), Positive, "bid increment of vsdaa, of the extent of the formation"
    ] = 0.04


@checked
class SupervisorSettings(NamedTuple):
    """Criteria of convergence and gridlock, as in the trials of [Lusk2020]."""

    convergence_speed: Annotated[Speed, Key("settled"), Positive, "largest speed on arrival"] = 0.15
    averaging_window: Annotated[Time, Positive, "time of averages of speed and avoidance"] = 1.0
    convergence_time: Annotated[Time, NotNegative, "time for which all must have arrived"] = 1.0
    gridlock_share: Annotated[float, Positive, Le(1), "share of time blocked in a gridlock"] = 0.95
    gridlock_timeout: Annotated[Time, Key("patience"), Positive, "longest gridlock"] = 90.0
    hover_time: Annotated[Time, Key("hover"), NotNegative, "hovering before and after legs"] = 5.0
    time_limit: Annotated[
        Time, Key("limit"), Positive, "longest flight, without hovering, then given up"
    ] = 600.0
    shape_tolerance: Annotated[Length, Key("shape"), Positive, "error of a formed shape"] = 0.1


class CoordinateFrames(NamedTuple):
    """Coordinate frame of each agent, in which it estimates positions."""

    rotation: Complex[Array, " agents"]  # e^(j yaw)
    origin: Float[Array, "agents 3"]  # [m]
    drift_rate: Float[Array, "agents 3"]  # odometry error per meter flown, in its own axes


def _as_rows(value: Any) -> Any:
    if isinstance(value, Array | list | tuple):
        return as_array(value, 2)
    if isinstance(value, int | float) and value < 0:
        raise InputError("", f"must not be negative, got {value:g}")
    return value


Angles = Annotated[
    Literal["random", "aligned"] | Array,
    BeforeValidator(lambda value: value if isinstance(value, str) else as_array(value, 1)),
    TURNS,
]
IN_RADIANS = Convert(partial(to_plain, unit="rad"))  # of a key without a unit
SizeOrRows = Annotated[float | Array, BeforeValidator(_as_rows)]


@dataclass(frozen=True, eq=False, repr=False)
class FrameSettings(Definition):
    """Coordinate frames of the agents, errors of their odometry and noise of their sensors.

    Arrays, one row an agent, stand in place of what is drawn.
    """

    yaw: Annotated[Angles, IN_RADIANS, "headings [rad], random, or the same for all"] = "random"
    offset: Annotated[SizeOrRows, Unit("m"), "origins, or largest coordinate"] = 10.0
    drift: Annotated[SizeOrRows, "odometry error per meter, each or its size"] = 0.01
    noise: Annotated[Length, NotNegative, "standard deviation of a measured coordinate"] = 0.02

    def draw(self, agents: int, rng: np.random.Generator) -> "FrameSettings":
        """Return the settings with an array, a row an agent, for whatever was to be drawn."""
        rows = {"yaw": (agents,), "offset": (agents, 3), "drift": (agents, 3)}
        given = {name: value for name in rows if isinstance(value := getattr(self, name), Array)}
        for name, value in given.items():
            if value.shape != rows[name]:
                raise InputError(name, f"needs the shape {rows[name]}, got {value.shape}")
        if len(given) == len(rows):
            return self
        direction = rng.standard_normal((agents, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        drawn: dict[str, Any] = {"yaw": rng.uniform(-np.pi, np.pi, agents)}
        if isinstance(self.yaw, str) and self.yaw == "aligned":
            drawn["yaw"] = np.zeros(agents)
        if "offset" not in given:
            drawn["offset"] = rng.uniform(-self.offset, self.offset, (agents, 3))
        return replace(self, **({"drift": self.drift * direction} | drawn | given))


@dataclass(frozen=True, eq=False, repr=False)
class OperatorCommand(Definition):
    """Velocity that an operator commands of one agent for a while."""

    agent: Annotated[int, Key("vehicle"), NotNegative, "index of the vehicle"]
    start: Annotated[Time, NotNegative, "time of its beginning, from the start of the flight"]
    end: Annotated[Time, Positive, "time of its end"]
    velocity: Annotated[Coordinates, Len(3, 3), Unit("m_s"), "velocity in the vehicle's own frame"]

    def check(self) -> None:
        """Refuse a command that ends before it begins."""
        if not self.start < self.end:
            raise InputError("end_s", f"from {self.start:g} s to {self.end:g} s it never begins")
