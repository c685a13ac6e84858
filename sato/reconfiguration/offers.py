"""Offers: trajectories to which agents may commit, each of which ends at rest within reach."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import is_path_clear
from sato.reconfiguration.passive_safety import OfferedDrifts
from sato.reconfiguration.plan import Plan, Plans
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.stopping import (
    Commitments,
    end_at_rest,
    held_controls,
    longest_way,
    pad_controls,
    stays_within_reach,
    stopping_horizon,
    trim_rest,
)
from sato.scp.planner import reaches_target

NEGLIGIBLE = 1e-9  # of the largest control: what is less is rounding
MAX_PLAN_STEPS = 16  # of what is foreseen, to which agents commit at once


class Offers(NamedTuple):
    """Trajectories that agents may commit to, the best first, the committed ones last."""

    agents: Int[Array, " agents"]
    plan_steps: tuple[int, ...]  # steps of the plan with which each choice begins, 0 for the last
    steps: Int[Array, " agents"]  # in which all choices of each agent have come to rest, and one
    horizon: AvoidanceHorizon  # the most of these
    u: Float[Array, "agents choices T m"]
    paths: Float[Array, "agents choices pieces 4 d"]
    is_allowed: Bool[Array, "agents choices"]
    clearance: Float[Array, " agents"]  # that two of each kind keep [m]
    drifts: OfferedDrifts | None = None  # where agents are to be passively safe

    @property
    def last(self) -> int:
        """Choice of the committed trajectory."""
        return len(self.plan_steps) - 1


def make_offers(context: DecisionContext, plans: Plans, committed: Commitments) -> Offers:
    """Make the offers of the agents that have planned.

    Args:
        context: States and time of the agents that decide.
        plans: Their plans.
        committed: Committed trajectories; an agent without one stops at once.
    """
    mission, plan_steps = context.mission, _plan_steps(context)
    each, owner, index, is_begun = _list_controls(context, plans, committed, plan_steps)
    if around := context.surroundings:
        escapes = [around.escape_steps(mission, i) for i in owner]
        least = NEGLIGIBLE * float(mission.largest_control.max())
        each = [_rest_after(u, k, least) if k else u for u, k in zip(each, escapes, strict=True)]
    # An agent that has no steps left needs some to return to its target.
    lengths = np.maximum(mission.horizon_steps, [len(u) for u in each])
    agents, steps = np.array(list(plans)), 1 + lengths[index].max(axis=1)
    horizon = stopping_horizon(mission, int(steps.max()))
    controls = pad_controls(each, horizon.steps)
    x = horizon.discrete_model.simulate(context.state[owner], controls)
    points = horizon.control_points(x, controls)
    is_near = stays_within_reach(mission, horizon, x[..., : mission.axes], points)
    u, paths, is_allowed = controls[index], points[index], is_near[index] & is_begun
    is_allowed &= _avoids_obstacles(context, horizon, agents, steps, paths, is_allowed)
    # Fewer steps than until the next decision are for those that cannot stop within reach.
    is_whole = np.array(plan_steps) >= steps_to_next(context)
    has_whole = np.asarray(is_allowed[:, is_whole].any(axis=1))
    is_allowed &= is_whole | ~has_whole[:, None]
    is_allowed[:, -1] = True
    clearance = mission.own_clearances(horizon.clearance, agents)
    for row, (i, plan) in enumerate(plans.items()):
        is_over = len(plan.trajectory.u) == 0
        is_late = is_over and not reaches_target(
            plan.trajectory, rest_at_target(context, i), clearance[row]
        )
        if is_late:  # it is late, or has drifted: it takes a turn
            is_allowed[row, :-1] = False
    return Offers(agents, plan_steps, steps, horizon, u, paths, is_allowed, clearance)


def _rest_after(u: Float[Array, "T m"], steps: int, least: float) -> Float[Array, "_ m"]:
    """Return controls, and so many steps of rest after all that are not less than a number.

    Before these there are as many steps at least, in which an agent may get out of the way.
    """
    moving, (T, m) = trim_rest(np.where(np.abs(u) < least, 0.0, u)), u.shape
    return np.concatenate([u, np.zeros((max(max(len(moving), steps) + steps - T, 0), m))])


def _avoids_obstacles(
    context: DecisionContext,
    horizon: AvoidanceHorizon,
    agents: Int[Array, " agents"],
    steps: Int[Array, " agents"],
    paths: Float[Array, "agents choices pieces 4 d"],
    is_asked: Bool[Array, "agents choices"],
) -> Bool[Array, "agents choices"]:
    """Find the offers that are clear of all that an agent knows."""
    is_clear = np.ones(is_asked.shape, dtype=bool)
    around = context.surroundings
    if around is None:
        return is_clear
    flown = around.fly(context.mission, horizon)
    for row, i in enumerate(agents.tolist()):
        known = around.known_to(context.mission, i, flown, horizon.clearance)
        ahead = int(steps[row]) * horizon.pieces_per_step
        known = known and known.until_piece(ahead)
        for choice in np.flatnonzero(is_asked[row]).tolist():
            is_clear[row, choice] = is_path_clear(paths[row, choice, :ahead], known)
    return is_clear


def _list_controls(
    context: DecisionContext, plans: Plans, committed: Commitments, plan_steps: tuple[int, ...]
) -> tuple[list[Array], list[int], Int[Array, "agents choices"], Bool[Array, "agents choices"]]:
    """List the controls that are offered, each once.

    Returns:
        Controls; the agent of each; the place in this list of each agent's choices; and True for
        choices that begin with the plan, which is not the case where it leads too far.
    """
    mission, each, owner = context.mission, list[Array](), list[int]()
    index = np.empty((len(plans), len(plan_steps)), dtype=int)
    is_begun, farthest = np.zeros(index.shape, dtype=bool), longest_way(mission)
    for row, (i, plan) in enumerate(plans.items()):
        velocity, limit = context.state[i, mission.axes :], mission.planned_control_limit(i)
        index[row] = len(each)
        each.append(held_controls(mission, i, velocity, committed, context.instant))
        if not is_kept(context, plan):
            rest = limit.cut(plan.controls_from(context.step_index))
            lengths = [min(q, len(rest)) for q in plan_steps[:-1]]
            within = _steps_within_reach(context, plan, farthest)
            begun = sorted({q for q in lengths if q < within})
            place = {q: len(each) + n for n, q in enumerate(begun)}
            for choice, q in enumerate(lengths):
                if q in place:
                    index[row, choice], is_begun[row, choice] = place[q], True
            each += [end_at_rest(limit, velocity, rest[:q], mission.step) for q in place]
        owner += [i] * (len(each) - len(owner))
    return each, owner, index, is_begun


def _steps_within_reach(context: DecisionContext, plan: Plan, farthest: float) -> int:
    """Return after how many steps a plan is farther from where it is now [m]."""
    mission, k = context.mission, context.step_index - plan.planned_at
    away = plan.trajectory.x[k:, : mission.axes] - plan.trajectory.x[k, : mission.axes]
    is_far = np.einsum("kd,kd->k", away, away) > farthest**2
    return int(is_far.argmax()) if is_far.any() else len(away)


def rest_at_target(context: DecisionContext, agent: int) -> Float[Array, " n"]:
    """Return the state of rest at the target that an agent holds."""
    rest = context.leg.targets[context.memory.target_index[agent]].copy()
    rest[context.mission.axes :] = 0.0
    return np.asarray(rest)


def _plan_steps(context: DecisionContext) -> tuple[int, ...]:
    # As far as avoidance looked or plans are kept, or until the next decision, or less.
    mission, period = context.mission, steps_to_next(context)
    foreseen = min(mission.foresight, MAX_PLAN_STEPS) if mission.flies_model else 0
    longest = max(period, mission.horizon_steps, mission.freeze_steps, foreseen)
    halves = [period >> n for n in range(period.bit_length())]
    if mission.keeps_plans:
        whole = context.leg.steps
        halves = [whole >> n for n in range(whole.bit_length()) if whole >> n > period] + halves
        longest = whole
    return (*dict.fromkeys([longest, *halves]), 0)


def steps_to_next(context: DecisionContext) -> int:
    """Return the steps until the agents decide again, at the latest."""
    period = context.mission.replan_steps
    return period - context.step_index % period


def is_kept(context: DecisionContext, plan: Plan) -> bool:
    """Tell whether a plan is one of an earlier decision, which is flown to its end."""
    return plan.planned_at < context.step_index
