"""Surroundings: all that does not decide, but can be hit, and which agent knows of it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from dynamics.convex_hulls import body_distances
from problems.convexify import SEPARATION_TOLERANCE, AvoidanceHorizon
from problems.obstacle_paths import ObstaclePaths, pad_corners
from sato.obstacles import Obstacle, corners_of_cube, polytope_about_ball
from sato.reconfiguration.mission import Reconfiguration
from sato.scenario.definition import Count

ESCAPE_FACTOR = 2.0  # of the way out of what moves, for others that are in it
AT_REST = 1e-6  # of R in a step: what moves more slowly stays where it is
WALL_FACTOR = 100.0  # size of the walls about the allowed positions, over that of these

Sensed = Obstacle | tuple[Count, ArrayLike]  # or the number of a lost vehicle, and its state


class Surroundings(NamedTuple):
    """Obstacles, walls about the allowed positions, and vehicles that were lost.

    Obstacles move at constant velocity, walls are at rest, and lost vehicles fly without control.
    """

    state: Float[Array, "bodies n"]  # of a point of each, now
    corners: tuple[Float[Array, "_ d"], ...]  # of each, from that point [m]
    thickness: Float[Array, " bodies"]  # beyond the hull of the corners [m]
    is_wall: Bool[Array, " bodies"]
    vehicle: Int[Array, " bodies"]  # number of the lost vehicle; −1 for all others
    is_known: Bool[Array, "agents bodies"]

    @property
    def is_lost(self) -> Bool[Array, " bodies"]:
        """True for vehicles that were lost."""
        return np.asarray(self.vehicle >= 0)

    def join(self, other: "Surroundings") -> "Surroundings":
        """Return all of two."""
        return Surroundings(
            np.concatenate([self.state, other.state]),
            self.corners + other.corners,
            np.append(self.thickness, other.thickness),
            np.append(self.is_wall, other.is_wall),
            np.append(self.vehicle, other.vehicle),
            np.hstack([self.is_known, other.is_known]),
        )

    def with_lost(self, lost: Sequence[int], x: Float[Array, "lost n"]) -> "Surroundings":
        """Return the same with vehicles that were lost, which nobody has seen yet."""
        points = (np.zeros((1, x.shape[1] // 2)),) * len(lost)
        new = _make(x, points, len(self.is_known))
        new.is_known[:] = False
        return self.join(new._replace(vehicle=np.array(lost, dtype=int)))

    def after(self, mission: Reconfiguration, x: Float[Array, "agents n"]) -> "Surroundings":
        """Return the same after a step, in which lost vehicles have moved to their states in x."""
        d, state = mission.axes, self.state.copy()
        state[:, :d] += mission.step * state[:, d:]
        state[self.is_lost] = x[self.vehicle[self.is_lost]]
        return self._replace(state=state)

    def seen_from(self, mission: Reconfiguration, x: Float[Array, "agents n"]) -> "Surroundings":
        """Return the same, with what agents see within their sensing radius."""
        if self.is_known.all():
            return self
        d = mission.axes
        away = x[:, None, :d] - self.state[:, :d]
        body = np.tile(np.arange(len(self.state)), len(x))
        gap, _ = body_distances(away.reshape(-1, 1, d), pad_corners(self.corners), body)
        is_seen = gap.reshape(away.shape[:2]) - self.thickness <= mission.sight
        return self._replace(is_known=self.is_known | is_seen)

    def fly(self, mission: Reconfiguration, horizon: AvoidanceHorizon) -> ObstaclePaths | None:
        """Return the motion of all over a horizon that begins now; without clearances."""
        if not len(self.state):
            return None
        d, pieces = mission.axes, len(horizon.fine_model)
        time = (np.arange(pieces)[:, None] + np.linspace(0.0, 1.0, 4)) * horizon.fine_model.dt
        place, velocity = self.state[:, :d], self.state[:, d:]
        paths = place[:, None, None] + time[..., None] * velocity[:, None, None]
        adrift = self.is_lost & (not mission.is_point_mass)
        if adrift.any():
            u = np.zeros((int(adrift.sum()), horizon.steps, d))
            x = horizon.discrete_model.simulate(self.state[adrift], u)
            paths[adrift] = horizon.control_points(x, u)
        paths, corners = horizon.scale_points(paths), self.corners
        if horizon.scale is not None:  # balls become ellipsoids
            ball, each = polytope_about_ball(d), zip(self.corners, self.thickness, strict=True)
            thick = [c if r == 0 else (c[:, None] + r * ball).reshape(-1, d) for c, r in each]
            corners = tuple(horizon.scale_points(own) for own in thick)
        return ObstaclePaths(paths, pad_corners(corners), np.zeros(len(paths)), velocity)

    def known_to(
        self, mission: Reconfiguration, agent: int, paths: ObstaclePaths | None, clearance: float
    ) -> ObstaclePaths | None:
        """Return those that an agent knows, with the distances that it keeps.

        The paths are the motion of all over a horizon of this clearance [m].
        """
        rows = np.flatnonzero(self.is_known[agent])
        if paths is None or not len(rows):
            return None
        own = float(mission.own_clearances(clearance, np.array([agent]))[0])
        keeps = np.where(mission.ellipsoid is None, own + self.thickness, own)
        keeps[self.is_wall] = own - mission.radius(agent) + mission.largest_separation
        of_lost = mission.own_clearances(clearance, self.vehicle[self.is_lost])
        keeps[self.is_lost] = (own + of_lost) / 2
        return paths._replace(clearance=keeps).select(rows)

    def escape_steps(self, mission: Reconfiguration, agent: int) -> int:
        """Count the steps in which an agent gets out of the way of what it knows to move.

        0 where nothing does. Its commitment is clear for so long after it has come to rest.
        """
        way = mission.step * np.linalg.norm(self.state[:, mission.axes :], axis=1)
        moves = self.is_known[agent] & (way > AT_REST * mission.least_separation)
        if not moves.any():
            return 0
        each = zip(self.corners, self.thickness, moves, strict=True)
        size = max(np.linalg.norm(c, axis=1).max() + t for c, t, is_moving in each if is_moving)
        return count_escape_steps(mission, float(size))


def count_escape_steps(mission: Reconfiguration, size: float) -> int:
    """Count the steps in which vehicles get out of the way of what moves, of a radius [m].

    From rest, twice as far as it is wide, at the least control, and two decisions.
    """
    way = ESCAPE_FACTOR * 2 * (size + mission.largest_separation)
    U, V = mission.least_braking, float(mission.top_speeds.min())
    time = 2 * (way / U) ** 0.5 if way < V**2 / U else way / V + V / U
    return 2 * mission.replan_steps + mission.lag_steps + int(np.ceil(time / mission.step))


def find_surroundings(mission: Reconfiguration) -> Surroundings | None:
    """Return the surroundings at the start of a drawn mission; None where there are never any."""
    if not mission.has_surroundings:
        return None
    around = _place_known(mission, 0.0, len(mission.initial_states))
    hidden = [one for one in mission.obstacles if not one.known]
    unseen = _place(hidden, mission.axes, 0.0, len(mission.initial_states))
    unseen.is_known[:] = False
    return around.join(unseen)


def sense_surroundings(
    mission: Reconfiguration, time: float, rows: int, seen: Sequence[Sensed]
) -> Surroundings | None:
    """Return what one agent knows of its surroundings; None where there is nothing.

    It has seen obstacles, as they are now, and numbers and states of lost vehicles. Its arrays
    have so many rows.
    """
    obstacles = [one for one in seen if isinstance(one, Obstacle)]
    around = _place_known(mission, time, rows).join(_place(obstacles, mission.axes, 0.0, rows))
    lost = [one for one in seen if not isinstance(one, Obstacle)]
    if lost:
        states = np.array([state for _, state in lost], dtype=float)
        around = around.with_lost([number for number, _ in lost], states)
    around.is_known[:] = True
    return around if len(around.state) else None


def _place_known(mission: Reconfiguration, time: float, rows: int) -> Surroundings:
    known = [one for one in mission.obstacles if one.known]
    return _place(known, mission.axes, time, rows).join(_build_walls(mission, rows))


def _make(
    state: Float[Array, "bodies n"], corners: Sequence[Float[Array, "_ d"]], rows: int
) -> Surroundings:
    """Return bodies that are no wall, no vehicle and not thick, all of them known."""
    none, count = np.zeros(len(state)), len(state)
    rest = none, none.astype(bool), np.full(count, -1), np.ones((rows, count), dtype=bool)
    return Surroundings(state, tuple(corners), *rest)


def _place(obstacles: Sequence[Obstacle], axes: int, time: float, rows: int) -> Surroundings:
    """Return obstacles at a time, all of them known."""
    each = [np.concatenate([one.place_at(time), one.drift]) for one in obstacles]
    state = np.array(each).reshape(-1, 2 * axes)
    found = _make(state, [one.corners for one in obstacles], rows)
    return found._replace(thickness=np.array([one.thickness for one in obstacles]))


def _build_walls(mission: Reconfiguration, rows: int) -> Surroundings:
    """Build flat walls as far outside of the allowed positions as vehicles keep from them."""
    d, away = mission.axes, mission.largest_separation
    if mission.box is None:
        return _make(np.zeros((0, 2 * d)), (), rows)
    low, high = np.asarray(mission.box)
    middle, half = (low + high) / 2, WALL_FACTOR * (high - low)
    state, corners = np.tile(np.append(middle, np.zeros(d)), (2 * d, 1)), []
    for axis in range(d):
        # A target on the bounds is as far from a wall as plans keep.
        wide = away * (1 + 2 * SEPARATION_TOLERANCE)
        wide = wide / (mission.separation_scale or np.ones(d))[axis]
        state[2 * axis, axis], state[2 * axis + 1, axis] = low[axis] - wide, high[axis] + wide
        corners += 2 * [np.unique(corners_of_cube(d) * half * (np.arange(d) != axis), axis=0)]
    return _make(state, corners, rows)._replace(is_wall=np.ones(2 * d, dtype=bool))
