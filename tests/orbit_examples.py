"""Orbits, inertial states and free motion for the tests of `dynamics`."""

import numpy as np

from dynamics.coordinate_frames import inertial_state
from dynamics.discretize import discretize_zoh
from dynamics.j2 import J2
from dynamics.orbit import EARTH_MU, Orbit
from dynamics.plant import NonlinearPlant


def inertial_states(a, e=0.0, i=0.0, raan=0.0, arg_perigee=0.0, true_anomaly=0.0):
    """Return the inertial states of classical elements, of one orbit or of many."""
    p = a * (1 - e**2)
    r, h = p / (1 + e * np.cos(true_anomaly)), np.sqrt(EARTH_MU * p)
    v_x = EARTH_MU / h * e * np.sin(true_anomaly)
    chief = np.broadcast_arrays(r, v_x, h, raan, i, arg_perigee + true_anomaly)
    return inertial_state(np.stack(chief, axis=-1).astype(float))


def semi_major_axis(state):
    """Return the semi-major axes of inertial states, by the vis-viva equation."""
    r, v = np.linalg.norm(state[..., :3], axis=-1), np.linalg.norm(state[..., 3:], axis=-1)
    return 1 / (2 / r - v**2 / EARTH_MU)


def random_orbit(rng):
    e = rng.uniform(0, 0.3)
    perigee = rng.uniform(6.7e6, 9e6)
    return Orbit.from_elements(perigee / (1 - e), e, *rng.uniform(0, np.pi, 4))


def transition_matrix(model, end, start=0.0):
    """Return Φ(end, start), free motion of a linear model."""
    return discretize_zoh(model, end - start, 1, start).A[0]


def propagate_relative(orbit, x, times):
    """Return the free motion under J2 relative to a chief, at increasing times."""
    path, t, still = [], 0.0, np.zeros((len(x), 3))
    for end in times:
        if end > t:
            x, t = NonlinearPlant(J2(orbit)).propagate(x, still, t, end - t)[-1], end
        path.append(x)
    return np.array(path)
