"""Errors of a wrong model and of noise, and the margins and tolerances that follow from them."""

from collections.abc import Iterator
from math import ceil, sqrt

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from dynamics.discretize import DiscreteModel, linearize_along
from dynamics.j2 import J2
from dynamics.plant import NonlinearPlant
from problems.auction_cost import compute_energies, compute_transfer_costs
from problems.transfer import Trajectory, TransferProblem
from sato.reconfiguration.estimator import (
    GATE_SIGMAS,
    correct,
    measurement_covariance,
    model_acceleration,
    spread,
)
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.orbit import Chief
from sato.reconfiguration.own_motion import is_own_plant
from sato.reconfiguration.solo_trajectories import solve_solo_transfers
from sato.reconfiguration.tracking import MAX_RESERVE, largest_disturbance

MARGIN_SIGMAS = 5.0  # of random errors of the distance of two: exceeded once in 10⁶
TOLERANCE_SIGMAS = 6.0  # of random errors on arrival: exceeded once in 10⁷ arrivals
LONG_FLIGHT = 1000  # steps, by which random errors no longer grow
CONTROL_ROOM = 0.1  # of the limit, without which a control is no correction
MAX_MODEL_ERROR = 0.1  # of the collision radius: beyond it a model is doubtful


def compute_margin(mission: Reconfiguration) -> float:
    """Compute by how much two agents may come closer than planned until they plan again [m].

        2 max |model − plant| + max min(5 √2 c, (2 g + 5 √2) s) + V × skew
                                 k

    The first is the largest error of the model that all agents share over the time between two
    plans, under full control on all axes, in either direction; twice, for the errors of two may
    point at each other. An agent that linearizes again plans better than this, but the
    trajectories between its samples are those of the shared model. It is 0 where the model is
    what flies. The second is of random errors, and the third of clocks that differ.
    """
    period, whole = mission.replan_steps, sum(leg.steps for leg in mission.legs)
    margin = 2 * model_error(mission, period) + compute_random_margin(mission, period, whole)
    return margin + mission.skew_margin(margin)


def compute_random_margin(mission: Reconfiguration, period: int, whole: int = LONG_FLIGHT) -> float:
    """Compute by how much random errors may bring two agents closer than planned [m].

    An agent measures at instant k; s is the standard deviation of its position a replanning
    period later in the direction in which it is largest, by all its measurements, and c by the
    first of them alone, both under full control. The agent flies by a reference that its estimate
    leaves by g sigmas at most, and where it never does, the reference is the first measurement.
    Without noise of measurement, the state is known at k. The whole flight has so many steps.
    """
    R, two = measurement_covariance(mission), MARGIN_SIGMAS * 2**0.5
    if mission.tracking is not None:
        return two * mission.tracking.position
    whole = whole if R.any() else 1
    model = mission.discretize(whole + period)
    W, P, first, most = _acceleration_covariance(mission), R, R, 0.0
    wrong = _acceleration_covariance(mission, is_believed=True) if R.any() else W
    for k in range(whole):
        s, c = (_largest_sigmas(_spread(model[k:], one, W, period))[0] for one in (P, first))
        kept = (2 * GATE_SIGMAS + two) * s
        most = max(most, min(two * c, kept))
        if not R.any() or kept <= two * c:  # c grows, and s does not
            break
        first, P = spread(model, k, first, wrong), correct(spread(model, k, P, wrong), R)
    return most


def _acceleration_covariance(
    mission: Reconfiguration, is_believed: bool = False
) -> Float[Array, "d d"]:
    """Return that of disturbances; and of the model's errors, as agents filter measurements."""
    wrong = model_acceleration(mission) ** 2 if is_believed else 0.0
    return np.asarray(np.eye(mission.axes) * (largest_disturbance(mission) ** 2 + wrong))


def _spread(model: DiscreteModel, P: Array, W: Array, steps: int) -> Float[Array, "n n"]:
    for k in range(steps):
        P = spread(model, k, P, W)
    return P


def _largest_sigmas(P: Float[Array, "n n"]) -> tuple[float, float]:
    """Return the largest deviations of the position [m] and of the velocity [m/s]."""
    d = len(P) // 2
    position, velocity = (np.linalg.eigvalsh(part).max() for part in (P[:d, :d], P[d:, d:]))
    return sqrt(max(position, 0.0)), sqrt(max(velocity, 0.0))


def model_error(mission: Reconfiguration, steps: int) -> float:
    """Compute the largest error of the shared model over some steps [m].

    It is taken from all starts and targets, at nine instants of the mission, under full control on
    all axes. Of a plant of the user's own it is also taken on the ways of transfers and R beside
    them, and under full control on each axis.
    """
    if mission.flies_model:
        return 0.0
    whole, full = sum(leg.steps for leg in mission.legs) * mission.step, np.ones((1, mission.axes))
    states = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
    times = np.linspace(0, whole, 9).tolist()
    errors = [_largest_error(mission, t, states, steps, full) for t in times]
    if is_own_plant(mission.plant):
        each = np.vstack([full, np.eye(mission.axes)])
        places = _places_on_the_way(mission)
        errors += [_largest_error(mission, t, states, steps, each) for t, states in places]
    return max(errors)


def _places_on_the_way(mission: Reconfiguration) -> Iterator[tuple[float, Float[Array, "k n"]]]:
    """Yield times, and states of agents that fly alone then, and beside these."""
    n, step = 2 * mission.axes, mission.step
    side = mission.largest_separation * np.eye(mission.axes, n)
    for begin, leg, paths in _fly_alone(mission):
        for k in sorted({leg.steps // 4, leg.steps // 2, 3 * leg.steps // 4}):
            x = np.stack([path.x[k] for path in paths])
            yield begin + k * step, np.concatenate([x, *(x + s for s in (*side, *-side))])


def _largest_error(
    mission: Reconfiguration,
    t: float,
    states: Float[Array, "k n"],
    steps: int,
    directions: Float[Array, "j #d"],
) -> float:
    largest, d = 0.0, mission.axes
    model, most = mission.discretize(steps, t), mission.largest_control
    for control in np.concatenate([directions * most, -directions * most]):
        u = np.broadcast_to(control, (len(states), steps, d))
        flown = _fly_plant(mission, states, u[:, 0], t, steps * mission.step)
        error = (flown - model.simulate(states, u)[:, -1])[:, :d]
        largest = max(largest, float(np.linalg.norm(error, axis=1).max()))
    return largest


def _fly_plant(
    mission: Reconfiguration, x: Float[Array, "k n"], u: Float[Array, "k d"], t: float, time: float
) -> Float[Array, "k n"]:
    """Return the states a time [s] later; the plant flies as many vehicles as there are at once."""
    agents, n = mission.initial_states.shape
    count = -(-len(x) // agents)
    # Rows of NaN are no vehicles.
    states, held = np.full((count, agents, n), np.nan), np.zeros((count, agents, n // 2))
    states.reshape(-1, n)[: len(x)], held.reshape(-1, n // 2)[: len(x)] = x, u
    for batch, control in zip(states, held, strict=True):
        batch[:] = mission.flown_plant.propagate(batch, control, t, time)[-1]
    return states.reshape(-1, n)[: len(x)]


def model_error_on_arrival(mission: Reconfiguration) -> tuple[float, float]:
    """Return how far, and how fast, a wrong model leaves an agent from its target [m, m/s].

    Its error is corrected until the last plan that can, and no further: it is that of the steps
    since then, in the trajectories of the assignment of least energy, without regard to others,
    when a leg ends as planned or up to a whole leg later. Twice, for those who give way.
    """
    worst = np.zeros(2)
    for begin, leg, paths in () if mission.flies_model else _fly_alone(mission):
        steps = min(leg.steps, _uncorrected_steps(mission, paths))
        for late in (0.0, 0.5, 1.0):
            t = begin + ((1 + late) * leg.steps - steps) * mission.step
            error = _errors_along(mission, paths, steps, t).reshape(-1, 2, mission.axes)
            worst = np.maximum(worst, 2 * np.linalg.norm(error, axis=2).max(axis=0))
    return float(worst[0]), float(worst[1])


def _fly_alone(mission: Reconfiguration) -> Iterator[tuple[float, Leg, list[Trajectory]]]:
    """Yield the begin [s] of each leg, and the transfers of an assignment, where there are any.

    They are those of the weakest vehicle, without those out of reach.
    """
    most = [float(limit.most * limit.shares.min()) for limit in mission.control_limits]
    begin, start, weakest = 0.0, mission.initial_states[mission.alive], int(np.argmin(most))
    for leg in mission.legs:
        model = mission.discretize(leg.steps, begin)
        transfer = mission.make_transfer(model, weakest, objective=mission.objective)
        rows = columns = np.arange(min(len(start), len(leg.targets)))
        if mission.assignment != "given":
            rows, columns = linear_sum_assignment(compute_energies(model, start, leg.targets))
        found, _ = solve_solo_transfers(transfer, start[rows], leg.targets[columns])
        if paths := [path for path in found if path is not None]:
            yield begin, leg, paths
        start, begin = leg.targets, begin + leg.steps * mission.step


def _uncorrected_steps(mission: Reconfiguration, paths: list[Trajectory]) -> int:
    """Count the steps before arrival in which an agent may correct nothing.

    Two steps are the least in which a control sets both position and velocity right, if it has
    room in either direction; those of an agent that brakes with all its control have none.
    """
    limit = min(mission.control_limits, key=lambda one: float(one.most * one.shares.min()))
    u = np.stack([path.u[::-1] for path in paths])
    used = np.abs(u / limit.shares) if limit.norm == "inf" else limit.measure(u)[..., None]
    is_free = np.cumsum(used < (1 - CONTROL_ROOM) * limit.most, axis=1) >= 2
    needed = 1 + int((~is_free.all(axis=2)).sum(axis=1).max())
    return max(needed, mission.freeze_steps) + mission.replan_steps - 1


def _errors_along(
    mission: Reconfiguration, paths: list[Trajectory], steps: int, t: float
) -> Float[Array, "k n"]:
    """Compute what the plant does otherwise than agents plan in the last steps, from t on."""
    x = np.stack([path.x[-steps - 1 :] for path in paths])
    u = np.stack([path.u[-steps:] for path in paths])
    model = mission.discretize(steps, t)
    planned = x = model.simulate(x[:, 0], u)
    if mission.nonlinear_model is not None:
        own = linearize_along(mission.nonlinear_model, x, u, mission.step, t)
        each = enumerate(zip(x[:, 0], u, strict=True))
        planned = np.stack([own.for_agent(i).simulate(*path) for i, path in each])
    flown = x[:, 0]
    for k in range(steps):
        flown = _fly_plant(mission, flown, u[:, k], t + k * mission.step, mission.step)
    return np.asarray(flown - planned[:, -1])


def noise_on_arrival(mission: Reconfiguration) -> tuple[float, float]:
    """Return how far, and how fast, noise leaves an agent from its target [m, m/s].

    An agent that brakes with all its control corrects nothing, and two steps before that are
    the least in which a control sets both position and velocity right; nor does an agent that
    keeps its plan at the end correct anything. What remains is how far its reference may be
    from its state until then, by all measurements before, and later disturbances, and the
    thrust errors while it brakes.
    """
    if not mission.has_noise:
        return 0.0, 0.0
    d, steps = mission.axes, min(leg.steps for leg in mission.legs)
    joins = [leg.steps - join.at_step for leg in mission.legs for join in leg.joins]
    if (found := mission.tracking_after(max(min([steps, *joins]), 0))) is not None:
        return TOLERANCE_SIGMAS * found.position, TOLERANCE_SIGMAS * found.velocity
    strongest, weakest = mission.largest_control.max(), mission.least_control
    wrong = strongest * np.hypot(mission.thrust_error, mission.pointing_error)
    needed = _speed_to_lose(mission, steps) / (weakest * mission.step)
    braking = ceil(min(needed, steps))
    blind = max(braking + 2, mission.freeze_steps) + mission.replan_steps - 1
    thrusting = max(braking, mission.freeze_steps) + mission.replan_steps - 1
    left = mission.discretize(blind)
    P = undisturbed = _final_covariance(mission, max(steps - blind, 0))
    for k in range(blind):
        thrust = wrong if k >= blind - thrusting else 0.0
        P = spread(left, k, P, (mission.disturbance**2 + thrust**2) * np.eye(d))
        undisturbed = spread(left, k, undisturbed, np.zeros((d, d)))
    position, velocity = (
        TOLERANCE_SIGMAS * random + GATE_SIGMAS * kept
        for random, kept in zip(_largest_sigmas(P), _largest_sigmas(undisturbed), strict=True)
    )
    return position, velocity


def _final_covariance(mission: Reconfiguration, steps: int) -> Float[Array, "n n"]:
    """Return the covariance of an estimate after so many steps; 0 without measurement noise."""
    P = R = measurement_covariance(mission)
    if R.any():
        model = mission.discretize(steps)
        W = _acceleration_covariance(mission, is_believed=True)
        for k in range(steps):
            P = correct(spread(model, k, P, W), R)
    return P


def _speed_to_lose(mission: Reconfiguration, steps: int) -> float:
    """Return the most speed that an agent has to lose on arrival [m/s]."""
    d, fastest = mission.axes, float(mission.top_speeds.max())
    if mission.is_point_mass:
        states = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
        fast = 2 * float(np.ptp(states[:, :d], axis=0).max()) / (steps * mission.step)
        return min(fastest, fast)
    # In orbit most of a speed belongs to the trajectory; about half of the fuel brakes.
    burned, start, t = 0.0, mission.initial_states[mission.alive], 0.0
    for leg in mission.legs:
        transfer = TransferProblem(mission.discretize(leg.steps, t), mission.largest_control)
        fuel = compute_transfer_costs(transfer, start, leg.targets).cost
        burned = max(burned, float(fuel[linear_sum_assignment(fuel)].max()))
        start, t = leg.targets, t + leg.steps * mission.step
    return min(fastest, burned / 2)


def model_doubts(mission: Reconfiguration, chief: Chief) -> list[str]:
    """List doubts about a linear model of relative motion where the swarm flies.

    Compares it with the exact motion under J2: the free flight of all agents that are there
    at the start, until the end of the first leg. A model that is linearized again about each
    agent's own trajectory is exact to first order everywhere, and a model that flies itself
    has no error.
    """
    kind = getattr(mission.model, "kind", type(mission.model).__name__)
    start, steps = mission.initial_states[mission.alive], mission.legs[0].steps
    T = steps * mission.step
    free = np.zeros((len(start), steps, mission.axes))
    modeled = mission.discretize(steps).simulate(start, free)[:, -1]
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


def arrival_doubts(mission: Reconfiguration) -> list[str]:
    """List the doubt about a plant of the user's own, for whose errors all would arrive."""
    if not is_own_plant(mission.plant) or mission.flies_model:
        return []
    place, speed = model_error_on_arrival(mission)
    if max(place, speed * mission.step) <= mission.least_separation / 2:
        return []
    return [
        f"the plant does otherwise than the model, by {place:.3g} m and {speed:.3g} m/s on "
        "arrival: within such tolerances who passes by has arrived; a nearer model would do"
    ]


def tracking_doubts(mission: Reconfiguration) -> list[str]:
    """List doubts about the margin and the control of agents that follow references."""
    doubts, needed = list[str](), compute_margin(mission)
    if mission.margin < needed * (1 - 1e-9):
        doubts.append(
            f"plan.margin_m = {mission.margin:.3g} m is less than the {needed:.3g} m by which "
            'noise may bring two agents closer than planned; margin_m = "auto" would do'
        )
    enough, least = mission.reserve / MAX_RESERVE, mission.least_control
    if enough > least:
        # Errors of thrusts grow with the control.
        has_own = mission.thrust_error or mission.pointing_error
        cure = "" if has_own else f"model.max_control_m_s2 = {enough:.3g}, or "
        doubts.append(
            f"feedback takes up to {mission.reserve:.3g} m/s² for noise, of {least:.3g}: agents "
            f"may deviate by more than the margin; {cure}less noise would do"
        )
    return doubts
