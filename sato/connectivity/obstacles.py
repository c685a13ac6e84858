"""Obstacles: spheres, boxes and planes, listed one by one or drawn at random."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from annotated_types import Le, Len
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Length, Unit
from sato.scenario.definition import Coordinates, Definition, NotNegative, Positive
from sato.scenario.errors import InputError

DRAW_HALF_BOX = np.array([15.0, 15.0, 3.0])  # about the middle of the swarm [m]
START_CLEARANCE, WAYPOINT_CLEARANCE = 1.5, 1.8  # of a drawn sphere, at least [m]
REPULSION_CLEARANCE = 0.5  # beyond the distance at which repulsion is infinite, at least [m]
MAX_DRAWS = 10_000  # of one sphere, before it is given up
Point = Annotated[Coordinates, Len(3, 3)]


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(Definition):
    """Sphere."""

    kind: ClassVar[str] = "sphere"
    center: Annotated[Point, Unit("m"), "center"]
    radius: Annotated[Length, Positive, "radius"]


@dataclass(frozen=True, eq=False, repr=False)
class Box(Definition):
    """Box with sides along the axes."""

    kind: ClassVar[str] = "box"
    low: Annotated[Point, Unit("m"), "lowest corner"]
    high: Annotated[Point, Unit("m"), "highest corner"]

    def check(self) -> None:
        """Refuse corners that are not in order."""
        if not (np.array(self.low) < self.high).all():
            raise InputError("low_m", "must be less than high_m along every axis")


@dataclass(frozen=True, eq=False, repr=False)
class Plane(Definition):
    """Half-space."""

    kind: ClassVar[str] = "plane"
    normal: Annotated[Point, "normal of its surface, out of the obstacle"]
    through: Annotated[Point, Unit("m"), "point of its surface"]

    def check(self) -> None:
        """Refuse a normal without a direction."""
        size = hypot(*self.normal)
        if not 1e-6 < size < 1e6:
            raise InputError("normal", f"has length {size:g}; [0, 0, 1] would do for a floor")

    @property
    def unit_normal_and_offset(self) -> tuple[float, ...]:
        """Unit normal n, and n·x at the surface [m]."""
        normal = np.array(self.normal) / hypot(*self.normal)
        return (*normal, float(normal @ np.array(self.through)))


Obstacle = Sphere | Box | Plane


class Obstacles(NamedTuple):
    """Obstacles as arrays; any number of each kind."""

    spheres: Float[Array, "spheres 4"]  # center, radius [m]
    boxes: Float[Array, "boxes 6"]  # lowest corner, highest corner [m]
    planes: Float[Array, "planes 4"]  # unit normal out of the obstacle, n·x at its surface [m]

    @classmethod
    def of(cls, obstacles: Iterable[Obstacle]) -> "Obstacles":
        """Collect definitions."""
        listed = tuple(obstacles)
        spheres = [(*one.center, one.radius) for one in listed if isinstance(one, Sphere)]
        boxes = [(*one.low, *one.high) for one in listed if isinstance(one, Box)]
        planes = [one.unit_normal_and_offset for one in listed if isinstance(one, Plane)]
        parts = ((spheres, 4), (boxes, 6), (planes, 4))
        return cls(*(np.array(rows, dtype=float).reshape(-1, k) for rows, k in parts))

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
        of_start = max(START_CLEARANCE, min_distance + REPULSION_CLEARANCE)
        of_waypoint = max(WAYPOINT_CLEARANCE, min_distance + REPULSION_CLEARANCE)
        points = np.concatenate([start, waypoints])
        clearance = np.repeat([of_start, of_waypoint], [len(start), len(waypoints)])
        drawn = []
        for _ in range(self.count):
            for _ in range(MAX_DRAWS):
                center = start.mean(axis=0) + rng.uniform(-1, 1, 3) * DRAW_HALF_BOX
                radius = rng.uniform(*self.radius)
                if (np.linalg.norm(points - center, axis=1) > radius + clearance).all():
                    break
            else:
                raise InputError(
                    "radius_m",
                    f"no room for a sphere {of_start:g} m clear of starts and {of_waypoint:g} m "
                    "of waypoints; smaller ones would do",
                )
            drawn.append(Sphere(tuple(center.tolist()), radius))
        return tuple(drawn)
