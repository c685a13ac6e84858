"""Planning of trajectories: each agent alone, then conflict resolution among neighbors."""

from functools import lru_cache, partial
from math import ceil, inf, isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import ControlSamples
from dynamics.trajectory_geometry import interpolation_error
from problems.convexify import AvoidanceHorizon
from problems.transfer import Trajectory, compute_energy, compute_fuel
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.relaxation import list_relaxations
from sato.reconfiguration.solo_trajectories import relinearize, solve_solo_trajectories
from sato.reconfiguration.state import AgentMemory, DecisionContext, Event
from sato.scp import CONVERGENCE_TOLERANCE, FEASIBILITY_TOLERANCE, Planner, resolve_conflicts
from sato.scp.halfway import meet_halfway
from sato.scp.planner import Priority

MAX_WAIT = 8  # periods of planning after which an agent without a way looks again
MAX_PIECES = 12  # of the trajectory within a step


class Plan(NamedTuple):
    """Planned trajectory of an agent."""

    trajectory: Trajectory
    target_index: int | None  # None where it ends elsewhere
    planned_at: int  # steps since the start of the leg
    clear_until: int  # step of the leg until which it keeps clear of all others
    failure_count: int = 0  # plans of this agent in the leg for which constraints were relaxed
    priority: Priority = (0.0, 0.0, 0)  # with which it was made
    is_clear: bool = False  # of those of all that the agent hears, to its end

    def controls_from(self, k: int) -> Float[Array, "left m"]:
        """Return the controls from a step of the leg on."""
        return self.trajectory.u[k - self.planned_at :]


Plans = dict[int, Plan]  # by the number of the agent


def is_planning_due(
    mission: Reconfiguration, plans: Plans, memory: AgentMemory, k: int, steps: int
) -> Bool[Array, " agents"]:
    """Find the agents that plan again: all but those about to arrive, by a plan clear to its end.

    Those that have arrived do so too where noise may take them from their targets.

    Args:
        mission: Steps before the deadline in which plans are kept.
        plans: Plans of the agents.
        memory: Targets and clocks of the agents.
        k: Steps since the start of the leg.
        steps: Steps of the leg.
    """
    left = steps - memory.clock
    is_kept = (left < mission.freeze_steps) | mission.keeps_plans
    is_over = (left == 0) & ~(mission.is_point_mass and mission.has_noise)
    for i in np.flatnonzero(is_kept).tolist():
        if mission.has_own_clocks and _waits(mission, plans.get(i), k):
            continue
        has_plan = remaining_controls(plans, i, memory, k, steps) is not None
        is_kept[i] = has_plan and (is_over[i] or _is_clear(mission, plans[i], k, int(left[i])))
    return np.asarray(~is_kept)


def has_changed_network(
    mission: Reconfiguration, bidder_count: Int[Array, " agents"], size: Int[Array, " agents"]
) -> Bool[Array, " agents"]:
    """Find the agents that keep plans, and whose network is not the one that bid last.

    Args:
        mission: Whether targets are assigned by auction, and plans kept.
        bidder_count: Bidders in the last auction of each agent; 0 before the first.
        size: Agents in the network of each.
    """
    is_asked = mission.keeps_plans and mission.assignment == "auction"
    return np.asarray(is_asked & (bidder_count > 0) & (bidder_count != size))


def _is_clear(mission: Reconfiguration, plan: Plan, k: int, left: int) -> bool:
    # To its end; or, where it is replaced before that, for as long as it has been flown.
    ahead = min(left, k - plan.planned_at + 1) if mission.keeps_plans else left
    return k + ahead <= plan.clear_until


def _waits(mission: Reconfiguration, plan: Plan | None, k: int) -> bool:
    # The more often an agent has found no way, the longer it waits before it looks again.
    if plan is None or plan.target_index is not None:
        return False
    periods = min(plan.failure_count, MAX_WAIT)
    return k < plan.planned_at + periods * mission.replan_steps


def give_up_missed(
    mission: Reconfiguration, plans: Plans, state: Float[Array, "agents n"], k: int
) -> Plans:
    """Give up plans that would be kept, but from which their agents have strayed.

    No agent of a mission without noise strays, but one may fly in a world that is not as modeled.

    Args:
        mission: Whether plans are kept.
        plans: Plans of the agents.
        state: State of each.
        k: Steps since the start of the leg.
    """
    if not mission.keeps_plans:
        return plans
    allowed, found = FEASIBILITY_TOLERANCE * mission.least_separation, dict(plans)
    for i, plan in plans.items():
        x = plan.trajectory.x[min(k - plan.planned_at, len(plan.trajectory.u))]
        if plan.target_index is not None and np.abs(state[i] - x).max() > allowed:
            found[i] = plan._replace(target_index=None)
    return found


def is_held(context: DecisionContext, plans: Plans, i: int) -> bool:
    """Tell whether an agent holds on to its plan while others decide.

    It does where that is clear to its end; one that rests at its target makes room.
    """
    k, steps, memory = context.step_index, context.leg.steps, context.memory
    if not context.mission.keeps_plans:
        return False
    u = remaining_controls(plans, i, memory, k, steps)
    return u is not None and bool(u.any()) and k + len(u) <= plans[i].clear_until


def remaining_controls(
    plans: Plans, i: int, memory: AgentMemory, k: int, steps: int
) -> Float[Array, "T m"] | None:
    """Return the rest of an agent's controls, if they reach its target on its clock.

    Args:
        plans: Plans of the agents.
        i: Number of the agent.
        memory: Targets and clocks of the agents.
        k: Steps since the start of the leg.
        steps: Steps of the leg.
    """
    plan = plans.get(i)
    if plan is None or plan.target_index != memory.target_index[i]:
        return None
    u = plan.controls_from(k)
    return u if len(u) == steps - memory.clock[i] else None


def remaining_cost(plans: Plans, context: DecisionContext) -> Float[Array, " agents"]:
    """Return the fuel or energy left in each plan; infinite where none reaches the target."""
    mission, steps, k = context.mission, context.leg.steps, context.step_index
    cost = np.full(len(context.state), np.inf)
    for i in plans:
        u = remaining_controls(plans, i, context.memory, k, steps)
        if u is not None:
            cost[i] = compute_spent(mission, u)
    return cost


def compute_spent(mission: Reconfiguration, u: ControlSamples) -> Float[Array, "*agents"] | float:
    """Compute the fuel [m/s] or energy [m²/s³] of controls, after the mission's objective."""
    if mission.objective == "energy":
        return compute_energy(u, mission.step)
    return compute_fuel(u, mission.step, mission.fuel_norm)


def plan_trajectories(
    context: DecisionContext,
    spent: Float[Array, " agents"],
    previous: Plans,
    solve_count: int = 0,
    clocks: Int[Array, " agents"] | None = None,
) -> tuple[Plans, list[Event]]:
    """Plan for every agent that decides: alone first, then clear of the others.

    Args:
        context: States, memory and graph of the agents that decide.
        spent: Fuel or energy spent so far; the agent that has spent less gives way.
        previous: Plans that were flown so far.
        solve_count: Programs solved for this replanning already.
        clocks: Clock of each agent before it decided; that of its memory by default.
    """
    mission, graph = context.mission, context.graph
    heard = -graph.component_max(-(context.memory.clock if clocks is None else clocks))
    planners, unreachable, solo_count = plan_alone(context, spent, previous, heard)
    solve_count, rounds, resolved = solve_count + solo_count, 0, dict[int, Planner]()
    for steps in sorted({planner.horizon.steps for planner in planners.values()}):
        alike = {i: planner for i, planner in planners.items() if planner.horizon.steps == steps}
        bends = 0
        if mission.keeps_plans:
            alike, bends = meet_halfway(alike, graph)
        found = resolve_conflicts(alike, graph, mission.orders, mission.bargains)
        solve_count, rounds = solve_count + found.solve_count, max(rounds, bends, found.round_count)
        resolved |= found.planners
    replan = {"solves": solve_count, "exchanges": rounds}
    N = len(mission.initial_states)
    hears_all = bool(graph.adjacency.sum() == N * (N - 1))
    plans, relaxed = make_plans(context, resolved, unreachable, previous, hears_all)
    return plans, [{"kind": "replan", "agents": [], **replan}, *relaxed]


def make_plans(
    context: DecisionContext,
    planners: dict[int, Planner],
    unreachable: list[int],
    previous: Plans,
    hears_all: bool,
) -> tuple[Plans, list[Event]]:
    """Make plans of trajectories that are final, and list the constraints that were relaxed.

    Args:
        context: Memory and time of the agents that decide.
        planners: Planner of each agent, by its row.
        unreachable: Agents whose targets are out of reach.
        previous: Plans that were flown so far.
        hears_all: True where all agents of the mission hear each other, without a relay.
    """
    mission, k, target = context.mission, context.step_index, context.memory.target_index
    events = list_relaxations(mission, planners, unreachable)
    relaxed = {i for event in events for i in event["agents"]}
    # An agent that comes too close to another may still arrive.
    astray = {i for event in events if event["kind"] != "slack" for i in event["agents"]}
    plans, has_one_order = {}, mission.orders == 1 and not mission.bargains
    for i, planner in planners.items():
        if is_held(context, previous, i):
            plans[i] = previous[i]
            continue
        # Agents out of hearing are too far to meet within T_H alone (Proposition 9).
        clear = planner.horizon.steps if hears_all else mission.horizon_steps
        failures = previous[i].failure_count if i in previous else 0
        held = None if i in astray else int(target[i])
        failures += i in relaxed
        is_clear = has_one_order and planner.is_clear
        own = planner.nominal, held, k, k + clear, failures, planner.priority
        plans[i] = Plan(*own, is_clear)
    if mission.is_point_mass:  # a trajectory for which separation was relaxed is not flown
        events = [event for event in events if event["kind"] == "braked"]
    return plans, events


def make_horizon(
    mission: Reconfiguration, time: float, steps_left: int, leg: Leg | None = None
) -> AvoidanceHorizon:
    """Build the avoidance horizon at a time, with so many steps of the leg left.

    It has T_H steps, or as many as are foreseen among agents within hearing, but does not pass
    the end of the leg for the last of these.
    """
    T = max(mission.horizon_steps, min(mission.foresight, steps_left))
    return divide_horizon(mission, time, T, leg)


def divide_horizon(
    mission: Reconfiguration, time: float, T: int, leg: Leg | None = None
) -> AvoidanceHorizon:
    """Divide the steps of a horizon so finely that two agents move by about R_col in a piece."""
    fastest = float(mission.top_speeds.max())
    speed = fastest if isfinite(fastest) else 0.0
    S = min(MAX_PIECES, max(1, ceil(2 * speed * mission.step / mission.least_separation)))
    margin = mission.margin + _interpolation_margin(
        mission, leg or mission.legs[0], mission.step / S
    )
    return AvoidanceHorizon(
        discretize_zoh(mission.linear_model, mission.step, T, time),
        discretize_zoh(mission.linear_model, mission.step / S, T * S, time),
        mission.largest_separation + margin,
    )


def plan_alone(
    context: DecisionContext,
    spent: Float[Array, " agents"],
    previous: Plans,
    heard_clock: Int[Array, " agents"],
) -> tuple[dict[int, Planner], list[int], int]:
    """Plan for every agent that decides as if it were alone.

    Args:
        context: States, memory and graph of the agents that decide.
        spent: Fuel or energy spent so far.
        previous: Plans that were flown so far.
        heard_clock: Clock with the most time left in each agent's component, as it was announced.

    Returns:
        Planners, agents whose targets are out of reach, and the number of programs solved.
    """
    mission, leg, k = context.mission, context.leg, context.step_index
    memory = context.memory
    is_nonlinear = mission.nonlinear_model is not None
    # Given targets need no agreement: others hear of a reset at the next replan.
    is_given = mission.assignment == "given"
    first_clock = heard_clock if is_given else np.minimum(heard_clock, memory.clock)
    ahead = np.minimum(leg.steps - first_clock, mission.foresight)
    ahead = np.maximum(ahead, mission.horizon_steps)
    horizons = {
        T: make_horizon(mission, context.time, T, leg)
        for T in set(ahead[context.graph.alive].tolist())
    }
    planners: dict[int, Planner] = {}
    unreachable: list[int] = []
    solve_count = 0
    # The first agent may have given way by little in a negotiation, and others count on it.
    relative = FEASIBILITY_TOLERANCE if mission.bargains else CONVERGENCE_TOLERANCE
    for clock, group in context.group_agents():
        agents, model = group.tolist(), context.remaining_model(clock)
        rests = [remaining_controls(previous, i, memory, k, leg.steps) for i in agents]
        transfers, solos, stranded, count = solve_solo_trajectories(context, model, agents, rests)
        unreachable += stranded
        solve_count += count
        x, u = (np.stack(part) for part in zip(*(solo[:2] for solo in solos), strict=True))
        paths = {T: own.control_points(x, u) for T, own in horizons.items()}
        each = zip(agents, transfers, solos, rests, strict=True)
        for row, (i, transfer, solo, rest) in enumerate(each):
            own = horizons[int(ahead[i])]
            clearance = own.clearance
            if not mission.has_equal_radii:
                (wide,) = mission.own_clearances(clearance, np.array([i])).tolist()
                own = own.with_clearance(wide)
            planner = Planner(
                priority=(_priority_class(context, i, previous), -float(spent[i]), i),
                target_state=leg.targets[memory.target_index[i]],
                transfer=transfer,
                solver=context.solver_of(i),
                horizon=own,
                solo=solo,
                nominal=solo,
                control_points=paths[int(ahead[i])][row],
                relinearize=partial(relinearize, context, transfer) if is_nonlinear else None,
                in_turn=mission.keeps_plans,
            )
            if rest is not None and not mission.keeps_plans:
                # Begin with the previous plan, where it kept clear of an agent by another way.
                prior = transfer.simulate(solo.x[0], rest)
                if np.abs(prior.x - solo.x).max() > relative * clearance:
                    planner = planner.with_nominal(prior)._replace(has_converged=False)
            planners[i] = planner
    return planners, unreachable, solve_count


def _priority_class(context: DecisionContext, i: int, previous: Plans) -> float:
    # Among agents of equal priority, those first that others have kept from their targets.
    mission, is_over = context.mission, context.memory.clock[i] == context.leg.steps
    if is_over or is_held(context, previous, i):
        return -inf
    failures = previous[i].failure_count if i in previous else 0
    given = 0.0 if mission.priority is None else mission.priority[i]
    return -given - failures / (failures + 1)


@lru_cache(maxsize=8)  # the same at every replanning of a mission
def _interpolation_margin(mission: Reconfiguration, own: Leg, h: float) -> float:
    # Error of the cubic pieces of two agents, at the states with which the mission begins and
    # ends and under full control; doubled for the states in between.
    targets = [leg.targets for leg in (*mission.legs, own)]
    ends = np.concatenate([mission.initial_states, *targets])
    x = np.stack([ends, ends], axis=1)
    u = np.broadcast_to(mission.largest_control, (len(ends), 1, mission.axes))
    return 4 * interpolation_error(mission.linear_model, x, u, h)
