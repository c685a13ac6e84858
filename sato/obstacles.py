"""Obstacles: convex, at rest or at constant velocity, as scenarios of any system have them."""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import pi, sqrt
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import Callback, as_kind, as_shape, is_own
from dynamics.convex_hulls import body_distances
from dynamics.inputs import as_array
from dynamics.units import Length, Unit
from sato.scenario.definition import Coordinates, Definition, Matrix, Positive, errors_in
from sato.scenario.errors import InputError

CIRCLE_CORNERS, SPHERE_CORNERS = 24, 200  # of the polytopes about ellipsoids
LEAST_THICKNESS = 1e-6  # of the size of a polytope, below which it has no volume
NEEDED = "{} needs place, corners, nearest and scaled; a subclass of Sphere, say, has them"
Points = Float[Array, "*k d"]
Factors = Annotated[tuple[float, ...], Positive]  # of each axis


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Obstacle(Definition):
    """Convex body that vehicles keep clear of.

    It is the convex hull of `corners`, about the point `place`, and all within `thickness` of it.
    """

    callbacks: ClassVar = {
        "nearest": Callback("points", lambda _, given, x: as_shape(x, np.shape(given["points"]))),
        "scaled": Callback("factors", lambda _, given, x: as_kind(x, Obstacle, "an obstacle")),
    }

    velocity: Annotated[Coordinates | None, Unit("m_s"), "constant velocity; at rest if absent"] = (
        None
    )
    known: Annotated[bool, "known before the flight, else once it is within sensing radius"] = True

    @property
    def thickness(self) -> float:
        """Radius of the ball by which the hull of the corners is thickened [m]."""
        return 0.0

    @property
    def place(self) -> Float[Array, " d"]:
        """Its middle at the start of the mission [m]."""
        raise InputError("", NEEDED.format(type(self).__name__))

    @property
    def corners(self) -> Float[Array, "corners d"]:
        """Corners of a polytope that contains it, but for the radius, from its middle [m]."""
        raise InputError("", NEEDED.format(type(self).__name__))

    @property
    def surface(self) -> Float[Array, "points d"]:
        """Points on its surface, from its middle, whose hull is drawn [m]."""
        if not self.thickness:
            return self.corners
        ball = polytope_about_ball(self.axes)
        unit = ball / np.linalg.norm(ball, axis=1, keepdims=True)
        farthest = self.corners[(self.corners @ unit.T).argmax(axis=0)]
        return np.asarray(farthest + self.thickness * unit)

    def nearest(self, points: Points) -> Points:
        """Find its points that are nearest to others, at the start; of one inside, itself [m]."""
        raise InputError("", NEEDED.format(type(self).__name__))

    def distances(self, points: Points) -> Float[Array, "*k"]:
        """Compute the distance of points from it at the start, 0 inside [m]."""
        return np.asarray(np.linalg.norm(points - self.nearest(points), axis=-1))

    def scaled(self, factors: Factors) -> "Obstacle":
        """Return the same in space that is scaled by a factor along each of its axes."""
        raise InputError("", NEEDED.format(type(self).__name__))

    def _scale_motion(self, factors: tuple[float, ...]) -> dict[str, Any]:
        drift = None if self.velocity is None else _scale(self.velocity, factors)
        return {"velocity": drift, "known": self.known}

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of arrays, by name."""
        return {"d": self.axes}

    @property
    def axes(self) -> int:
        """Axes of space."""
        return len(self.place)

    @property
    def drift(self) -> Float[Array, " d"]:
        """Its velocity [m/s]."""
        return np.zeros(self.axes) if self.velocity is None else np.array(self.velocity)

    def place_at(self, time: float) -> Float[Array, " d"]:
        """Return its middle at a time since the start of the mission [m]."""
        return np.asarray(self.place + time * self.drift)

    def check(self) -> None:
        """Refuse lists of unequal lengths."""
        if self.axes not in (2, 3):
            raise InputError("", f"has {self.axes} coordinates, and space has 2 or 3")
        if self.velocity is not None and len(self.velocity) != self.axes:
            reason = f"has {len(self.velocity)} entries, and the obstacle {self.axes} coordinates"
            raise InputError("velocity_m_s", reason)
        if is_own(kind := type(self)):
            names = ("place_at", "drift", "distances")
            if wrong := [n for n in names if getattr(kind, n) is not getattr(Obstacle, n)]:
                reason = "velocity_m_s and nearest are all that it moves and keeps a distance by"
                raise InputError("", f"{kind.__name__}.{wrong[0]} is not asked for: {reason}")
            with errors_in(f"{kind.__name__}.corners"):
                corners = as_array(self.corners, 2)
            self._check_nearest(corners)

    def _check_nearest(self, corners: Float[Array, "corners d"]) -> None:
        """Refuse nearest points outside of the corners and the thickness, or not the nearest."""
        directions = spread_directions(self.axes, SPHERE_CORNERS)
        extents = (corners @ directions.T).max(axis=0) + self.thickness
        points = self.place + 3 * extents.max() * directions
        nearest = self.nearest(points)
        beyond = (nearest - self.place) @ directions.T - extents
        if beyond.max() > 1e-6 * extents.max():
            place = points[beyond.max(axis=1).argmax()]
            told = f"{beyond.max():.3g} m outside of the corners, thickened by {self.thickness:g} m"
            reason = f"gives for {place.round(3)} what is {told}; corners that contain it would do"
            raise InputError("", f"{type(self).__name__}.nearest {reason}")
        away = np.linalg.norm(points[:, None] - nearest, axis=2)  # from points that are given too
        farther = away.diagonal() - away.min(axis=1)
        if farther.max() > 1e-6 * extents.max():
            place, name = points[farther.argmax()].round(3), f"{type(self).__name__}.nearest"
            reason = f"gives for {place} a point that is {farther.max():.3g} m farther than another"
            raise InputError("", f"{name} {reason} that it gives; the nearest would do")


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(Obstacle):
    """Sphere, or in the plane a circle."""

    kind: ClassVar[str] = "sphere"
    center: Annotated[Coordinates, Unit("m"), "center"]
    radius: Annotated[Length, Positive, "radius"]

    @property
    def thickness(self) -> float:  # noqa: D102
        return self.radius

    def scaled(self, factors: Factors) -> "Ellipsoid":  # noqa: D102
        semi_axes = tuple(self.radius * f for f in factors)
        return Ellipsoid(_scale(self.center, factors), semi_axes, **self._scale_motion(factors))

    @property
    def place(self) -> Float[Array, " d"]:  # noqa: D102
        return np.array(self.center)

    @property
    def corners(self) -> Float[Array, "1 d"]:  # noqa: D102
        return np.zeros((1, self.axes))

    def nearest(self, points: Points) -> Points:  # noqa: D102
        offset = points - self.place
        away = np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), self.radius)
        surface = self.place + offset * (self.radius / away)
        return np.where(away > self.radius, surface, points)


@dataclass(frozen=True, eq=False, repr=False)
class Box(Obstacle):
    """Box with sides along the axes, or in the plane a rectangle."""

    kind: ClassVar[str] = "box"
    low: Annotated[Coordinates, Unit("m"), "lowest corner"]
    high: Annotated[Coordinates, Unit("m"), "highest corner"]

    def check(self) -> None:
        """Refuse corners that are not in order."""
        if len(self.high) != len(self.low):
            reason = f"has {len(self.high)} coordinates, and low_m {len(self.low)}"
            raise InputError("high_m", reason)
        if not (np.array(self.low) < self.high).all():
            raise InputError("low_m", "must be less than high_m along every axis")
        super().check()

    def scaled(self, factors: Factors) -> "Box":  # noqa: D102
        sides = _scale(self.low, factors), _scale(self.high, factors)
        return Box(*sides, **self._scale_motion(factors))

    @property
    def place(self) -> Float[Array, " d"]:  # noqa: D102
        return (np.array(self.low) + self.high) / 2

    @property
    def corners(self) -> Float[Array, "corners d"]:  # noqa: D102
        half = (np.array(self.high) - self.low) / 2
        return np.asarray(corners_of_cube(self.axes) * half)

    def nearest(self, points: Points) -> Points:  # noqa: D102
        return np.asarray(np.clip(points, self.low, self.high))


@dataclass(frozen=True, eq=False, repr=False)
class Ellipsoid(Obstacle):
    """Ellipsoid with semi-axes along the axes of space, or in the plane an ellipse.

    Vehicles plan about a polytope that contains it, and is larger by up to 1 % in the plane and
    2 % in space.
    """

    kind: ClassVar[str] = "ellipsoid"
    center: Annotated[Coordinates, Unit("m"), "center"]
    semi_axes: Annotated[
        tuple[Annotated[float, Positive], ...], Unit("m"), "semi-axis along each axis"
    ]

    def check(self) -> None:
        """Refuse other than a semi-axis for each coordinate."""
        if len(self.semi_axes) != len(self.center):
            reason = f"has {len(self.semi_axes)} entries, and center_m {len(self.center)}"
            raise InputError("semi_axes_m", reason)
        super().check()

    def scaled(self, factors: Factors) -> "Ellipsoid":  # noqa: D102
        own = _scale(self.center, factors), _scale(self.semi_axes, factors)
        return Ellipsoid(*own, **self._scale_motion(factors))

    @property
    def place(self) -> Float[Array, " d"]:  # noqa: D102
        return np.array(self.center)

    @property
    def corners(self) -> Float[Array, "corners d"]:  # noqa: D102
        return np.asarray(polytope_about_ball(self.axes) * np.array(self.semi_axes))

    def nearest(self, points: Points) -> Points:
        """Find its points that are nearest to others, at the start; of one inside, itself [m].

        The nearest point is a² x/(a² + t) for each semi-axis a, with the root t > 0 of its
        equation, found by bisection.
        """
        offset, a = points - self.place, np.array(self.semi_axes)
        low = np.zeros(offset.shape[:-1])
        high = np.linalg.norm(offset * a, axis=-1)
        outside = ((offset / a) ** 2).sum(axis=-1) > 1
        for _ in range(80):
            t = (low + high) / 2
            is_low = ((a * offset / (a**2 + t[..., None])) ** 2).sum(axis=-1) > 1
            low, high = np.where(is_low, t, low), np.where(is_low, high, t)
        surface = self.place + a**2 * offset / (a**2 + high[..., None])
        return np.where(outside[..., None], surface, points)


@dataclass(frozen=True, eq=False, repr=False)
class Polytope(Obstacle):
    """Convex polytope: the hull of its corners, or the points within all of its faces."""

    kind: ClassVar[str] = "polytope"
    points: Annotated[Matrix | None, Unit("m"), "corners"] = None
    normals: Annotated[Matrix | None, "normal n of each face, outwards, instead of corners"] = None
    offsets: Annotated[Coordinates | None, Unit("m"), "n·x at each face"] = None

    def check(self) -> None:
        """Refuse what is no convex polytope with a volume."""
        if (self.points is None) == (self.normals is None):
            reason = "needs points_m, or normals and offsets_m, and not both"
            raise InputError("points_m", reason)
        if self.normals is not None and len(self.offsets or ()) != len(self.normals):
            reason = f"has {len(self.offsets or ())} entries for {len(self.normals)} normals"
            raise InputError("offsets_m", reason)
        if self.normals is not None and self.normals.shape[1] not in (2, 3):
            raise InputError("normals", f"have {self.normals.shape[1]} coordinates, not 2 or 3")
        listed = self._listed
        if listed.shape[1] not in (2, 3):
            raise InputError("points_m", f"have {listed.shape[1]} coordinates, not 2 or 3")
        size = np.linalg.svd(listed - listed.mean(axis=0), compute_uv=False)
        if len(listed) <= listed.shape[1] or size[-1] <= LEAST_THICKNESS * size[0]:
            raise InputError("points_m", "have no volume; corners on all sides of it would do")
        from scipy.spatial import ConvexHull

        inside = np.setdiff1d(np.arange(len(listed)), ConvexHull(listed).vertices)
        if self.points is not None and len(inside):
            reason = f"point {inside[0]} is within the hull of the others"
            cure = "without it, or as several convex obstacles, they would do"
            raise InputError("points_m", f"are not the corners of a convex body: {reason}; {cure}")
        super().check()

    @cached_property
    def _listed(self) -> Float[Array, "corners d"]:
        if self.points is not None:
            return np.asarray(self.points)
        return intersect_half_spaces(np.asarray(self.normals), np.array(self.offsets))

    def scaled(self, factors: Factors) -> "Polytope":  # noqa: D102
        each = np.array(_scale((1.0,) * self.axes, factors))
        return Polytope(self._listed * each, **self._scale_motion(factors))

    @property
    def place(self) -> Float[Array, " d"]:  # noqa: D102
        return np.asarray(self._listed.mean(axis=0))

    @property
    def corners(self) -> Float[Array, "corners d"]:  # noqa: D102
        return np.asarray(self._listed - self.place)

    def nearest(self, points: Points) -> Points:  # noqa: D102
        flat = np.reshape(points, (-1, 1, self.axes))
        _, vector = body_distances(flat, self._listed[None], np.zeros(len(flat), dtype=int))
        return np.asarray(points - vector.reshape(points.shape))


def _scale(vector: tuple[float, ...], factors: tuple[float, ...]) -> tuple[float, ...]:
    if len(factors) != len(vector):
        raise InputError("factors", f"must be {len(vector)}, one of each axis, got {len(factors)}")
    return tuple(x * f for x, f in zip(vector, factors, strict=True))


def intersect_half_spaces(
    normals: Float[Array, "faces d"], offsets: Float[Array, " faces"]
) -> Float[Array, "corners d"]:
    """Find the corners of the points x with n·x ≤ offset for all faces.

    Those that are none, have no volume, or are unbounded are refused.
    """
    from scipy.optimize import linprog
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

    length = np.linalg.norm(normals, axis=1)
    if not (length > 0).all():
        raise InputError("normals", "must not be zero")
    unit, offsets, d = normals / length[:, None], offsets / length, normals.shape[1]
    # The largest ball within all faces; a cube bounds it where they do not.
    wide = 1e6 * (1 + np.abs(offsets).max())
    A = np.hstack([unit, np.ones((len(unit), 1))])
    bounds = [(-wide, wide)] * d + [(0, wide)]
    found = linprog(-np.eye(d + 1)[d], A, offsets, bounds=bounds)
    if found.status != 0 or found.x[d] <= LEAST_THICKNESS * np.abs(offsets).max():
        raise InputError("offsets_m", "leave no volume within all faces; larger ones would do")
    try:
        with np.errstate(divide="ignore", invalid="ignore"):  # of an unbounded body
            corners = HalfspaceIntersection(np.column_stack([unit, -offsets]), found.x[:d])
            listed = corners.intersections
        if not np.isfinite(listed).all() or np.abs(listed).max() > wide / 2:
            raise InputError("normals", "leave the body unbounded; faces on all sides would do")
        return np.asarray(listed[ConvexHull(listed).vertices])
    except QhullError as error:
        raise InputError("normals", "leave the body unbounded, or flat") from error


def corners_of_cube(axes: int) -> Float[Array, "corners d"]:
    """Return the corners of the cube from −1 to 1 along each axis."""
    return np.array(list(product((-1.0, 1.0), repeat=axes)))


def spread_directions(axes: int, count: int) -> Float[Array, "count d"]:
    """Return directions that are spread evenly; in space on the spiral of Fibonacci."""
    k = np.arange(count)
    if axes == 2:
        turn = 2 * pi * k / count
        return np.stack([np.cos(turn), np.sin(turn)], axis=1)
    z, angle = 1 - (2 * k + 1) / count, pi * (3 - sqrt(5)) * k
    flat = np.sqrt(1 - z**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)


def polytope_about_ball(axes: int) -> Float[Array, "corners d"]:
    """Return the corners of a polytope that just contains the ball of radius 1."""
    if axes == 2:
        return np.asarray(spread_directions(2, CIRCLE_CORNERS) / np.cos(pi / CIRCLE_CORNERS))
    from scipy.spatial import ConvexHull

    about = spread_directions(axes, SPHERE_CORNERS)
    nearest = -ConvexHull(about).equations[:, -1].max()
    return np.asarray(about / nearest)


AnyObstacle = Sphere | Box | Ellipsoid | Polytope
