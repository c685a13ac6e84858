"""How far beyond the collision radius plans have to stay, for what they do not know."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import discretize_zoh
from dynamics.plant import LinearPlant
from sato.reconfiguration.mission import Reconfiguration

SIGMAS = 5.0  # of what chance adds to the distance of two: beyond it once in 10⁶


def margin(mission: Reconfiguration) -> float:
    """What two agents may come closer than planned until they plan again [m].

        2 max |model − plant| + 5 σ,    both over τ, the time between two plans

    The first is the largest error of the model that all agents share over τ, under full
    control on all axes, either way; twice, for the errors of two may point at each other. An
    agent that re-linearises plans better than this, but the paths between its samples are
    those of the shared model. It is 0 where the model is what flies. The second is of the
    distance of two:

        σ² = 2 (σ_p² + (σ_v τ)² + (U (σ_u + σ_a) τ²/2)² + (σ_w τ²/2)²)

    with U the largest control and σ_p and σ_v of measured positions and velocities, σ_u and
    σ_a of the size and the direction of thrusts, σ_w of accelerations that disturb.

    Args:
        mission: Complete but for its margin.
    """
    return 2 * unmodelled(mission, mission.replan_steps) + SIGMAS * _astray(mission)


def _astray(mission: Reconfiguration) -> float:
    tau = mission.replan_steps * mission.step
    thrust = mission.max_control * (mission.thrust_error + mission.pointing_error)
    each = [
        mission.position_noise,
        mission.velocity_noise * tau,
        thrust * tau**2 / 2,
        mission.disturbance * tau**2 / 2,
    ]
    return float(np.linalg.norm(each) * 2**0.5)


def unmodelled(mission: Reconfiguration, steps: int) -> float:
    """Largest error of the shared model over some steps, see `margin` [m].

    It is taken from all starts and targets, at nine instants of the time asked for.
    """
    if isinstance(mission.flown_plant, LinearPlant):
        return 0.0
    whole = sum(leg.steps for leg in mission.legs) * mission.step
    states = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
    return max(_worst(mission, states, t, steps) for t in np.linspace(0, whole, 9).tolist())


def _worst(mission: Reconfiguration, states: Float[Array, "k n"], t: float, steps: int) -> float:
    worst, held = 0.0, discretize_zoh(mission.linear_model, mission.step, steps, t)
    for x in _lots(states, len(mission.initial_states)):
        for u in (mission.max_control, -mission.max_control):
            push = np.full((len(x), mission.linear_model.axes), u)
            flown = mission.flown_plant.propagate(x, push, t, steps * mission.step)[-1]
            planned = held.simulate(x, np.repeat(push[:, None], steps, axis=1))[:, -1]
            off = (flown - planned)[:, : mission.linear_model.axes]
            worst = max(worst, float(np.nanmax(np.linalg.norm(off, axis=1))))
    return worst


def _lots(states: Float[Array, "k n"], agents: int) -> list[Float[Array, "agents n"]]:
    # A plant flies as many vehicles as there are; rows of NaN are none.
    lots = -(-len(states) // agents)
    padded = np.full((lots * agents, states.shape[1]), np.nan)
    padded[: len(states)] = states
    return list(padded.reshape(lots, agents, -1))
