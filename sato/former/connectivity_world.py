"""What surrounds the robots: the operator's stick, obstacles, and misfortune."""

from math import hypot
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from sato.connectivity.mission import AgentLoss
from sato.connectivity.obstacles import Obstacles
from sato.connectivity.stick import RecordedStick, WaypointStick
from sato.former.refusal import Refusal
from sato.former.units import Table

AROUND = np.array([15.0, 15.0, 3.0])  # half the box, about the swarm, that obstacles are drawn in
OF_START, OF_WAYPOINT = 1.5, 1.8  # how clear a drawn obstacle is of them [m],
ROOM = 0.5  # and beyond the distance at which it pushes without limit [m]
DRAWINGS = 10_000  # of an obstacle, before it is given up
BEND = 1.0  # between two drawn legs at most [rad]


class ToWaypoints(Table):
    """An operator who steers for waypoints, and lets go now and then."""

    kind: Literal["waypoints"]
    waypoints_m: list[list[float]] | None = None  # without them, some are drawn
    count: PositiveInt = 3  # so many,
    spacing_m: PositiveFloat = 5.0  # so far apart
    speed_m_s: PositiveFloat = WaypointStick.speed
    on_s: PositiveFloat = WaypointStick.hold_time
    off_s: NonNegativeFloat = WaypointStick.release_time
    near_m: PositiveFloat = WaypointStick.arrival_radius
    slow_s: PositiveFloat = WaypointStick.time_constant

    def stick(self, leader: Float[Array, " 3"], rng: np.random.Generator) -> WaypointStick:
        """The operator; waypoints that are drawn are level with the leader's start.

        Raises:
            Refusal: Waypoints are not in space.
        """
        if self.waypoints_m is None:
            turns = np.append(rng.uniform(-np.pi, np.pi), rng.uniform(-BEND, BEND, self.count - 1))
            angle = np.cumsum(turns)
            legs = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(self.count)])
            ways = leader + self.spacing_m * np.cumsum(legs, axis=0)
        else:
            ways = _in_space(self.waypoints_m, "waypoints_m")
        return WaypointStick(ways, self.speed_m_s, self.on_s, self.off_s, self.near_m, self.slow_s)

    def portable(self) -> "ToWaypoints":
        """The same."""
        return self


class Replayed(Table):
    """A stick as it was recorded: rows of time and velocity, from a CSV file or listed."""

    kind: Literal["recorded"]
    file: str | None = None
    times_s: list[float] | None = None
    velocities_m_s: list[list[float]] | None = None

    def stick(self, leader: Float[Array, " 3"], rng: np.random.Generator) -> RecordedStick:
        """The operator.

        Raises:
            Refusal: There is no such recording, or it is none.
        """
        if self.file is not None:
            table = _table(self.file)
            times, velocities = table[:, 0], table[:, 1:]
        elif self.times_s is None or self.velocities_m_s is None:
            raise Refusal("", "needs a file, or times_s and velocities_m_s")
        else:
            times = np.array(self.times_s, dtype=float)
            velocities = _in_space(self.velocities_m_s, "velocities_m_s")
            if len(times) != len(velocities):
                raise Refusal("times_s", f"has {len(times)} times for {len(velocities)} velocities")
        if not (np.diff(times) > 0).all():
            raise Refusal("file" if self.file else "times_s", "times must increase from row to row")
        return RecordedStick(times, velocities)

    def portable(self) -> "Replayed":
        """The same without its file."""
        if self.file is None:
            return self
        table = _table(self.file)
        return Replayed(
            kind="recorded", times_s=table[:, 0].tolist(), velocities_m_s=table[:, 1:].tolist()
        )


AnyStick = Annotated[ToWaypoints | Replayed, Field(discriminator="kind")]


class Ball(Table):
    """A sphere."""

    kind: Literal["sphere"]
    centre_m: list[float]
    radius_m: PositiveFloat


class Box(Table):
    """A box whose sides are along the axes."""

    kind: Literal["box"]
    low_m: list[float]
    high_m: list[float]


class Plane(Table):
    """A half-space; its normal points out of it."""

    kind: Literal["plane"]
    normal: list[float]
    through_m: list[float]


AnyObstacle = Annotated[Ball | Box | Plane, Field(discriminator="kind")]


class Scatter(Table):
    """Spheres that are drawn, clear of starts and waypoints."""

    count: Annotated[int, Field(ge=0, le=1000)] = 0
    radius_m: list[PositiveFloat] = Field(default=[0.3, 0.8])  # between these


class Lost(Table):
    """A robot that is lost; which and when is drawn where it is not said."""

    robot: NonNegativeInt | None = None
    time_s: NonNegativeFloat | None = None


def placed(obstacles: list[AnyObstacle]) -> Obstacles:
    """Obstacles one by one.

    Raises:
        Refusal: One of them is none; the key is its number and what is wrong with it.
    """
    spheres, boxes, planes = np.empty((0, 4)), np.empty((0, 6)), np.empty((0, 4))
    for number, one in enumerate(obstacles):
        try:
            if isinstance(one, Ball):
                row = np.append(_point(one.centre_m, "centre_m"), one.radius_m)
                spheres = np.vstack([spheres, row])
            elif isinstance(one, Box):
                low, high = _point(one.low_m, "low_m"), _point(one.high_m, "high_m")
                if not (low < high).all():
                    raise Refusal("low_m", "must be less than high_m along every axis")
                boxes = np.vstack([boxes, np.append(low, high)])
            else:
                normal = _point(one.normal, "normal")
                size = hypot(*normal)
                if not 1e-6 < size < 1e6:
                    raise Refusal("normal", f"has length {size:g}; [0, 0, 1] would do for a floor")
                normal = normal / size
                level = normal @ _point(one.through_m, "through_m")
                planes = np.vstack([planes, np.append(normal, level)])
        except Refusal as refusal:
            raise refusal.inside(f"{number}") from refusal
    return Obstacles(spheres, boxes, planes)


def scattered(
    asked: Scatter,
    start: Float[Array, "agents 3"],
    waypoints: Float[Array, "waypoints 3"],
    nearest: float,
    rng: np.random.Generator,
) -> Float[Array, "spheres 4"]:
    """Spheres about the swarm.

    Args:
        asked: How many, and how large.
        start: Of each robot [m].
        waypoints: Of the leader [m].
        nearest: Distance at which obstacles push without limit [m].
        rng: Draws them.

    Raises:
        Refusal: There is no room for them, or radii are not in order.
    """
    if len(asked.radius_m) != 2 or asked.radius_m[0] > asked.radius_m[1]:
        raise Refusal("radius_m", "needs the smallest and the largest; [0.3, 0.8] would do")
    drawn, misses = np.empty((0, 4)), 0
    of_start, of_waypoint = max(OF_START, nearest + ROOM), max(OF_WAYPOINT, nearest + ROOM)
    while len(drawn) < asked.count:
        centre = start.mean(axis=0) + rng.uniform(-1, 1, 3) * AROUND
        radius = rng.uniform(asked.radius_m[0], asked.radius_m[1])
        clear = np.linalg.norm(start - centre, axis=1).min() > radius + of_start
        if clear and (np.linalg.norm(waypoints - centre, axis=1) > radius + of_waypoint).all():
            drawn, misses = np.vstack([drawn, np.append(centre, radius)]), 0
        elif (misses := misses + 1) == DRAWINGS:
            raise Refusal(
                "radius_m",
                f"no room for a sphere {of_start:g} m clear of starts and {of_waypoint:g} m of "
                "waypoints; smaller ones would do",
            )
    return drawn


def mourned(
    deaths: list[Lost], agents: int, duration: float, rng: np.random.Generator
) -> tuple[AgentLoss, ...]:
    """Who is lost, and when.

    Raises:
        Refusal: There is no such robot, or it is lost twice.
    """
    if agents - len(deaths) < 2:
        raise Refusal("", f"{len(deaths)} of {agents} robots are lost; two must be left")
    left = list(range(agents))
    for number, death in enumerate(deaths):
        if death.robot is None:
            continue
        if death.robot not in left:
            known = ", ".join(map(str, left))
            raise Refusal(f"{number}.robot", f"{death.robot} is none that is left of {known}")
        left.remove(death.robot)
    found: list[AgentLoss] = []
    for death in deaths:
        robot = death.robot
        if robot is None:
            robot = left.pop(int(rng.integers(len(left))))
        time = rng.uniform(0, duration) if death.time_s is None else death.time_s
        found.append(AgentLoss(robot, float(time)))
    return tuple(found)


def _in_space(rows: list[list[float]], key: str) -> Float[Array, "k 3"]:
    if not rows or any(len(row) != 3 for row in rows):
        raise Refusal(key, "needs rows of 3 coordinates")
    return np.array(rows, dtype=float)


def _point(row: list[float], key: str) -> Float[Array, " 3"]:
    if len(row) != 3:
        raise Refusal(key, f"needs 3 coordinates, got {len(row)}")
    return np.array(row, dtype=float)


def _table(file: str) -> Float[Array, "k 4"]:
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
        rows = [line for line in lines if line.partition("#")[0].strip()]
        if not rows:
            raise Refusal("file", f'"{file}" has no rows')
        table = np.loadtxt(rows, delimiter=",", ndmin=2, comments="#")
    except OSError as error:
        raise Refusal("file", f'"{file}" cannot be read: {error.strerror or error}') from error
    except ValueError as error:
        raise Refusal("file", f'"{file}" is no table of numbers: {error}') from error
    if table.shape[1] != 4 or not np.isfinite(table).all():
        raise Refusal("file", f'"{file}" needs rows of time, v_x, v_y, v_z; in s and m/s')
    return table
