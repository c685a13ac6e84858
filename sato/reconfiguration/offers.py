"""Offers: trajectories to which agents may commit, each of which ends at rest within reach."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import is_path_clear
from problems.path_separation import enclosing_balls
from sato.reconfiguration import stopping
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.passive_safety import OfferedDrifts
from sato.reconfiguration.plan import Plan, Plans
from sato.reconfiguration.state import DecisionContext
from sato.scp.planner import reaches_target

NEGLIGIBLE = 1e-9  # of the largest control: what is less is rounding
MAX_PLAN_STEPS = 16  # of what is foreseen, to which agents commit at once


@dataclass(frozen=True, eq=False)
class ByChoice:
    """Paths or controls by agent and choice, each kept once, and only until it comes to rest."""

    length: int  # in pieces or steps, over which they are returned
    parts: tuple[Float[Array, "_ _ ..."], ...]  # of equal lengths
    part: Int[Array, " entries"]  # of each entry
    place: Int[Array, " entries"]  # in that part
    index: Int[Array, "agents choices"]  # of the entry of each choice

    def __getitem__(self, place: tuple[Any, ...]) -> Float[Array, "..."]:
        agent, choice, *rest = place
        asked = np.asarray(self.index[agent, choice])
        entry = asked.ravel()
        found = np.empty((len(entry), self.length, *self.parts[0].shape[2:]))
        for number, part in enumerate(self.parts):
            (some,) = np.nonzero(self.part[entry] == number)
            own = part[self.place[entry[some]]]
            found[some, : own.shape[1]], found[some, own.shape[1] :] = own, own[:, -1:, -1:]
        found = found.reshape(*asked.shape, *found.shape[1:])
        return np.asarray(found[(*[slice(None)] * asked.ndim, *rest)])


Boxes = tuple[Float[Array, "k d"], Float[Array, "k d"]]  # lowest and highest coordinates


class Offers(NamedTuple):
    """Trajectories that agents may commit to, the best first, the committed ones last."""

    agents: Int[Array, " agents"]
    plan_steps: tuple[int, ...]  # steps of the plan with which each choice begins, 0 for the last
    steps: Int[Array, " agents"]  # in which all choices of each agent have come to rest, and one
    horizon: AvoidanceHorizon  # the most of these
    u: Float[Array, "agents choices T m"] | ByChoice
    paths: Float[Array, "agents choices pieces 4 d"] | ByChoice
    is_allowed: Bool[Array, "agents choices"]
    clearance: Float[Array, " agents"]  # that two of each kind keep [m]
    drifts: OfferedDrifts | None = None  # where agents are to be passively safe
    boxes: Boxes | None = None  # about all choices of each agent

    def enclose(self) -> tuple[Float[Array, "agents d"], Float[Array, " agents"]]:
        """Return the center and the radius of a ball about all choices of each agent."""
        if self.boxes is None:
            return enclosing_balls(self.paths[:, :])
        low, high = self.boxes
        return (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2

    def count_own_steps(
        self, rows: Int[Array, " k"], choices: Int[Array, " k"]
    ) -> Int[Array, " k"]:
        """Count the steps of choices in which they do not follow the plan."""
        return np.asarray(np.maximum(self.steps[rows] - np.array(self.plan_steps)[choices], 0))

    @property
    def last(self) -> int:
        """Choice of the committed trajectory."""
        return len(self.plan_steps) - 1

    @property
    def held_paths(self) -> Float[Array, "agents pieces 4 d"]:
        """Paths to which agents have committed already."""
        rows = np.arange(len(self.agents))
        return self.paths[rows, np.full(len(rows), self.last)]


def make_offers(context: DecisionContext, plans: Plans, committed: stopping.Commitments) -> Offers:
    """Make the offers of the agents that have planned.

    An agent that has not committed to anything stops at once.
    """
    mission, plan_steps = context.mission, _plan_steps(context)
    controls, index, is_begun = _list_controls(context, plans, committed, plan_steps)
    if around := context.surroundings:
        escapes = np.array([around.escape_steps(mission, i) for i in plans])[controls.row]
        controls = controls._replace(length=_add_rest(mission, controls, escapes))
    # An agent that has no steps left needs some to return to its target.
    lengths = np.maximum(mission.horizon_steps, controls.length)
    agents, steps = np.array(list(plans)), 1 + lengths[index].max(axis=1)
    horizon = stopping.stopping_horizon(mission, int(steps.max()))
    u = stopping.add_steps(controls.u, horizon.steps)
    start = context.state[agents[controls.row]]
    paths, is_near, (low, high) = _fly(mission, horizon, start, u, index)
    is_allowed = is_near[index] & is_begun
    is_allowed &= _avoids_obstacles(context, horizon, agents, steps, paths, is_allowed)
    # Fewer steps than until the next decision are for those that cannot stop within reach.
    is_whole = np.array(plan_steps) >= steps_to_next(context)
    has_whole = np.asarray(is_allowed[:, is_whole].any(axis=1))
    is_allowed &= is_whole | ~has_whole[:, None]
    is_allowed[:, -1] = True
    clearance = mission.own_clearances(horizon.clearance, agents)
    for row, (i, plan) in enumerate(plans.items()):
        own = plan.trajectory
        if len(own.u) == 0:  # one that is late, or has drifted, takes a turn
            is_allowed[row, :-1] &= reaches_target(own, rest_at_target(context, i), clearance[row])
    first, each = np.zeros_like(controls.row), np.arange(len(u))
    chosen = ByChoice(horizon.steps, (u,), first, each, index), paths, is_allowed, clearance
    boxes = low[index].min(axis=1), high[index].max(axis=1)
    return Offers(agents, plan_steps, steps, horizon, *chosen, boxes=boxes)


def _fly(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    start: Float[Array, "entries n"],
    u: Float[Array, "entries T m"],
    index: Int[Array, "agents choices"],
) -> tuple[ByChoice, Bool[Array, " entries"], Boxes]:
    """Return paths, True for what stays within reach, and boxes about each.

    A trajectory that soon comes to rest is flown until then alone.
    """
    parts, part_of, place = list[Array](), *np.empty((2, len(u)), dtype=int)
    low, high = np.empty((2, len(u), mission.axes))
    is_near, moving = np.empty(len(u), dtype=bool), stopping.count_moving_steps(u)
    most, first = 1, -1
    while first < horizon.steps:
        some = np.flatnonzero((moving > first) & (moving <= most))
        if len(some):
            own = stopping.stopping_horizon(mission, most)
            controls = stopping.add_steps(u[some, :most], most)
            x = own.discrete_model.simulate(start[some], controls)
            part = own.control_points(x, controls)
            is_near[some] = stopping.stays_within_reach(mission, own, x, part)
            low[some], high[some] = stopping.bounding_boxes(part)
            part_of[some], place[some] = len(parts), np.arange(len(some))
            parts.append(part[:, : len(horizon.fine_model)])
        first, most = most, 2 * most
    pieces = len(horizon.fine_model)
    return ByChoice(pieces, tuple(parts), part_of, place, index), is_near, (low, high)


def _add_rest(
    mission: Reconfiguration, controls: "OfferedControls", steps: Int[Array, " entries"]
) -> Int[Array, " entries"]:
    """Return the lengths of controls with so many steps of rest after all that are no rounding.

    Before these there are as many steps at least, in which an agent may get out of the way.
    """
    least = NEGLIGIBLE * float(mission.largest_control.max())
    moving = stopping.count_moving_steps(np.where(np.abs(controls.u) < least, 0.0, controls.u))
    longer = np.maximum(controls.length, np.maximum(moving, steps) + steps)
    return np.where(steps > 0, longer, controls.length)


def _avoids_obstacles(
    context: DecisionContext,
    horizon: AvoidanceHorizon,
    agents: Int[Array, " agents"],
    steps: Int[Array, " agents"],
    paths: ByChoice,
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
        known = known and known._replace(paths=known.paths[:, :ahead])
        for choice in np.flatnonzero(is_asked[row]).tolist():
            is_clear[row, choice] = is_path_clear(paths[row, choice, :ahead], known)
    return is_clear


class OfferedControls(NamedTuple):
    """Controls that are offered, each once."""

    row: Int[Array, " entries"]  # of the agent
    u: Float[Array, "entries T m"]  # 0 after the last
    length: Int[Array, " entries"]


def _list_controls(
    context: DecisionContext,
    plans: Plans,
    committed: stopping.Commitments,
    plan_steps: tuple[int, ...],
) -> tuple[OfferedControls, Int[Array, "agents choices"], Bool[Array, "agents choices"]]:
    """List the controls that are offered, and the place in this list of each agent's choices.

    And tell which choices begin with the plan, which is not the case where it leads too far.
    """
    mission, agents = context.mission, np.array(list(plans))
    velocity = context.state[agents, mission.axes :]
    held, held_length = stopping.held_controls(
        mission, agents, velocity, committed, context.instant
    )
    rests, within = _list_rests(context, plans)
    # As many steps of the plan, or all that are left; of equal choices the first.
    steps = np.minimum(plan_steps[:-1], np.array([len(rest) for rest in rests])[:, None])
    is_begun = np.zeros((len(agents), len(plan_steps)), dtype=bool)
    is_begun[:, :-1] = steps < within[:, None]
    is_new = is_begun[:, :-1] & (np.diff(steps, axis=1, prepend=-1) != 0)
    row, choice = np.nonzero(is_new)
    index = np.tile(np.arange(len(agents))[:, None], len(plan_steps))
    latest = len(agents) - 1 + is_new.cumsum().reshape(is_new.shape)
    index[is_begun] = latest[is_begun[:, :-1]]
    begun = stopping.pad_controls(rests)
    for limit, some in mission.group_by_limit(agents):
        begun[some] = limit.cut(begun[some])
    own = agents[row], velocity[row], begun[row], steps[row, choice]
    u, length = stopping.end_at_rest(mission, *own)
    T = max(held.shape[1], u.shape[1])
    both = np.concatenate([stopping.add_steps(held, T), stopping.add_steps(u, T)])
    rows = np.concatenate([np.arange(len(agents)), row])
    return OfferedControls(rows, both, np.concatenate([held_length, length])), index, is_begun


def _list_rests(
    context: DecisionContext, plans: Plans
) -> tuple[list[Float[Array, "left m"]], Int[Array, " agents"]]:
    """Return what is left of new plans, and after how many steps each is too far from here."""
    mission, rests, ways = context.mission, list[Array](), list[Array]()
    for plan in plans.values():
        begin = context.step_index - plan.planned_at
        left = slice(begin, begin if is_kept(context, plan) else None)
        rests.append(plan.trajectory.u[left])
        ways.append(plan.trajectory.x[left, : mission.axes])
    position, length = stopping.pad_controls(ways), np.array([len(way) for way in ways])
    away = position - position[:, :1]
    is_far = np.einsum("akd,akd->ak", away, away) > stopping.longest_way(mission) ** 2
    is_far |= np.arange(position.shape[1]) >= length[:, None]
    return rests, (~is_far).cumprod(axis=1).sum(axis=1)


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
