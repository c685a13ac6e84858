"""Surroundings: all that does not decide, but can be hit, and which agent knows of it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import ObstaclePaths, pad_corners
from sato.reconfiguration.mission import Reconfiguration

ESCAPE_FACTOR = 2.0  # of the way out of what moves, for others that are in it
WALL_FACTOR = 100.0  # size of the walls about the allowed positions, over that of these


class Surroundings(NamedTuple):
    """Obstacles, walls about the allowed positions, and vehicles that were lost.

    Obstacles move at constant velocity, walls are at rest, and lost vehicles fly without control.
    """

    state: Float[Array, "bodies n"]  # of a point of each, now
    corners: Float[Array, "bodies corners d"]  # from that point [m]
    thickness: Float[Array, " bodies"]  # beyond the hull of the corners [m]
    is_wall: Bool[Array, " bodies"]
    vehicle: Int[Array, " bodies"]  # number of the lost vehicle; −1 for all others
    is_known: Bool[Array, "agents bodies"]

    def after(self, mission: Reconfiguration, x: Float[Array, "agents n"]) -> "Surroundings":
        """Return the same after a step, in which lost vehicles have moved to their states in x."""
        d, state = mission.axes, self.state.copy()
        state[:, :d] += mission.step * state[:, d:]
        is_lost = self.vehicle >= 0
        state[is_lost] = x[self.vehicle[is_lost]]
        return self._replace(state=state)

    def seen_from(self, mission: Reconfiguration, x: Float[Array, "agents n"]) -> "Surroundings":
        """Return the same, with what agents see within their sensing radius."""
        if self.is_known.all():
            return self
        from dynamics.bezier_kernels import body_distances  # compiles, so it is imported late

        d = mission.axes
        away = x[:, None, :d] - self.state[:, :d]
        body = np.tile(np.arange(len(self.state)), len(x))
        gap, _ = body_distances(away.reshape(-1, 1, d), np.ascontiguousarray(self.corners), body)
        is_seen = gap.reshape(away.shape[:2]) - self.thickness <= mission.sight
        return self._replace(is_known=self.is_known | is_seen)

    def with_lost(self, lost: list[int], x: Float[Array, "agents n"]) -> "Surroundings":
        """Return the same with vehicles that were lost, which nobody has seen yet."""
        corners, count = np.zeros((len(lost), *self.corners.shape[1:])), len(lost)
        return Surroundings(
            np.concatenate([self.state, x[lost]]),
            np.concatenate([self.corners, corners]),
            np.append(self.thickness, np.zeros(count)),
            np.append(self.is_wall, np.zeros(count, dtype=bool)),
            np.append(self.vehicle, np.array(lost, dtype=int)),
            np.hstack([self.is_known, np.zeros((len(self.is_known), count), dtype=bool)]),
        )

    def fly(self, mission: Reconfiguration, horizon: AvoidanceHorizon) -> ObstaclePaths | None:
        """Return the motion of all over a horizon that begins now; without clearances."""
        if not len(self.state):
            return None
        d, pieces = mission.axes, len(horizon.fine_model)
        time = (np.arange(pieces)[:, None] + np.linspace(0.0, 1.0, 4)) * horizon.fine_model.dt
        place, velocity = self.state[:, :d], self.state[:, d:]
        paths = place[:, None, None] + time[..., None] * velocity[:, None, None]
        adrift = (self.vehicle >= 0) & (not mission.is_point_mass)
        if adrift.any():
            u = np.zeros((int(adrift.sum()), horizon.steps, d))
            x = horizon.discrete_model.simulate(self.state[adrift], u)
            paths[adrift] = horizon.control_points(x, u)
        return ObstaclePaths(paths, self.corners, np.zeros(len(paths)), velocity)

    def known_to(
        self, mission: Reconfiguration, agent: int, paths: ObstaclePaths | None, clearance: float
    ) -> ObstaclePaths | None:
        """Return those that an agent knows, with the distances that it keeps.

        Args:
            mission: Radii of the vehicles.
            agent: Number of the agent.
            paths: Motion of all over a horizon.
            clearance: Clearance of the horizon [m].
        """
        rows = np.flatnonzero(self.is_known[agent]) if paths is not None else []
        if paths is None or not len(rows):
            return None
        own = float(mission.own_clearances(clearance, np.array([agent]))[0])
        keeps = own + self.thickness
        keeps[self.is_wall] -= mission.radii[agent]
        is_lost = self.vehicle >= 0
        keeps[is_lost] = (own + mission.own_clearances(clearance, self.vehicle[is_lost])) / 2
        return paths._replace(clearance=keeps).select(rows)


def find_surroundings(mission: Reconfiguration) -> Surroundings:
    """Return the surroundings at the start of a drawn mission."""
    d, count = mission.axes, len(mission.initial_states)
    walls = _build_walls(mission)
    obstacles = mission.obstacles
    places = [np.concatenate([one.place, one.drift]) for one in obstacles]
    places += [np.concatenate([place, np.zeros(d)]) for place, _ in walls]
    corners = [one.corners for one in obstacles] + [own for _, own in walls]
    is_wall = np.arange(len(places)) >= len(obstacles)
    thickness = [one.thickness for one in obstacles] + [_wall_distance(mission)] * len(walls)
    known = np.array([one.known for one in obstacles] + [True] * len(walls), dtype=bool)
    return Surroundings(
        np.array(places).reshape(-1, 2 * d),
        pad_corners(corners) if corners else np.zeros((0, 1, d)),
        np.array(thickness, dtype=float),
        is_wall,
        np.full(len(places), -1),
        np.tile(known, (count, 1)),
    )


def count_escape_steps(mission: Reconfiguration, around: Surroundings | None) -> int:
    """Count the steps in which vehicles get out of the way of what moves; 0 where nothing does.

    From rest, twice as far as the largest is wide at the least control, decisions included. What
    vehicles commit to is clear of all that moves for so long after they have come to rest.
    """
    d = mission.axes
    if around is None or not around.state[:, d:].any():
        return 0
    moves = around.state[:, d:].any(axis=1)
    size = np.linalg.norm(around.corners[moves], axis=2).max() + around.thickness[moves].max()
    way = ESCAPE_FACTOR * 2 * (size + mission.largest_separation)
    U, V = mission.least_braking, float(mission.top_speeds.min())
    time = 2 * (way / U) ** 0.5 if way < V**2 / U else way / V + V / U
    return 2 * mission.replan_steps + int(np.ceil(time / mission.step))


def _wall_distance(mission: Reconfiguration) -> float:
    return mission.largest_separation


def _build_walls(
    mission: Reconfiguration,
) -> list[tuple[Float[Array, " d"], Float[Array, "corners d"]]]:
    """Build flat walls as far outside of the allowed positions as vehicles keep from them."""
    if mission.box is None:
        return []
    low, high = (np.array(side) for side in mission.box)
    middle, half = (low + high) / 2, WALL_FACTOR * (high - low)
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * len(low), indexing="ij"), axis=-1)
    walls = []
    for axis in range(len(low)):
        corners = np.unique(signs.reshape(-1, len(low)) * half * (np.arange(len(low)) != axis), axis=0)
        for edge, way in ((low, -1.0), (high, 1.0)):
            place = middle.copy()
            place[axis] = edge[axis] + way * _wall_distance(mission)
            walls.append((place, corners))
    return walls
