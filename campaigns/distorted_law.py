"""Robustness of the control law of formations to distorted commands.

What a vehicle does may be what the law asks of it scaled by any positive factor and turned by
less than 90°, other ones for each vehicle and every second: the formation still forms
[Lusk2020, Sec. III-C].
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from problems.alignment import compute_shape_error
from problems.desired_formation import DesiredFormation
from problems.gain_design import GainMatrix, design_gains
from sato.formation.control_law import FormationData, compute_velocity_commands
from sato.formation.sensing import NeighborLocations, as_complex
from sato.formation.settings import ControlLaw
from sato.shapes.formation_library import random_sparse_graph
from sato.shapes.random_points import sample_formation

SCALE_RANGE = (0.1, 10.0)  # by which commands are scaled
DISTORTION_PERIOD = 1.0  # for which factors and turns stay [s]
SHAPE_TOLERANCE = 1e-3  # error of the shape [m]
MAX_TIME = 600.0  # [s]


class RobustnessResult(NamedTuple):
    """Outcome of a case."""

    time: float  # until the shape was formed [s]
    error: float  # of the shape in the end [m]
    is_inverted: bool


def form(rng: np.random.Generator, turn_deg: float) -> dict[str, Any]:
    """Follow the law from a random start to a random formation, commands scaled and turned."""
    found = simulate_distorted(*draw_case(rng), rng, worst=np.deg2rad(turn_deg))
    is_formed = found.error <= SHAPE_TOLERANCE and not found.is_inverted
    return {"formed": is_formed, "time_s": found.time, "shape_error_m": found.error}


def commands(
    position: Float[Array, "n 3"], gains: GainMatrix, law: ControlLaw, legacy: bool = False
) -> Float[Array, "n 3"]:
    """Compute the velocity command of every agent [m/s]."""
    formation, me = FormationData.from_gains(gains), np.arange(len(position))
    relative = position[formation.neighbors] - position[:, None]
    flat, rise, is_known = as_complex(relative), relative[..., 2], formation.neighbors >= 0
    seen = NeighborLocations(flat, rise, is_known)
    return compute_velocity_commands(me, seen, formation, law, legacy)


def draw_case(rng: np.random.Generator) -> tuple[GainMatrix, Float[Array, "n 3"]]:
    """Draw gains and initial positions."""
    n = int(rng.integers(6, 13))
    points = sample_formation(n, (8.0, 8.0, 3.0), 1.5, rng)
    least = 4 / (n - 1)  # of the ring that every sparse graph has
    share = 1.0 if rng.random() < 0.3 else rng.uniform(least, 1)
    shape = DesiredFormation(points, random_sparse_graph(points, share, rng))
    return design_gains(shape), rng.uniform(0, 10, (n, 3))


def draw_distortions(count: int, worst: float, rng: np.random.Generator) -> Float[Array, "n 3 3"]:
    """Draw a factor and a rotation about any axis by up to `worst` [rad] for every agent."""
    axis = rng.standard_normal((count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    turn = Rotation.from_rotvec(axis * rng.uniform(0, worst, (count, 1))).as_matrix()
    low, high = np.log(SCALE_RANGE).tolist()
    factor = np.exp(rng.uniform(low, high, count))
    return np.asarray(factor[:, None, None] * turn)


def simulate_distorted(
    gains: GainMatrix,
    start: Float[Array, "n 3"],
    rng: np.random.Generator,
    law: ControlLaw | None = None,
    worst: float = np.pi / 2,
) -> RobustnessResult:
    """Follow the distorted law until the shape is formed."""
    law = law or ControlLaw()
    position, time = start, 0.0
    found = compute_shape_error(position, gains.formation.points)
    while found.error > SHAPE_TOLERANCE and time < MAX_TIME:
        way = draw_distortions(len(start), worst, rng)

        def rate(_: float, q: Array, way: Array = way) -> Array:
            return np.asarray((way @ commands(q.reshape(-1, 3), gains, law)[..., None]).ravel())

        flown = solve_ivp(rate, (0, DISTORTION_PERIOD), position.ravel(), rtol=1e-6, atol=1e-8)
        position, time = flown.y[:, -1].reshape(-1, 3), time + DISTORTION_PERIOD
        found = compute_shape_error(position, gains.formation.points)
    return RobustnessResult(time, found.error, found.inverted)
