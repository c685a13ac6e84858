"""Errors of a wrong model and of noise, and the margins and tolerances that follow from them."""

from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.j2 import J2
from dynamics.plant import NonlinearPlant

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Reconfiguration
    from sato.reconfiguration.orbit import Chief

MARGIN_SIGMAS = 5.0  # of random errors of the distance of two: exceeded once in 10⁶
TOLERANCE_SIGMAS = 6.0  # of random errors on arrival: exceeded once in 10⁷ arrivals
MAX_MODEL_ERROR = 0.1  # of the collision radius: beyond it a model is doubtful


def compute_margin(mission: "Reconfiguration") -> float:
    """Compute by how much two agents may come closer than planned until they plan again [m].

        2 max |model − plant| + 5 σ,    both over τ, the time between two plans

    The first is the largest error of the model that all agents share over τ, under full
    control on all axes, in either direction; twice, for the errors of two may point at each
    other. An agent that linearizes again plans better than this, but the trajectories between
    its samples are those of the shared model. It is 0 where the model is what flies. The
    second is of the distance of two:

        σ² = 2 (σ_p² + (σ_v τ)² + (U (σ_u + σ_a) τ²/2)² + (σ_w τ²/2)²)

    with U the largest control and σ_p and σ_v of measured positions and velocities, σ_u and
    σ_a of the size and the direction of thrusts, σ_w of accelerations that disturb.
    """
    tau = mission.replan_steps * mission.step
    thrust = mission.largest_control.max() * (mission.thrust_error + mission.pointing_error)
    each = [
        mission.position_noise,
        mission.velocity_noise * tau,
        thrust * tau**2 / 2,
        mission.disturbance * tau**2 / 2,
    ]
    spread = float(np.linalg.norm(each) * 2**0.5)
    return 2 * _model_error(mission, mission.replan_steps) + MARGIN_SIGMAS * spread


def _model_error(mission: "Reconfiguration", steps: int) -> float:
    """Compute the largest error of the shared model over some steps [m].

    It is taken from all starts and targets, at nine instants of the mission.
    """
    if mission.flies_model:
        return 0.0
    whole = sum(leg.steps for leg in mission.legs) * mission.step
    states = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
    times = np.linspace(0, whole, 9).tolist()
    return max(_largest_error(mission, states, t, steps) for t in times)


def _largest_error(
    mission: "Reconfiguration", states: Float[Array, "k n"], t: float, steps: int
) -> float:
    largest, d = 0.0, mission.axes
    model = discretize_zoh(mission.linear_model, mission.step, steps, t)
    # A plant flies as many vehicles as there are; rows of NaN are none.
    agents, n = mission.initial_states.shape
    batches = np.full((-(-len(states) // agents), agents, n), np.nan)
    batches.reshape(-1, n)[: len(states)] = states
    for x in batches:
        for u in (mission.largest_control, -mission.largest_control):
            control = np.full((len(x), d), u)
            flown = mission.flown_plant.propagate(x, control, t, steps * mission.step)[-1]
            planned = model.simulate(x, np.repeat(control[:, None], steps, axis=1))[:, -1]
            error = (flown - planned)[:, :d]
            largest = max(largest, float(np.nanmax(np.linalg.norm(error, axis=1))))
    return largest


def model_error_on_arrival(mission: "Reconfiguration") -> tuple[float, float]:
    """Return how far, and how fast, a wrong model leaves an agent from its target [m, m/s].

    Its error is corrected until the last plan, and no further; an acceleration that it leaves
    out gains speed as twice the distance over the time.
    """
    blind = max(1, mission.freeze_steps) + mission.replan_steps - 1
    wrong = _model_error(mission, blind)
    return wrong, 2 * wrong / (blind * mission.step)


def noise_on_arrival(mission: "Reconfiguration") -> tuple[float, float]:
    """Return how far, and how fast, noise leaves an agent from its target [m, m/s].

    An agent that brakes with all its control corrects nothing, and two steps before that are
    the least in which a control sets both position and velocity right; nor does an agent that
    keeps its plan at the end correct anything. The error of its last measurement and later
    disturbances remain, and the thrust errors while it brakes.
    """
    if not mission.has_noise:
        return 0.0, 0.0
    d = mission.axes
    noise = np.repeat([mission.position_noise, mission.velocity_noise], d)
    strongest, weakest = mission.largest_control.max(), mission.least_control
    wrong = strongest * np.hypot(mission.thrust_error, mission.pointing_error)
    steps = min(leg.steps for leg in mission.legs)
    needed = _speed_to_lose(mission, steps) / (weakest * mission.step)
    braking = ceil(min(needed, steps))
    blind = max(braking + 2, mission.freeze_steps) + mission.replan_steps - 1
    thrusting = max(braking, mission.freeze_steps) + mission.replan_steps - 1
    left = discretize_zoh(mission.linear_model, mission.step, blind)
    covariance = np.diag(noise**2)
    for k, (A, B) in enumerate(zip(left.A, left.B, strict=True)):
        thrust = wrong if k >= blind - thrusting else 0.0
        covariance = A @ covariance @ A.T + (mission.disturbance**2 + thrust**2) * B @ B.T
    parts = (covariance[:d, :d], covariance[d:, d:])
    largest = [np.linalg.eigvalsh(part).max() for part in parts]
    position, velocity = TOLERANCE_SIGMAS * np.sqrt(np.maximum(largest, 0.0))
    return float(position), float(velocity)


def _speed_to_lose(mission: "Reconfiguration", steps: int) -> float:
    """Return the most speed that an agent has to lose on arrival [m/s]."""
    from scipy.optimize import linear_sum_assignment

    from problems.auction_cost import compute_transfer_costs
    from problems.transfer import TransferProblem

    d, fastest = mission.axes, float(mission.top_speeds.max())
    if mission.is_point_mass:
        states = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
        fast = 2 * float(np.ptp(states[:, :d], axis=0).max()) / (steps * mission.step)
        return min(fastest, fast)
    # In orbit most of a speed belongs to the trajectory; about half of the fuel brakes.
    burned, start, t = 0.0, mission.initial_states[mission.alive], 0.0
    for leg in mission.legs:
        model = discretize_zoh(mission.linear_model, mission.step, leg.steps, t)
        transfer = TransferProblem(model, mission.largest_control)
        fuel = compute_transfer_costs(transfer, start, leg.targets).cost
        burned = max(burned, float(fuel[linear_sum_assignment(fuel)].max()))
        start, t = leg.targets, t + leg.steps * mission.step
    return min(fastest, burned / 2)


def model_doubts(mission: "Reconfiguration", chief: "Chief") -> list[str]:
    """List doubts about a linear model of relative motion where the swarm flies.

    Compares it with the exact motion under J2: the free flight of all agents that are there
    at the start, until the end of the first leg. A model that is linearized again about each
    agent's own trajectory is exact to first order everywhere, and a model that flies itself
    has no error.
    """
    kind = getattr(mission.model, "kind", "")
    start, steps = mission.initial_states[mission.alive], mission.legs[0].steps
    T = steps * mission.step
    free = np.zeros((len(start), steps, mission.axes))
    modeled = discretize_zoh(mission.linear_model, mission.step, steps).simulate(start, free)[:, -1]
    exact = NonlinearPlant(J2(chief.orbit)).propagate(start, free[:, 0], 0.0, T)[-1]
    error = np.linalg.norm((modeled - exact)[:, :3], axis=1)
    i = int(np.argmax(error))
    if error[i] <= MAX_MODEL_ERROR * mission.least_separation:
        return []
    away = float(np.linalg.norm(start[i, :3]))
    cure = "model.relinearize = true" if kind == "j2" else 'model.kind = "j2"'
    return [
        f"{kind} is wrong by {error[i]:.3g} m after {T:g} s of free flight for agent {i}, "
        f"which starts {away:.4g} m from the chief: more than a tenth of the collision radius of "
        f"{mission.least_separation:g} m; {cure} would do"
    ]
