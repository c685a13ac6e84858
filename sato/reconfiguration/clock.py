"""Clocks of vehicles with given targets: how far they go back, and for whom others wait."""

from bisect import bisect_left
from math import ceil

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

from sato.reconfiguration.pair_reach import farthest
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.stopping import held_controls

TIME_FACTOR = 1.5  # over the time that a late vehicle takes alone


def set_back(context: DecisionContext, is_late: Bool[Array, " agents"]) -> Int[Array, " agents"]:
    """Return the clocks, set back for vehicles that are late.

    These cannot arrive in the time that is left. Where plans are kept, each has the time in which
    it stops and flies to its target, and a half more; elsewhere that of the whole leg.
    """
    clock, steps = np.where(is_late, 0, context.memory.clock), context.leg.steps
    if context.mission.has_own_clocks:
        for i in np.flatnonzero(is_late).tolist():
            clock[i] = max(0, steps - ceil(TIME_FACTOR * _count_steps(context, i)))
    return np.asarray(clock)


def announce_clock(
    is_due: Bool[Array, " agents"], clock: Int[Array, " agents"], steps: int
) -> Int[Array, " agents"]:
    """Return the clocks for which others wait: of those on their way that are due to plan again."""
    return np.where(is_due & (clock > 0), clock, steps)


def wait(
    context: DecisionContext, heard: Int[Array, " agents"], has_plan: Bool[Array, " agents"]
) -> Int[Array, " agents"]:
    """Return the clocks, set back for vehicles that wait.

    Where plans are kept, those that have arrived take the one for which they wait, so that they can
    make room for others and return. Those that have found no way to their targets do not lose the
    time until they look again. In orbit, where targets move on, all take the one for which they
    wait, so that they arrive together. That is the clock with the most time left of those that plan
    again in each one's component, as it is heard.
    """
    clock, mission, steps = context.memory.clock, context.mission, context.leg.steps
    later = np.minimum(heard, clock)
    if mission.has_own_clocks:
        later = np.where(clock == steps, later, clock)
        later = np.where(has_plan, later, np.maximum(clock - mission.assignment_steps, 0))
    elif mission.is_point_mass:
        return clock
    return np.where(context.graph.alive, later, clock)


def _count_steps(context: DecisionContext, agent: int) -> int:
    """Count the steps in which an agent stops and flies straight to its target."""
    mission, steps, d = context.mission, context.leg.steps, context.mission.axes
    state, target = context.state[agent], context.leg.targets[agent]
    if target[d:].any():
        return steps
    control, speed = mission.planned_control_limit(agent), mission.planned_speed_limit(agent)
    (stop,), _ = held_controls(mission, np.array([agent]), state[None, d:], {}, 0)
    model = mission.discretize(len(stop))
    way = target[:d] - model.simulate(state, stop)[-1, :d]
    far = np.linalg.norm(way)
    unit = way / far if far > 0 else np.eye(d)[0]
    strength, fastest = (np.asarray(one.most / one.measure(unit)) for one in (control, speed))

    def fly(count: int) -> float:
        return float(farthest(strength, count, mission.step, fastest))

    return len(stop) + bisect_left(range(steps), float(far), key=fly)
