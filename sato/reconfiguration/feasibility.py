"""Feasibility of a mission: what can be refused before anything is flown, and what is doubtful."""

from math import degrees, floor, inf, pi
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.double_integrator import DoubleIntegrator
from dynamics.j2 import J2
from dynamics.plant import LinearPlant
from sato.scenario.errors import InputError, join_names, round_down, round_up

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Leg, Reconfiguration

MAX_POINTING_ERROR = pi / 6  # standard deviation beyond which directions mean nothing [rad]
MAX_TIME_FACTOR = 64  # times the steps that were asked for; beyond, time is not what is missing
MAX_CONTROL_FACTOR = 64  # times the control that there is
CONTROL_PRECISION = 1.01  # relative, of the control that would do
MAX_PAIRS_TIMES_STEPS = 20_000_000  # above which no longer time is tried
MAX_MODEL_ERROR = 0.1  # of the collision radius: beyond it a model is doubtful


def check_periods(mission: "Reconfiguration") -> None:
    """Refuse periods that do not nest, and an increment that ends no auction.

    Raises:
        InputError: A period is longer than the horizon, or no multiple of another.
    """
    horizon, replan, auction = mission.horizon_steps, mission.replan_steps, mission.auction_steps
    if mission.epsilon == 0:
        raise InputError("plan.epsilon", 'must be positive, or "auto", got 0')
    if replan > horizon:
        raise InputError(
            "plan.replan_steps",
            f"{replan} is more than horizon_steps = {horizon}, so collisions would be left unseen; "
            f"at most {horizon} would do",
        )
    if auction > horizon:
        raise InputError(
            "plan.auction_steps",
            f"{auction} is more than horizon_steps = {horizon}, so two agents could reach one "
            f"target before they bid for it; {horizon // replan * replan} would do",
        )
    if auction % replan:
        raise InputError(
            "plan.auction_steps",
            f"{auction} is no multiple of replan_steps = {replan}; "
            f"{auction // replan * replan or replan} would do",
        )
    if mission.bargains and mission.orders == 1:
        raise InputError(
            "plan.bargains",
            f"{mission.bargains} sweeps need orders of 2 or more: only then is what was agreed a "
            "candidate at the next plan",
        )
    for number, leg in enumerate(mission.legs):
        if mission.freeze_steps > leg.steps:
            raise InputError(
                "plan.freeze_steps",
                f"{mission.freeze_steps} is more than the {leg.steps} steps of leg {number}; at "
                f"most {leg.steps} would do, with which the first plan is flown to the end",
            )


def check_noise(mission: "Reconfiguration") -> None:
    """Refuse noise with which agents could not know whether they collide, or steer.

    Raises:
        InputError: It is too large.
    """
    if mission.position_noise >= mission.collision_radius:
        raise InputError(
            "disturbance.position_m",
            f"{mission.position_noise:g} is not less than swarm.collision_radius_m = "
            f"{mission.collision_radius:g}, so agents could not know whether they collide; "
            f"{round_down(mission.collision_radius / 50)} would do",
        )
    if mission.thrust_error >= 1:
        thrust = mission.thrust_error
        raise InputError(
            "disturbance.thrust",
            f"{thrust:g} is a standard deviation of {100 * thrust:g} % of the thrust, of which it "
            f"is a part; {thrust / 100:g} would be {thrust:g} %",
        )
    if mission.pointing_error > MAX_POINTING_ERROR:
        raise InputError(
            "disturbance.pointing_rad",
            f"{mission.pointing_error:.4g} is {degrees(mission.pointing_error):.4g} degrees, with "
            "which a thruster points anywhere; at most pointing_deg = "
            f"{degrees(MAX_POINTING_ERROR):.0f} would do",
        )


def is_detectable(mission: "Reconfiguration") -> bool:
    """Tell whether two agents that could meet within the horizon hear each other at its start.

        R_comm ≥ 2 V_max T_H Δt + R_col

    [Morgan2016, Proposition 9].
    """
    return mission.comm_radius >= _least_comm_radius(mission) * (1 - 1e-12)


def check_detectable(mission: "Reconfiguration") -> None:
    """Refuse agents that could meet unseen, unless that is what is to be shown.

    Raises:
        InputError: They could; says which radius, speed or horizon would do.
    """
    if mission.allow_undetectable or is_detectable(mission):
        return
    needed, speed = _least_comm_radius(mission), mission.max_speed
    room = mission.comm_radius - mission.collision_radius
    cures = []
    if speed < inf:
        cures.append(f"swarm.comm_radius_m = {round_up(needed)}")
    if room > 0:
        slower = room / (2 * mission.horizon_steps * mission.step)
        cures.append(f"model.max_speed_m_s = {round_down(slower)}")
    if speed < inf and (shorter := floor(room / (2 * speed * mission.step) + 1e-9)) > 0:
        cures.append(f"plan.horizon_steps = {shorter}")
    if not cures:
        cures.append("a larger comm_radius_m with a model.max_speed_m_s")
    limit = f"{needed:.4g} m" if speed < inf else "infinite, for there is no model.max_speed_m_s"
    raise InputError(
        "swarm.comm_radius_m",
        f"{mission.comm_radius:g} is less than 2 V_max T_H Δt + R_col, which is {limit}, so two "
        "agents could meet within the horizon unseen (Proposition 9); "
        f"{join_names(cures)} would do, and plan.allow_undetectable = true flies it all the same",
    )


def check_legs(mission: "Reconfiguration") -> None:
    """Refuse a mission without legs, without agents, with too few targets, or absent agents.

    Raises:
        InputError: It is one of these.
    """
    if not mission.legs:
        raise InputError("leg", "needs at least 1 entry, got 0")
    if mission.agents is None:
        raise InputError("swarm.agents", "is missing, and has no default")
    listed = getattr(mission.start, "positions", None)
    if listed is not None and len(listed) != mission.agents:
        raise InputError(
            "swarm.start.positions_m", f"lists {len(listed)} positions for {mission.agents} agents"
        )
    known = mission.agents
    for number, (leg, enough) in enumerate(zip(mission.legs, target_demand(mission), strict=True)):
        known += _joining(leg)
        for loss in leg.losses:
            if loss.agents and max(loss.agents) >= known:
                raise InputError(
                    f"leg.{number}.lose.agents",
                    f"there is no agent {max(loss.agents)}; they are 0 to {known - 1}",
                )
        if leg.count is not None and leg.count < enough:
            raise InputError(
                f"leg.{number}.targets",
                f"{leg.count} is less than the {enough} agents that there may be, or that may "
                f"be believed in; {enough} or more would do",
            )
        listed = getattr(leg.shape, "positions", None)
        if listed is not None and len(listed) < (leg.count or enough):
            raise InputError(
                f"leg.{number}.shape.positions_m",
                f"lists {len(listed)} points, fewer than the {leg.count or enough} asked for",
            )


def target_demand(mission: "Reconfiguration") -> list[int]:
    """Return the most targets that any agent may believe in on each leg, whatever is drawn."""
    most: list[int] = []
    live = mission.agent_count
    believed = mission.target_count or live
    known_lost: set[int] | None = set()  # indices; nothing is known after a loss by share
    for leg in mission.legs:
        if leg.recount:
            believed = live
        live += _joining(leg)
        for loss in sorted(leg.losses, key=lambda loss: loss.at_step):
            if loss.at_step > 0:
                believed = max(believed, live)
            if loss.share is not None and loss.kind != "agents":
                live -= floor(loss.share * live)
                known_lost = None
            elif known_lost is not None:
                live -= len(set(loss.agents) - known_lost)
                known_lost |= set(loss.agents)
        believed = max(believed, live)
        most.append(believed)
    return most


class Stranded(NamedTuple):
    """Agent without a target that it can reach in time."""

    agent: int
    reaches_none: bool  # else the others need all targets that it reaches


def check_reach(mission: "Reconfiguration") -> None:
    """Refuse a drawn mission in whose first leg an agent cannot reach a target.

    Looks at the limits on control, and on speed where a necessary condition has a closed
    form: a mission that passes can still turn out to be out of reach on the way.

    Raises:
        InputError: An agent can reach none of the targets that it bids on, or too few of them
            can be reached for every agent to have one; says for which agent, and what time or
            control would do.
    """
    steps = mission.legs[0].steps
    stranded = _find_stranded(mission, steps, mission.max_control)
    if stranded is None:
        return
    fault = (
        "can reach none of its targets"
        if stranded.reaches_none
        else "is left without a target, for the others need all that it can reach,"
    )
    time, control = _sufficient_steps(mission, steps), _sufficient_control(mission, steps)
    cures = [f"steps = {time}"] if time else []
    cures += [f"model.max_control_m_s2 = {control}"] if control else []
    cures = cures or ["far more steps, a larger model.max_control_m_s2 or max_speed_m_s"]
    raise InputError(
        "leg.0.steps",
        f"agent {stranded.agent} {fault} in {steps} steps of {mission.step:g} s; "
        f"{join_names(cures)} would do",
    )


def model_doubts(mission: "Reconfiguration") -> list[str]:
    """List doubts about a linear model of relative motion where the swarm flies.

    Compares it with the exact motion under J2: the free flight of all agents that are there
    at the start, until the end of the first leg. A model that is linearized again about each
    agent's own trajectory is exact to first order everywhere, and a model that flies itself
    has no error.
    """
    chief, kind = mission.chief, getattr(mission.model, "kind", "")
    if chief is None or mission.nonlinear_model is not None:
        return []
    if isinstance(mission.flown_plant, LinearPlant):
        return []
    start, steps = mission.initial_states[mission.alive], mission.legs[0].steps
    T = steps * mission.step
    free = np.zeros((len(start), steps, mission.axes))
    modeled = discretize_zoh(mission.linear_model, mission.step, steps).simulate(start, free)[:, -1]
    exact = J2(chief.orbit).propagate(start, np.array([T]))[-1]
    error = np.linalg.norm((modeled - exact)[:, :3], axis=1)
    i = int(np.argmax(error))
    if error[i] <= MAX_MODEL_ERROR * mission.collision_radius:
        return []
    away = float(np.linalg.norm(start[i, :3]))
    cure = "model.relinearize = true" if kind == "j2" else 'model.kind = "j2"'
    return [
        f"{kind} is wrong by {error[i]:.3g} m after {T:g} s of free flight for agent {i}, "
        f"which starts {away:.4g} m from the chief: more than a tenth of the collision radius of "
        f"{mission.collision_radius:g} m; {cure} would do"
    ]


def _least_comm_radius(mission: "Reconfiguration") -> float:
    closing = 2 * mission.max_speed * mission.horizon_steps * mission.step
    return closing + mission.collision_radius


def _joining(leg: "Leg") -> int:
    from sato.reconfiguration.mission import join_size

    return sum(map(join_size, leg.joins))


def _sufficient_steps(mission: "Reconfiguration", steps: int) -> int | None:
    def stranded(steps: int) -> bool:
        return _find_stranded(mission, steps, mission.max_control) is not None

    pairs = len(mission.initial_states) * len(mission.legs[0].targets)
    few, many = steps, 2 * steps
    while stranded(many):
        few, many = many, 2 * many
        if many > MAX_TIME_FACTOR * steps or many * pairs > MAX_PAIRS_TIMES_STEPS:
            return None
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (middle, many) if stranded(middle) else (few, middle)
    return many


def _sufficient_control(mission: "Reconfiguration", steps: int) -> str | None:
    def does(control: float) -> bool:
        return _find_stranded(mission, steps, control) is None

    weak, strong = mission.max_control, 2 * mission.max_control
    while not does(strong):
        weak, strong = strong, 2 * strong
        if strong > MAX_CONTROL_FACTOR * mission.max_control:
            return None
    while strong > weak * CONTROL_PRECISION:
        middle = (weak * strong) ** 0.5
        weak, strong = (weak, middle) if does(middle) else (middle, strong)
    return round_up(strong)


def _find_stranded(mission: "Reconfiguration", steps: int, max_control: float) -> Stranded | None:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    live, spare = _starting(mission)
    wanted = max(mission.target_count or 0, len(live) - spare)
    targets = mission.legs[0].targets[:wanted]
    reachable = _reachable(mission, mission.initial_states[live], targets, steps, max_control)
    none = np.flatnonzero(~reachable.any(axis=1))
    if none.size > spare:
        return Stranded(int(live[none[0]]), True)
    matched = maximum_bipartite_matching(csr_array(reachable), perm_type="column")
    left = np.flatnonzero(matched < 0)
    return Stranded(int(live[left[0]]), False) if left.size > spare else None


def _starting(mission: "Reconfiguration") -> tuple[Int[Array, " live"], int]:
    # Agents that begin the first leg, and how many of them, not yet known, are lost before it.
    alive, spare = mission.alive.copy(), 0
    for loss in (loss for loss in mission.legs[0].losses if loss.at_step == 0):
        alive[list(loss.agents)] = False
        spare += floor((loss.share or 0.0) * (alive.sum() - spare))
    return np.flatnonzero(alive), spare


def _reachable(
    mission: "Reconfiguration",
    start: Float[Array, "k n"],
    targets: Float[Array, "m n"],
    steps: int,
    max_control: float,
) -> Bool[Array, "k m"]:
    from problems.auction_cost import compute_transfer_costs
    from problems.transfer import TransferProblem

    model = discretize_zoh(mission.linear_model, mission.step, steps)
    # The box of r = ∞ contains the balls of the other norms: out of its reach is out of theirs.
    transfer = TransferProblem(model, max_control)
    reachable = compute_transfer_costs(transfer, start, targets).is_reachable
    if isinstance(mission.linear_model, DoubleIntegrator) and mission.max_speed < inf:
        time = _least_time(mission, start, targets, max_control)
        reachable &= time <= steps * mission.step * (1 + 1e-9)
    return np.asarray(reachable)


def _least_time(
    mission: "Reconfiguration",
    start: Float[Array, "k n"],
    targets: Float[Array, "m n"],
    max_control: float,
) -> Float[Array, "k m"]:
    # Along the straight line to the target, a point that is no faster than V and, where it
    # starts at rest, no stronger than the box is in that direction: a bound from below.
    d = mission.axes
    way = targets[None, :, :d] - start[:, None, :d]
    far = np.linalg.norm(way, axis=2)
    V = mission.max_speed
    strength = max_control * np.abs(way).sum(axis=2) / np.where(far > 0, far, 1.0)
    strength = np.where(far > 0, strength, 1.0)
    trapezium = np.where(
        far * strength >= V**2, far / V + V / strength, 2 * np.sqrt(far / strength)
    )
    at_rest = ~start[:, None, d:].any(axis=2)
    return np.asarray(np.where(at_rest, trapezium, far / V))
