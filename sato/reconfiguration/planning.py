"""Planning of trajectories: each agent alone, then conflict resolution among neighbors."""

from functools import lru_cache, partial
from math import ceil, inf, isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import ControlSamples
from dynamics.trajectory_geometry import interpolation_error
from problems.convexify import AvoidanceHorizon
from problems.transfer import Trajectory, compute_energy, compute_fuel
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.solo_trajectories import relinearize, solve_solo_trajectories
from sato.reconfiguration.state import AgentMemory, DecisionContext, Event
from sato.scp import CONVERGENCE_TOLERANCE, FEASIBILITY_TOLERANCE, Planner, resolve_conflicts

MAX_PIECES = 12  # of the trajectory within a step


class Plan(NamedTuple):
    """Planned trajectory of an agent."""

    trajectory: Trajectory
    target_index: int | None  # None where it ends elsewhere
    planned_at: int  # steps since the start of the leg

    def controls_from(self, k: int) -> Float[Array, "left m"]:
        """Return the controls from a step of the leg on."""
        return self.trajectory.u[k - self.planned_at :]


Plans = dict[int, Plan]  # by the number of the agent


def is_planning_due(
    mission: Reconfiguration, plans: Plans, memory: AgentMemory, k: int, steps: int
) -> Bool[Array, " agents"]:
    """Find the agents that plan again: those without a plan, and those not about to arrive.

    Args:
        mission: Steps before the deadline in which plans are kept.
        plans: Plans of the agents.
        memory: Targets and clocks of the agents.
        k: Steps since the start of the leg.
        steps: Steps of the leg.
    """
    rests = [remaining_controls(plans, i, memory, k, steps) for i in range(len(memory.clock))]
    has_no_plan = np.array([rest is None for rest in rests])
    return np.asarray((steps - memory.clock >= mission.freeze_steps) | has_no_plan)


def controls_at(
    plans: Plans, k: int, alive: Bool[Array, " agents"], mission: Reconfiguration
) -> Float[Array, "agents m"]:
    """Return the controls at a step of the leg: 0 after the end of a plan, NaN if lost.

    Solvers exceed the limit by rounding, which is cut.
    """
    control = np.full((len(alive), mission.axes), np.nan)
    for i in np.flatnonzero(alive).tolist():
        u = plans[i].controls_from(k)
        control[i] = u[0] if len(u) else 0.0
        control[i] = mission.control_limit(i).cut(control[i])
    return control


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
) -> tuple[Plans, list[Event]]:
    """Plan for every agent that decides: alone first, then clear of the others.

    Args:
        context: States, memory and graph of the agents that decide.
        spent: Fuel or energy spent so far; the agent that has spent less gives way.
        previous: Plans that were flown so far.
        solve_count: Programs solved for this replanning already.
    """
    mission = context.mission
    planners, unreachable, solo_count = plan_alone(context, spent, previous)
    resolved = resolve_conflicts(planners, context.graph, mission.orders, mission.bargains)
    replan = {"solves": solve_count + solo_count + resolved.solve_count}
    events: list[Event] = [
        {"kind": "replan", "agents": [], **replan, "exchanges": resolved.round_count}
    ]
    plans, relaxed = make_plans(context, resolved.planners, unreachable)
    return plans, events + relaxed


def make_plans(
    context: DecisionContext, planners: dict[int, Planner], unreachable: list[int]
) -> tuple[Plans, list[Event]]:
    """Make plans of trajectories that are final, and list the constraints that were relaxed.

    Args:
        context: Memory and time of the agents that decide.
        planners: Planner of each agent, by its row.
        unreachable: Agents whose targets are out of reach.
    """
    target = context.memory.target_index
    events = _relaxation_events(context.mission, planners, unreachable)
    # An agent that comes too close to another may still arrive.
    astray = {i for event in events if event["kind"] != "slack" for i in event["agents"]}
    plans = {
        i: Plan(planner.nominal, None if i in astray else int(target[i]), context.step_index)
        for i, planner in planners.items()
    }
    return plans, events


def make_horizon(
    mission: Reconfiguration, time: float, steps_left: int, leg: Leg | None = None
) -> AvoidanceHorizon:
    """Build the avoidance horizon at a time, with so many steps of the leg left as planned.

    It has T_H steps, or as many as are foreseen among agents within hearing, but does not pass
    the planned end of the leg, which all agents know. A step is divided so finely that two
    agents at full speed move by about R_col in a piece.
    """
    fastest = float(mission.top_speeds.max())
    speed = fastest if isfinite(fastest) else 0.0
    S = min(MAX_PIECES, max(1, ceil(2 * speed * mission.step / mission.least_separation)))
    T = max(mission.horizon_steps, min(mission.foresight_steps, steps_left))
    margin = mission.margin + _interpolation_margin(
        mission, leg or mission.legs[0], mission.step / S
    )
    return AvoidanceHorizon(
        discretize_zoh(mission.linear_model, mission.step, T, time),
        discretize_zoh(mission.linear_model, mission.step / S, T * S, time),
        mission.largest_separation + margin,
    )


def plan_alone(
    context: DecisionContext, spent: Float[Array, " agents"], previous: Plans
) -> tuple[dict[int, Planner], list[int], int]:
    """Plan for every agent that decides as if it were alone.

    Args:
        context: States, memory and graph of the agents that decide.
        spent: Fuel or energy spent so far.
        previous: Plans that were flown so far.

    Returns:
        Planners, agents whose targets are out of reach, and the number of programs solved.
    """
    mission, leg, k = context.mission, context.leg, context.step_index
    memory = context.memory
    is_nonlinear = mission.nonlinear_model is not None
    horizon = make_horizon(mission, context.time, leg.steps - k, leg)
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
        paths = horizon.control_points(x, u)
        each = zip(agents, transfers, solos, paths, rests, strict=True)
        for i, transfer, solo, path, rest in each:
            own = horizon
            if not mission.has_equal_radii:
                wider = mission.radii[i] - mission.largest_separation
                own = horizon.with_clearance(horizon.clearance + float(wider))
            planner = Planner(
                priority=(_priority_class(mission, i, len(model)), -float(spent[i]), i),
                target_state=leg.targets[memory.target_index[i]],
                transfer=transfer,
                solver=context.solver_of(i),
                horizon=own,
                solo=solo,
                nominal=solo,
                control_points=path,
                relinearize=partial(relinearize, context, transfer) if is_nonlinear else None,
            )
            if rest is not None:
                # Begin with the previous plan, where it kept clear of an agent by another way.
                prior = transfer.simulate(solo.x[0], rest)
                if np.abs(prior.x - solo.x).max() > relative * horizon.clearance:
                    planner = planner.with_nominal(prior)._replace(has_converged=False)
            planners[i] = planner
    return planners, unreachable, solve_count


def _priority_class(mission: Reconfiguration, agent: int, steps: int) -> float | bool:
    if mission.priority is None:
        return steps > 0
    return -mission.priority[agent] if steps else -inf


@lru_cache(maxsize=8)  # the same at every replanning of a mission
def _interpolation_margin(mission: Reconfiguration, own: Leg, h: float) -> float:
    # Error of the cubic pieces of two agents, at the states with which the mission begins and
    # ends and under full control; doubled for the states in between.
    targets = [leg.targets for leg in (*mission.legs, own)]
    ends = np.concatenate([mission.initial_states, *targets])
    x = np.stack([ends, ends], axis=1)
    u = np.broadcast_to(mission.largest_control, (len(ends), 1, mission.axes))
    return 4 * interpolation_error(mission.linear_model, x, u, h)


def _relaxation_events(
    mission: Reconfiguration, planners: dict[int, Planner], unreachable: list[int]
) -> list[Event]:
    tolerance = FEASIBILITY_TOLERANCE * mission.least_separation
    slack = {i: p.slack for i, p in planners.items() if p.slack > tolerance}
    failed = [i for i, p in planners.items() if p.has_failed]
    astray = {
        *unreachable,
        *failed,
        *(i for i, p in planners.items() if _misses_target(mission, p)),
    }
    beyond = "the target is out of reach in the time that is left"
    blocked = "no trajectory keeps clear of agents with priority"
    events: list[Event] = [
        {"kind": "slack", "agents": list(slack), "amount_m": list(slack.values())},
        {"kind": "braked", "agents": [i for i in planners if i in astray]},
        {"kind": "infeasible", "agents": unreachable, "what": beyond},
        {"kind": "infeasible", "agents": failed, "what": blocked},
    ]
    return [event for event in events if event["agents"]]


def _misses_target(mission: Reconfiguration, planner: Planner) -> bool:
    d, error = mission.axes, np.abs(planner.nominal.x[-1] - planner.target_state)
    is_far = (error[:d] > mission.position_tolerance).any()
    is_fast = (error[d:] > mission.velocity_tolerance).any()
    return planner.terminal_error > 0 and bool(is_far or is_fast)
