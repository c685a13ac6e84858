"""Clearance of vehicles from obstacles, and from the bounds of the allowed positions."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import control_points, evaluate_bezier
from sato.obstacles import Obstacle
from sato.reconfiguration.check.recorded import ReconfigurationRecord

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


def find_excess(record: ReconfigurationRecord) -> tuple[float, int]:
    """Find by how much a live vehicle leaves the allowed positions at most, and which [m].

    Along an axis a cubic piece is extreme at its ends, or where its derivative is zero.
    """
    if record.mission.box is None:
        return 0.0, -1
    d, (low, high) = record.axes, np.asarray(record.mission.box)
    x = np.moveaxis(record.pieces.state, 0, 1)
    b = np.moveaxis(control_points(x[..., :d], x[..., d:], record.pieces.duration), 2, 0)
    p, q, r = b[1] - b[0], b[2] - b[1], b[3] - b[2]
    curve, slope = p - 2 * q + r, q - p
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(slope**2 - curve * p)
        times = np.stack([p / (-slope + s * root) for s in (1, -1)])
        times = np.append(times, (p / (2 * (p - q)))[None], axis=0)
    times = np.clip(np.nan_to_num(times, nan=0.0, posinf=0.0, neginf=0.0), 0.0, 1.0)
    s = 1 - times
    inner = s**3 * b[0] + 3 * s**2 * times * b[1] + 3 * s * times**2 * b[2] + times**3 * b[3]
    values = np.concatenate([inner, b[[0, 3]]])
    is_there = record.pieces.alive[:-1].T & np.isfinite(values).all(axis=(0, 3))
    excess = np.maximum(low - values, values - high).max(axis=(0, 3))
    excess = np.where(is_there, excess, -np.inf).max(axis=1)
    return float(excess.max()), int(excess.argmax())


def _approach(record: ReconfigurationRecord, number: int) -> Clearance:
    d, h, mission = record.axes, record.pieces.duration, record.mission
    obstacle, x = mission.obstacles[number], np.moveaxis(record.pieces.state, 0, 1)
    if mission.separation_scale is not None:
        obstacle = obstacle.scaled(mission.separation_scale)
    paths = control_points(x[..., :d], x[..., d:], h)
    paths = np.moveaxis(mission.scale_separations(paths), 0, 1)
    is_there = record.pieces.alive[:-1] & np.isfinite(paths).all(axis=(2, 3))
    k, i = np.nonzero(is_there)
    thirds = h * (k[:, None] + np.linspace(0.0, 1.0, 4))
    pieces = paths[k, i] - thirds[..., None] * obstacle.drift
    time, width, radius = h * k, h, record.mission.radii[i]
    best = Clearance(np.inf, np.inf, -1, number, 0.0)
    while len(pieces):
        middle = evaluate_bezier(pieces, np.full(len(pieces), 0.5))
        distance, lower = _bound(obstacle, pieces, middle)
        room = distance - radius
        q = int(room.argmin())
        if room[q] < best.room:
            own = float(room[q]), float(distance[q]), int(i[q])
            best = Clearance(*own, number, float(time[q] + width / 2))
        left = lower - radius < best.room - PRECISION * record.mission.least_separation
        pieces, width = _halve(pieces[left]), width / 2
        time, i, radius = (
            np.append(time[left], time[left] + width),
            np.tile(i[left], 2),
            np.tile(radius[left], 2),
        )
    return best


def _bound(
    obstacle: Obstacle, pieces: Float[Array, "k 4 d"], middle: Float[Array, "k d"]
) -> tuple[Float[Array, " k"], Float[Array, " k"]]:
    """Return the distance of the middles of pieces, and a lower bound of that of the pieces."""
    nearest = obstacle.nearest(middle)
    offset = middle - nearest
    distance = np.linalg.norm(offset, axis=1)
    unit = offset / np.maximum(distance, 1e-300)[:, None]
    beyond = np.einsum("kd,kcd->kc", unit, pieces - nearest[:, None]).min(axis=1)
    return distance, np.where(distance > 0, np.maximum(beyond, 0.0), 0.0)


def _halve(pieces: Float[Array, "k 4 d"]) -> Float[Array, "_ 4 d"]:
    """Return the first halves of pieces, and then the second ones (de Casteljau)."""
    a, b, c, e = np.moveaxis(pieces, 1, 0)
    ab, bc, ce = (a + b) / 2, (b + c) / 2, (c + e) / 2
    abc, bce = (ab + bc) / 2, (bc + ce) / 2
    middle = (abc + bce) / 2
    first = np.stack([a, ab, abc, middle], axis=1)
    return np.concatenate([first, np.stack([middle, bce, ce, e], axis=1)])
