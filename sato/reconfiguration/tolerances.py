"""Margins, tolerances and the bid increment of a mission, where they follow from the rest."""

from dataclasses import replace
from math import ceil, isfinite
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.double_integrator import DoubleIntegrator
from dynamics.plant import LinearPlant
from sato.scenario.definition import is_auto
from sato.scenario.errors import InputError

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Reconfiguration

MARGIN_SIGMAS = 5.0  # of random errors of the distance of two: exceeded once in 10⁶
TOLERANCE_SIGMAS = 6.0  # of random errors on arrival: exceeded once in 10⁷ arrivals
ARRIVAL_TOLERANCE = 1e-6  # of the least spacing of the targets


def resolve(mission: "Reconfiguration") -> "Reconfiguration":
    """Return a drawn mission with its margin, tolerances and bid increment as numbers.

    Raises:
        InputError: The margin leaves no room between the targets.
    """
    position, velocity = _tolerances(mission)
    increment = mission.epsilon
    if is_auto(increment) and not isfinite(mission.target_spacing):
        # Single targets have no spacing; the collision radius stands for it.
        increment = mission.tie_break * mission.collision_radius**2 / 2 or increment
    return replace(
        mission,
        position_tolerance=position,
        velocity_tolerance=velocity,
        epsilon=increment,
        margin=_checked_margin(mission),
    )


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
    return 2 * _model_error(mission, mission.replan_steps) + MARGIN_SIGMAS * _spread(mission)


def _checked_margin(mission: "Reconfiguration") -> float:
    # Where it is not given, a margin is computed wherever the shared model may have errors.
    has_errors = mission.chief is not None or mission.nonlinear_model is not None
    is_computed = is_auto(mission.margin) if mission.margin is not None else has_errors
    margin = compute_margin(mission) if is_computed else mission.margin or 0.0
    room = mission.target_spacing - mission.collision_radius
    if margin > room * (1 + 1e-9):
        verb = "auto gives" if is_computed else "takes"
        raise InputError(
            "plan.margin_m",
            f"{verb} {margin:.4g} m beyond the collision radius of "
            f"{mission.collision_radius:g} m, and targets are {mission.target_spacing:.4g} m "
            f"apart; a shape with {mission.collision_radius + margin:.4g} m, less noise, or "
            f"margin_m = {room:.3g} would do",
        )
    return margin


def _spread(mission: "Reconfiguration") -> float:
    tau = mission.replan_steps * mission.step
    thrust = mission.max_control * (mission.thrust_error + mission.pointing_error)
    each = [
        mission.position_noise,
        mission.velocity_noise * tau,
        thrust * tau**2 / 2,
        mission.disturbance * tau**2 / 2,
    ]
    return float(np.linalg.norm(each) * 2**0.5)


def _model_error(mission: "Reconfiguration", steps: int) -> float:
    """Compute the largest error of the shared model over some steps [m].

    It is taken from all starts and targets, at nine instants of the mission.
    """
    if isinstance(mission.flown_plant, LinearPlant):
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
    for x in _batches(states, len(mission.initial_states)):
        for u in (mission.max_control, -mission.max_control):
            control = np.full((len(x), d), u)
            flown = mission.flown_plant.propagate(x, control, t, steps * mission.step)[-1]
            planned = model.simulate(x, np.repeat(control[:, None], steps, axis=1))[:, -1]
            error = (flown - planned)[:, :d]
            largest = max(largest, float(np.nanmax(np.linalg.norm(error, axis=1))))
    return largest


def _batches(states: Float[Array, "k n"], agents: int) -> list[Float[Array, "agents n"]]:
    # A plant flies as many vehicles as there are; rows of NaN are none.
    count = -(-len(states) // agents)
    padded = np.full((count * agents, states.shape[1]), np.nan)
    padded[: len(states)] = states
    return list(padded.reshape(count, agents, -1))


def _tolerances(mission: "Reconfiguration") -> tuple[float, float]:
    """Return the position [m] and velocity [m/s] within which a target counts as reached."""
    # A single target has no spacing; the least distance that there may be will do.
    spacing = mission.target_spacing
    s = spacing if isfinite(spacing) else mission.collision_radius
    random_position, random_velocity = _random_error(mission)
    given_position, given_velocity = mission.position_tolerance, mission.velocity_tolerance
    wrong, drifting = _model_error_on_arrival(mission) if given_position is None else (0.0, 0.0)
    position = given_position or ARRIVAL_TOLERANCE * s + random_position + wrong
    velocity = given_velocity or (
        (given_position or ARRIVAL_TOLERANCE * s) / mission.step + random_velocity + drifting
    )
    return position, velocity


def _model_error_on_arrival(mission: "Reconfiguration") -> tuple[float, float]:
    """Return how far, and how fast, a wrong model leaves an agent from its target [m, m/s].

    Its error is corrected until the last plan, and no further; an acceleration that it leaves
    out gains speed as twice the distance over the time.
    """
    blind = max(1, mission.freeze_steps) + mission.replan_steps - 1
    wrong = _model_error(mission, blind)
    return wrong, 2 * wrong / (blind * mission.step)


def _random_error(mission: "Reconfiguration") -> tuple[float, float]:
    """Return how far, and how fast, noise leaves an agent from its target [m, m/s].

    An agent that brakes with all its control corrects nothing, and two steps before that are
    the least in which a control sets both position and velocity right; nor does an agent that
    keeps its plan at the end correct anything. The error of its last measurement and later
    disturbances remain, and the thrust errors while it brakes.
    """
    d = mission.axes
    noise = np.repeat([mission.position_noise, mission.velocity_noise], d)
    wrong = mission.max_control * np.hypot(mission.thrust_error, mission.pointing_error)
    if not noise.any() and not mission.disturbance and not wrong:
        return 0.0, 0.0
    steps = min(leg.steps for leg in mission.legs)
    braking = ceil(
        min(_speed_to_lose(mission, steps) / (mission.max_control * mission.step), steps)
    )
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

    d = mission.axes
    if isinstance(mission.linear_model, DoubleIntegrator):
        states = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
        fast = 2 * float(np.ptp(states[:, :d], axis=0).max()) / (steps * mission.step)
        return min(mission.max_speed, fast)
    # In orbit most of a speed belongs to the trajectory; about half of the fuel brakes.
    burned, start, t = 0.0, mission.initial_states[mission.alive], 0.0
    for leg in mission.legs:
        model = discretize_zoh(mission.linear_model, mission.step, leg.steps, t)
        transfer = TransferProblem(model, mission.max_control)
        fuel = compute_transfer_costs(transfer, start, leg.targets).fuel
        burned = max(burned, float(fuel[linear_sum_assignment(fuel)].max()))
        start, t = leg.targets, t + leg.steps * mission.step
    return min(mission.max_speed, burned / 2)
