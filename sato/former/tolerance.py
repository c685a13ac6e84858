"""What counts as there, where it is not said."""

from math import ceil, isfinite

import numpy as np
from scipy.optimize import linear_sum_assignment

from dynamics import DoubleIntegrator, discretize_zoh
from problems.auction_cost import compute_transfer_costs
from sato.reconfiguration.mission import Reconfiguration
from sato.former.margin import unmodelled
from sato.former.tables import Plan

TOLERANCE = 1e-6  # of the least spacing of the targets: what counts as there
SIGMAS = 6.0  # of what chance adds to it: an agent is further out once in 10⁷ arrivals


def tolerances(mission: Reconfiguration, plan: Plan) -> tuple[float, float, float | None]:
    """In position [m] and velocity [m/s], and ε where the targets say nothing of it."""
    # A single target has no spacing; the least distance that there may be will do.
    alone = not isfinite(mission.target_spacing)
    s = mission.collision_radius if alone else mission.target_spacing
    astray, drifting = _missed(mission)
    wrong, sliding = _misled(mission) if plan.position_tolerance_m is None else (0.0, 0.0)
    near = plan.position_tolerance_m or TOLERANCE * s + astray + wrong
    slow = plan.velocity_tolerance_m_s or (
        (plan.position_tolerance_m or TOLERANCE * s) / mission.step + drifting + sliding
    )
    return near, slow, mission.tie_break * s**2 / 2 or None if alone else None


def _misled(mission: Reconfiguration) -> tuple[float, float]:
    """How far a wrong model leaves an agent from its target [m], and how fast [m/s].

    What it gets wrong is mended until the last plan, and no further; an acceleration that it
    leaves out gains speed as twice the way over the time.
    """
    blind = max(1, mission.freeze_steps) + mission.replan_steps - 1
    wrong = unmodelled(mission, blind)
    return wrong, 2 * wrong / (blind * mission.step)


def _missed(mission: Reconfiguration) -> tuple[float, float]:
    """How far chance leaves an agent from its target [m], and how fast [m/s].

    An agent that brakes with all it has mends nothing, and two steps before that are the
    least in which a control sets both place and speed right; nor does one mend anything that
    keeps to its plan at the end. What it believed wrongly when it planned last, and the
    pushes since, remain, and what its thrusters did otherwise while it braked.
    """
    d = mission.linear_model.axes
    noise = np.repeat([mission.position_noise, mission.velocity_noise], d)
    wrong = mission.max_control * np.hypot(mission.thrust_error, mission.pointing_error)
    if not noise.any() and not mission.disturbance and not wrong:
        return 0.0, 0.0
    steps = min(leg.steps for leg in mission.legs)
    braking = ceil(min(_braked(mission, steps) / (mission.max_control * mission.step), steps))
    blind = max(braking + 2, mission.freeze_steps) + mission.replan_steps - 1
    thrusting = max(braking, mission.freeze_steps) + mission.replan_steps - 1
    left = discretize_zoh(mission.linear_model, mission.step, blind)
    spread = np.diag(noise**2)
    for k, (A, B) in enumerate(zip(left.A, left.B, strict=True)):
        thrust = wrong if k >= blind - thrusting else 0.0
        spread = A @ spread @ A.T + (mission.disturbance**2 + thrust**2) * B @ B.T
    worst = [np.linalg.eigvalsh(part).max() for part in (spread[:d, :d], spread[d:, d:])]
    place, speed = SIGMAS * np.sqrt(np.maximum(worst, 0.0))
    return float(place), float(speed)


def _braked(mission: Reconfiguration, steps: int) -> float:
    """The most speed that an agent has to lose on arrival [m/s]."""
    d = mission.linear_model.axes
    if isinstance(mission.linear_model, DoubleIntegrator):
        places = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])[
            :, :d
        ]
        fast = 2 * float(np.ptp(places, axis=0).max()) / (steps * mission.step)
        return min(mission.max_speed, fast)
    # In orbit most of a speed belongs to the path; what is braked is about half of what is burnt.
    burnt, start, t = 0.0, mission.initial_states[mission.alive], 0.0
    for leg in mission.legs:
        held = discretize_zoh(mission.linear_model, mission.step, leg.steps, t)
        fuel = compute_transfer_costs(held, start, leg.targets, mission.max_control).fuel
        burnt = max(burnt, float(fuel[linear_sum_assignment(fuel)].max()))
        start, t = leg.targets, t + leg.steps * mission.step
    return min(mission.max_speed, burnt / 2)
