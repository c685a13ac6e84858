"""Whether a model holds where a swarm flies."""

import numpy as np

from dynamics import discretize_zoh
from dynamics.j2 import J2
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant
from sato.reconfiguration.mission import Reconfiguration

PART = 0.1  # of the collision radius: the error from which on a model is no longer good


class BeyondValidity(UserWarning):
    """A model is used where it is wrong by more than avoidance can ignore."""


def doubt(mission: Reconfiguration, orbit: Orbit, kind: str) -> BeyondValidity | None:
    """What is to be said against a linear model of relative motion, if anything.

    Compares it with the exact motion under J2: the free flight of all who are there at the
    start, until the end of the first leg. A model that is re-linearised about each agent's
    own path is exact to first order everywhere, and a model that flies itself is what it is.

    Args:
        mission: What is to be flown.
        orbit: The chief's.
        kind: Of the model, as a scenario calls it.
    """
    if mission.nonlinear_model is not None or isinstance(mission.flown_plant, LinearPlant):
        return None
    start, steps = mission.initial_states[mission.alive], mission.legs[0].steps
    T = steps * mission.step
    free = np.zeros((len(start), steps, mission.linear_model.axes))
    told = discretize_zoh(mission.linear_model, mission.step, steps).simulate(start, free)[:, -1]
    exact = J2(orbit).propagate(start, np.array([T]))[-1]
    error = np.linalg.norm((told - exact)[:, :3], axis=1)
    i = int(np.argmax(error))
    if error[i] <= PART * mission.collision_radius:
        return None
    away = float(np.linalg.norm(start[i, :3]))
    agent = int(np.flatnonzero(mission.alive)[i])
    cure = "model.relinearise = true" if kind == "j2" else 'model.kind = "j2"'
    return BeyondValidity(
        f"{kind} is wrong by {error[i]:.3g} m after {T:g} s of free flight for agent {agent}, "
        f"which starts {away:.4g} m from the chief: more than a tenth of the collision radius of "
        f"{mission.collision_radius:g} m; {cure} would do"
    )
