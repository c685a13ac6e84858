"""Clearance of vehicles from obstacles, and from the bounds of the allowed positions."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.trajectory_geometry import control_points, evaluate_bezier
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.check.subdivision import minimize_along

PRECISION = 1e-9  # of the distances, over the least radius


class Clearance(NamedTuple):
    """Nearest approach of a live vehicle to an obstacle."""

    room: float  # distance from its surface, less the radius that the vehicle keeps [m]
    distance: float  # [m]
    agent: int
    obstacle: int
    time: float  # [s]


def find_clearance(record: ReconfigurationRecord) -> Clearance | None:
    """Find the nearest approach to any obstacle, relative to the radii; None without obstacles.

    Along the cubic pieces of the trajectories, by subdivision: an obstacle lies behind the plane
    across the way from its nearest point, and a piece beyond it by the nearest of its control
    points at least.
    """
    found = [_approach(record, number) for number in range(len(record.mission.obstacles))]
    return min(found, default=None)


def find_excess(record: ReconfigurationRecord) -> tuple[float, int, float]:
    """Find by how much a live vehicle leaves the allowed positions at most [m], which and when."""
    if record.mission.box is None:
        return 0.0, -1, 0.0
    low, high = np.asarray(record.mission.box)
    pieces, k, agent = _live_pieces(record)

    def measure(parts: Array, _: Array) -> tuple[Array, Array]:
        points = np.concatenate([evaluate_bezier(parts, 0.5)[:, None], parts], axis=1)
        room = np.minimum(points - low, high - points).min(axis=2)
        return room[:, 0], room.min(axis=1)

    precision = PRECISION * record.mission.least_separation
    room, number, fraction = minimize_along(pieces, measure, precision)
    if number < 0:
        return -room, -1, 0.0
    return -room, int(agent[number]), record.pieces.duration * (float(k[number]) + fraction)


def _live_pieces(
    record: ReconfigurationRecord,
) -> tuple[Float[Array, "pieces 4 d"], Int[Array, " pieces"], Int[Array, " pieces"]]:
    """Return the control points of the pieces of live vehicles, their numbers and agents."""
    d, x = record.mission.axes, np.moveaxis(record.pieces.state, 0, 1)
    points = control_points(x[..., :d], x[..., d:], record.pieces.duration).swapaxes(0, 1)
    k, i = np.nonzero(record.pieces.alive[:-1] & np.isfinite(points).all(axis=(2, 3)))
    return points[k, i], k, i


def _approach(record: ReconfigurationRecord, number: int) -> Clearance:
    mission, h = record.mission, record.pieces.duration
    obstacle, (pieces, k, i) = mission.obstacles[number], _live_pieces(record)
    if mission.separation_scale is not None:
        obstacle = obstacle.scaled(mission.separation_scale)
    thirds, radius = h * (k[:, None] + np.linspace(0.0, 1.0, 4)), mission.radii[i]

    def measure(parts: Array, of: Array) -> tuple[Array, Array]:
        middle = evaluate_bezier(parts, 0.5)
        nearest = obstacle.nearest(middle)
        distance = np.linalg.norm(middle - nearest, axis=1)
        unit = (middle - nearest) / np.maximum(distance, 1e-300)[:, None]
        beyond = np.einsum("kd,kcd->kc", unit, parts - nearest[:, None]).min(axis=1)
        return distance - radius[of], np.maximum(beyond, 0.0) - radius[of]

    moved = mission.scale_separations(pieces) - thirds[..., None] * obstacle.drift
    precision = PRECISION * mission.least_separation
    room, best, fraction = minimize_along(moved, measure, precision)
    if best < 0:
        return Clearance(np.inf, np.inf, -1, number, 0.0)
    distance, time = room + float(radius[best]), h * (float(k[best]) + fraction)
    return Clearance(room, distance, int(i[best]), number, time)
