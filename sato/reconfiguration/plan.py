"""Plans of the agents: how long each is kept, and when an agent plans again."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.model import ControlSamples
from problems.transfer import Trajectory, compute_energy, compute_fuel
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import DecisionContext
from sato.scp import FEASIBILITY_TOLERANCE
from sato.scp.planner import Priority

MAX_WAIT = 8  # periods of planning after which an agent without a way looks again


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


def is_planning_due(context: DecisionContext, plans: Plans) -> Bool[Array, " agents"]:
    """Find the agents that plan again: all but those about to arrive, by a plan clear to its end.

    Those that have arrived do so too where noise may take them from their targets.
    """
    mission, k, left = context.mission, context.step_index, context.leg.steps - context.memory.clock
    is_kept = (left < mission.freeze_steps) | mission.keeps_plans
    deviates = mission.is_point_mass and mission.has_noise and mission.tracking is None
    is_over = (left == 0) & (not deviates)
    for i in np.flatnonzero(is_kept).tolist():
        if mission.has_own_clocks and _waits(mission, plans.get(i), k):
            continue
        has_plan = remaining_controls(context, plans, i) is not None
        is_kept[i] = has_plan and (is_over[i] or _is_clear(mission, plans[i], k, int(left[i])))
    return np.asarray(~is_kept)


def is_auction_due(context: DecisionContext, plans: Plans) -> Bool[Array, " agents"]:
    """Find the agents that call for an auction when they plan again.

    Those without a plan to their targets, where plans are kept and targets are assigned by auction;
    elsewhere all, every so many steps.
    """
    mission, each = context.mission, range(len(context.memory.clock))
    if not bids_on_change(mission):
        return np.full(len(each), context.step_index % mission.assignment_steps == 0)
    return np.array([remaining_controls(context, plans, i) is None for i in each])


def bids_on_change(mission: Reconfiguration) -> bool:
    """Tell whether agents bid only where it is called for, or where their network has changed."""
    return mission.keeps_plans and mission.assignment == "auction"


def has_changed_network(
    claim_step: Int[Array, "agents agents"], is_beside: Bool[Array, "agents agents"]
) -> Bool[Array, " agents"]:
    """Find the agents whose network is not the one that they decided in last.

    Each knows the step of the latest claim of each other, −1 for never. `is_beside` is True for the
    others in the network of each, and for itself.
    """
    own = claim_step.diagonal()[:, None]
    was_beside = claim_step == own  # all of a network claim in the same step
    return np.asarray((own[:, 0] >= 0) & (was_beside != is_beside).any(axis=1))


def have_decided_apart(
    claim_step: Int[Array, "agents agents"], graph: CommunicationGraph
) -> Bool[Array, " agents"]:
    """Find the agents that did not decide together last with all of their component.

    Over a network, some may have got through a decision, and others not.
    """
    own = np.asarray(claim_step.diagonal())
    latest, first = graph.component_max(own), -graph.component_max(-own)
    return np.asarray(graph.alive & (latest != first))


def _is_clear(mission: Reconfiguration, plan: Plan, k: int, left: int) -> bool:
    # To its end; or, where it is replaced before that, for as long as it has been flown.
    ahead = min(left, k - plan.planned_at + 1) if mission.keeps_plans else left
    return k + ahead <= plan.clear_until


def _waits(mission: Reconfiguration, plan: Plan | None, k: int) -> bool:
    # The more often an agent has found no way, the longer it waits before it looks again.
    if plan is None or plan.target_index is not None or mission.has_surroundings:
        return False
    periods = min(plan.failure_count, MAX_WAIT)
    return k < plan.planned_at + periods * mission.replan_steps


def give_up_missed(context: DecisionContext, plans: Plans) -> Plans:
    """Give up plans that would be kept, but from which their agents have strayed.

    No agent of a mission without noise strays, but one may fly in a world that is not as modeled.
    """
    mission = context.mission
    if not mission.keeps_plans:
        return plans
    allowed, found = FEASIBILITY_TOLERANCE * mission.least_separation, dict(plans)
    for i, plan in plans.items():
        x = plan.trajectory.x[min(context.step_index - plan.planned_at, len(plan.trajectory.u))]
        if plan.target_index is not None and np.abs(context.state[i] - x).max() > allowed:
            found[i] = plan._replace(target_index=None)
    return found


def is_held(context: DecisionContext, plans: Plans, i: int) -> bool:
    """Tell whether an agent holds on to its plan while others decide.

    It does where that is clear to its end; one that rests at its target makes room.
    """
    if not context.mission.keeps_plans:
        return False
    u, k = remaining_controls(context, plans, i), context.step_index
    return u is not None and bool(u.any()) and k + len(u) <= plans[i].clear_until


def remaining_controls(
    context: DecisionContext, plans: Plans, i: int
) -> Float[Array, "T m"] | None:
    """Return the rest of an agent's controls, if they reach its target on its clock."""
    plan, memory = plans.get(i), context.memory
    if plan is None or plan.target_index != memory.target_index[i]:
        return None
    u = plan.controls_from(context.step_index)
    return u if len(u) == context.leg.steps - memory.clock[i] else None


def remaining_cost(plans: Plans, context: DecisionContext) -> Float[Array, " agents"]:
    """Return the fuel or energy left in each plan; infinite where none reaches the target."""
    cost = np.full(len(context.state), np.inf)
    for i in plans:
        u = remaining_controls(context, plans, i)
        if u is not None:
            cost[i] = compute_spent(context.mission, u)
    return cost


def compute_spent(mission: Reconfiguration, u: ControlSamples) -> Float[Array, "*agents"] | float:
    """Compute the fuel [m/s] or energy [m²/s³] of controls, after the mission's objective."""
    if mission.objective == "energy":
        return compute_energy(u, mission.step)
    return compute_fuel(u, mission.step, mission.fuel_norm)
