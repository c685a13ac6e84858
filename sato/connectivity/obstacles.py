"""Obstacles: spheres, boxes and planes, listed one by one or drawn at random."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from annotated_types import Le
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Length, Unit
from sato.scenario.definition import Coordinates, Definition, NotNegative, Positive
from sato.scenario.errors import InputError

DRAW_HALF_BOX = np.array([15.0, 15.0, 3.0])  # about the middle of the swarm [m]
START_CLEARANCE, WAYPOINT_CLEARANCE = 1.5, 1.8  # of a drawn sphere, at least [m]
REPULSION_CLEARANCE = 0.5  # beyond the distance at which repulsion is infinite, at least [m]
MAX_DRAWS = 10_000  # of one sphere, before it is given up


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(Definition):
    """Sphere."""

    kind: ClassVar[str] = "sphere"
    center: Annotated[Coordinates, Unit("m"), "center"]
    radius: Annotated[Length, Positive, "radius"]

    def check(self) -> None:
        """Refuse a center that is not in space."""
        _check_point(self.center, "center_m")


@dataclass(frozen=True, eq=False, repr=False)
class Box(Definition):
    """Box with sides along the axes."""

    kind: ClassVar[str] = "box"
    low: Annotated[Coordinates, Unit("m"), "lowest corner"]
    high: Annotated[Coordinates, Unit("m"), "highest corner"]

    def check(self) -> None:
        """Refuse corners that are not in space or not in order."""
        _check_point(self.low, "low_m")
        _check_point(self.high, "high_m")
        if not (np.array(self.low) < self.high).all():
            raise InputError("low_m", "must be less than high_m along every axis")


@dataclass(frozen=True, eq=False, repr=False)
class Plane(Definition):
    """Half-space."""

    kind: ClassVar[str] = "plane"
    normal: Annotated[Coordinates, "normal of its surface, out of the obstacle"]
    through: Annotated[Coordinates, Unit("m"), "point of its surface"]

    def check(self) -> None:
        """Refuse a normal without a direction."""
        _check_point(self.normal, "normal")
        _check_point(self.through, "through_m")
        size = hypot(*self.normal)
        if not 1e-6 < size < 1e6:
            raise InputError("normal", f"has length {size:g}; [0, 0, 1] would do for a floor")


Obstacle = Sphere | Box | Plane


class Obstacles(NamedTuple):
    """Obstacles as arrays; any number of each kind."""

    spheres: Float[Array, "spheres 4"]  # center, radius [m]
    boxes: Float[Array, "boxes 6"]  # lowest corner, highest corner [m]
    planes: Float[Array, "planes 4"]  # unit normal out of the obstacle, n·x at its surface [m]

    @classmethod
    def of(cls, obstacles: Iterable[Obstacle]) -> "Obstacles":
        """Collect definitions."""
        rows: dict[type, list[Any]] = {Sphere: [], Box: [], Plane: []}
        for one in obstacles:
            if isinstance(one, Sphere):
                rows[Sphere].append([*one.center, one.radius])
            elif isinstance(one, Box):
                rows[Box].append([*one.low, *one.high])
            else:
                normal = np.array(one.normal) / hypot(*one.normal)
                rows[Plane].append([*normal, normal @ np.array(one.through)])
        found = (np.array(part, dtype=float) for part in rows.values())
        return cls(*(part.reshape(-1, k) for part, k in zip(found, (4, 6, 4), strict=True)))

    @property
    def total(self) -> int:
        """Number of obstacles."""
        return len(self.spheres) + len(self.boxes) + len(self.planes)


@dataclass(frozen=True, eq=False, repr=False)
class RandomSpheres(Definition):
    """Spheres at random, clear of starts and waypoints."""

    count: Annotated[int, NotNegative, Le(1000), "number of spheres"] = 0
    radius: Annotated[
        tuple[Annotated[float, Positive], ...], Unit("m"), "smallest and largest radius"
    ] = (0.3, 0.8)

    def check(self) -> None:
        """Refuse radii that are no interval."""
        if len(self.radius) != 2 or self.radius[0] > self.radius[1]:
            raise InputError("radius_m", "needs the smallest and the largest; [0.3, 0.8] would do")

    def draw(
        self,
        start: Float[Array, "agents 3"],
        waypoints: Float[Array, "waypoints 3"],
        min_distance: float,
        rng: np.random.Generator,
    ) -> tuple[Sphere, ...]:
        """Draw spheres about the swarm.

        Args:
            start: Initial positions [m].
            waypoints: Waypoints of the leader [m].
            min_distance: Distance at which repulsion is infinite [m].
            rng: Random generator.

        Raises:
            InputError: There is no room.
        """
        drawn: list[Sphere] = []
        of_start = max(START_CLEARANCE, min_distance + REPULSION_CLEARANCE)
        of_waypoint = max(WAYPOINT_CLEARANCE, min_distance + REPULSION_CLEARANCE)
        misses = 0
        while len(drawn) < self.count:
            center = start.mean(axis=0) + rng.uniform(-1, 1, 3) * DRAW_HALF_BOX
            radius = rng.uniform(self.radius[0], self.radius[1])
            is_clear = np.linalg.norm(start - center, axis=1).min() > radius + of_start
            if (
                is_clear
                and (np.linalg.norm(waypoints - center, axis=1) > radius + of_waypoint).all()
            ):
                drawn.append(Sphere(tuple(center.tolist()), radius))
                misses = 0
            elif (misses := misses + 1) == MAX_DRAWS:
                raise InputError(
                    "radius_m",
                    f"no room for a sphere {of_start:g} m clear of starts and {of_waypoint:g} m "
                    "of waypoints; smaller ones would do",
                )
        return tuple(drawn)


def _check_point(point: tuple[float, ...], key: str) -> None:
    if len(point) != 3:
        raise InputError(key, f"needs 3 coordinates, got {len(point)}")
