"""Motion by the model that agents plan by, and for how long targets keep their distance in it."""

from functools import lru_cache
from math import ceil

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import ControlSamples, NonlinearModel, StateSamples
from dynamics.trajectory_geometry import control_points
from problems.path_separation import find_meetings
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration

FREE_ORBITS = 2.0  # of free motion that are checked
PIECES_PER_ORBIT = 50  # cubic in time, within 1e-6 of the size of an orbit


@lru_cache(maxsize=16)
def free_motion(mission: Reconfiguration, leg: Leg, arrival: int) -> tuple[int, float]:
    """Return into how many pieces the free motion that is checked is divided, and their length [s].

    It begins at the arrival, the instant at which vehicles take up the targets of the drawn leg.
    It ends where the targets do not keep their distance themselves: after two orbits, or sooner
    where their motion is not bounded. Without an orbit it lasts as long as the leg.
    """
    period = mission.orbital_period
    h = mission.step if period is None else period / PIECES_PER_ORBIT
    count = leg.steps if period is None else ceil(FREE_ORBITS * PIECES_PER_ORBIT)
    paths = drift_freely(mission, leg.targets, count, arrival * mission.step, h)
    radius = mission.largest_separation + mission.margin
    i, j = np.triu_indices(len(paths), 1)
    _, piece = find_meetings(paths, i, j, np.full(len(i), radius))
    return int(piece.min(initial=count)), h


def drift_freely(
    mission: Reconfiguration, x: Float[Array, "*agents n"], count: int, t: float, h: float
) -> Float[Array, "*agents pieces 4 d"]:
    """Return the control points of free motion from states on, by the model that agents plan by.

    So many pieces of h [s] begin at a time t [s].
    """
    d = mission.axes
    states = simulate(mission, x, np.zeros((*x.shape[:-1], count, d)), t, h)
    return np.asarray(control_points(states[..., :d], states[..., d:], h))


def simulate(
    mission: Reconfiguration,
    x: Float[Array, "*agents n"],
    u: Float[Array, "*agents T m"],
    t: float,
    h: float,
) -> StateSamples:
    """Return the states under held controls by the model that the agents plan by.

    The first instant is t [s], and each control is held for a step of h [s].
    """
    if mission.nonlinear_model is not None:
        return simulate_nonlinear(mission.nonlinear_model, x, u, t, h)
    return discretize_zoh(mission.linear_model, h, u.shape[-2], t).simulate(x, u)


def simulate_nonlinear(
    model: NonlinearModel, x: Float[Array, "*agents n"], u: ControlSamples, t: float, h: float
) -> StateSamples:
    """Return the states under held controls, by one step of the classical Runge–Kutta method each.

    In orbit, steps of a fiftieth of a period are off by 1e-6 of what an agent moves.
    """
    states = [x]
    for k in range(u.shape[-2]):
        held, x, s = u[..., k, :], states[-1], t + k * h
        k1 = model.rate(s, x, held)
        k2 = model.rate(s + h / 2, x + h / 2 * k1, held)
        k3 = model.rate(s + h / 2, x + h / 2 * k2, held)
        k4 = model.rate(s + h, x + h * k3, held)
        states.append(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.stack(states, axis=-2)
