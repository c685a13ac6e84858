"""Obstacles: spheres, boxes and planes, their distances, and lines of sight among them."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from annotated_types import Le, Len
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from pydantic import BeforeValidator

from dynamics.units import Unit
from dynamics.vehicle import vector_lengths
from sato.obstacles import Box, Sphere
from sato.scenario.definition import Coordinates, Definition, NotNegative, Positive, as_array
from sato.scenario.errors import InputError

DRAW_HALF_BOX = np.array([15.0, 15.0, 3.0])  # about the middle of the swarm [m]
START_CLEARANCE, WAYPOINT_CLEARANCE = 1.5, 1.8  # of a drawn sphere, at least [m]
REPULSION_CLEARANCE = 0.5  # beyond the distance at which repulsion is infinite, at least [m]
MAX_DRAWS = 10_000  # of one sphere, before it is given up


def _as_rows(value: Any) -> Array:
    rows = as_array(value, 2)
    if rows.shape[1] != 3:
        raise InputError("", f"needs rows of 3 coordinates, got {rows.shape[1]}")
    return rows


Point = Annotated[Coordinates, Len(3, 3)]
Rows = Annotated[Array, BeforeValidator(_as_rows)]  # of coordinates
Points = Float[Array, "*#k 3"]


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
    def of(cls, obstacles: Sequence[Obstacle]) -> "Obstacles":
        """Collect definitions."""
        spheres = [(*one.center, one.radius) for one in obstacles if isinstance(one, Sphere)]
        boxes = [(*one.low, *one.high) for one in obstacles if isinstance(one, Box)]
        planes = [one.unit_normal_and_offset for one in obstacles if isinstance(one, Plane)]
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
                radius = rng.uniform(self.radius[0], self.radius[1])
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


def obstacle_distances(
    position: Float[Array, "*k 3"], obstacles: Obstacles
) -> Float[Array, "*k obstacles"]:
    """Compute the distance to each sphere, box and plane, negative inside [m]."""
    spheres, boxes, planes = obstacles
    at, found = position[..., None, :], [np.empty((*position.shape[:-1], 0))]
    if len(spheres):
        found.append(vector_lengths(at - spheres[:, :3]) - spheres[:, 3])
    if len(boxes):
        beyond = np.maximum(boxes[:, :3] - at, at - boxes[:, 3:])
        outside = vector_lengths(np.maximum(beyond, 0))
        found.append(outside + np.minimum(beyond.max(axis=-1), 0))
    if len(planes):
        found.append(position @ planes[:, :3].T - planes[:, 3])
    return np.concatenate(found, axis=-1)


def nearest_points(p: Float[Array, "*k 3"], obstacles: Obstacles) -> Float[Array, "*k obstacles 3"]:
    """Find the nearest point of the surface of each sphere, box and plane [m]."""
    spheres, boxes, planes = obstacles
    at, found = p[..., None, :], [np.empty((*p.shape[:-1], 0, 3))]
    if len(spheres):
        centers, radius = np.split(spheres, [3], axis=1)
        gap = at - centers
        far = vector_lengths(gap)[..., None]
        outwards = np.where(far > 0, gap, np.eye(3)[0]) / np.where(far > 0, far, 1)
        found.append(centers + radius * outwards)
    if len(boxes):
        low, high = boxes[:, :3], boxes[:, 3:]
        clipped = np.clip(at, low, high)
        # Inside of a box the nearest of its six faces counts.
        faces = np.stack([low, high], axis=-1)
        depth = np.abs(at[..., None] - faces).reshape(*clipped.shape[:-1], 6)
        nearest = np.arange(6) == depth.argmin(axis=-1)[..., None]
        nearest = nearest.reshape(*clipped.shape, 2)
        on_face = np.where(nearest.any(axis=-1), (faces * nearest).sum(axis=-1), at)
        is_inside = (clipped == at).all(axis=-1, keepdims=True)
        found.append(np.where(is_inside, on_face, clipped))
    if len(planes):
        normals, offset = planes[:, :3], planes[:, 3]
        found.append(at - ((at * normals).sum(axis=-1) - offset)[..., None] * normals)
    return np.concatenate(found, axis=-2)


def segments_hit_balls(
    p: Points, q: Points, center: Points, radius: Float[Array, "*#k"] | float
) -> Bool[Array, "*#k"]:
    """Tell whether the segments between two positions meet balls."""
    way = q - p
    length = (way**2).sum(axis=-1)
    along = ((center - p) * way).sum(axis=-1) / np.where(length > 0, length, 1)
    nearest = p + np.clip(along, 0, 1)[..., None] * way
    return np.asarray(((nearest - center) ** 2).sum(axis=-1) < np.square(radius))


def blocks_line_of_sight(p: Points, q: Points, obstacles: Obstacles) -> Bool[Array, "*#k"]:
    """Tell whether an obstacle is between two positions."""
    p, q = p[..., None, :], q[..., None, :]
    spheres = segments_hit_balls(p, q, obstacles.spheres[:, :3], obstacles.spheres[:, 3])
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # along an axis: ±∞, NaN
        ends = (obstacles.boxes.reshape(-1, 2, 3) - p[..., None, :]) / (q - p)[..., None, :]
    enters, leaves = ends.min(axis=-2).max(axis=-1), ends.max(axis=-2).min(axis=-1)
    boxes = np.maximum(enters, 0) < np.minimum(leaves, 1)
    normals, offset = obstacles.planes[:, :3], obstacles.planes[:, 3]
    planes = np.minimum((p * normals).sum(axis=-1), (q * normals).sum(axis=-1)) < offset
    return np.asarray(np.concatenate([spheres, boxes, planes], axis=-1).any(axis=-1))


def min_obstacle_distance(
    position: Float[Array, "instants agents 3"],
    alive: Bool[Array, "instants agents"],
    obstacles: Obstacles,
) -> float:
    """Compute the least distance of a live agent on straight lines between instants [m].

    Who is lost at an instant has moved until then. Obstacles are convex, so the distance to one
    falls and then rises along a line: a ternary search finds its minimum to 1e-9 of the length.
    Distance changes by no more than the length of the line, so few lines can lead closer than
    their ends.
    """
    away = obstacle_distances(position, obstacles)
    least = float(away[alive].min(initial=np.inf))
    far = np.linalg.norm(np.diff(position, axis=0), axis=2)[..., None]
    near = (away[1:] + away[:-1] - far) / 2 < least
    k, i, which = np.nonzero(near & alive[:-1, :, None])

    def at(share: Float[Array, " ways"]) -> Float[Array, " ways"]:
        places = position[k, i] + share[:, None] * (position[k + 1, i] - position[k, i])
        return obstacle_distances(places, obstacles)[np.arange(len(k)), which]

    low, high = np.zeros(len(k)), np.ones(len(k))
    for _ in range(52):
        third = (high - low) / 3
        sooner = at(low + third) < at(high - third)
        low, high = np.where(sooner, low, low + third), np.where(sooner, high - third, high)
    return min(least, float(at((low + high) / 2).min(initial=np.inf)))
