"""How far beyond the collision radius plans have to stay, for what they do not know."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.integrate import solve_ivp

from dynamics import hold
from dynamics.plant import Modelled
from sato.reconfiguration.mission import Reconfiguration

SIGMAS = 5.0  # of what chance adds to the distance of two: beyond it once in 10⁶
RTOL = 1e-11  # of the planning model, integrated: far below what is looked for


def margin(mission: Reconfiguration) -> float:
    """What two agents may come closer than planned until they plan again [m].

        2 max |model − plant| + 5 σ,    both over τ, the time between two plans

    The first is the largest error of the planning model, re-linearised where it is, over τ
    from any start or target, under full control either way; twice, for the errors of two may
    point at each other. It is 0 where the model is what flies. The second
    is of the distance of two:

        σ² = 2 (σ_p² + (σ_v τ)² + (U (σ_u + σ_a) τ²/2)² + (σ_w τ²/2)²)

    with U the largest control and σ_p and σ_v of measured positions and velocities, σ_u and
    σ_a of the size and the direction of thrusts, σ_w of accelerations that disturb.

    Args:
        mission: Complete but for its margin.
    """
    return 2 * _unmodelled(mission) + SIGMAS * _astray(mission)


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


def _unmodelled(mission: Reconfiguration) -> float:
    if isinstance(mission.truth, Modelled):
        return 0.0
    arrivals = np.cumsum([leg.steps for leg in mission.legs]) * mission.step
    beginnings = [(mission.start, 0.0)]
    beginnings += [(leg.targets, float(t)) for leg, t in zip(mission.legs, arrivals, strict=True)]
    return max(_worst(mission, x, t) for x, t in beginnings)


def _worst(mission: Reconfiguration, states: Float[Array, "k n"], t: float) -> float:
    tau = mission.replan_steps * mission.step
    worst = 0.0
    for rows in _lots(states, len(mission.start)):
        for u in _pushes(mission):
            held = np.tile(u, (len(rows), 1))
            flown = mission.truth.fly(rows, held, t, tau)[-1]
            off = (flown - _planned(mission, rows, held, t))[:, : mission.model.axes]
            worst = max(worst, float(np.nanmax(np.linalg.norm(off, axis=1))))
    return worst


def _lots(states: Float[Array, "k n"], agents: int) -> list[Float[Array, "agents n"]]:
    # A plant flies as many vehicles as there are; rows of NaN are none.
    lots = -(-len(states) // agents)
    padded = np.full((lots * agents, states.shape[1]), np.nan)
    padded[: len(states)] = states
    return list(padded.reshape(lots, agents, -1))


def _pushes(mission: Reconfiguration) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    # Of two opposite pushes one adds to the error without any, so nothing worse lies between.
    full = np.full(mission.model.axes, mission.max_control)
    return full, -full


def _planned(
    mission: Reconfiguration, x: Float[Array, "k n"], u: Float[Array, "k d"], t: float
) -> Float[Array, "k n"]:
    if (exact := mission.nonlinear) is None:
        steps = hold(mission.model, mission.step, mission.replan_steps, t)
        held = np.repeat(u[:, None], mission.replan_steps, axis=1)
        return np.asarray(steps.roll(x, held)[:, -1])
    there = np.isfinite(x).all(axis=1)
    begin, push = x[there], u[there]
    found = solve_ivp(
        lambda s, y: exact.rate(s, y.reshape(begin.shape), push).ravel(),
        (t, t + mission.replan_steps * mission.step),
        begin.ravel(),
        "DOP853",
        rtol=RTOL,
        atol=RTOL,
    )
    planned = np.full_like(x, np.nan)
    planned[there] = found.y[:, -1].reshape(begin.shape)
    return planned
