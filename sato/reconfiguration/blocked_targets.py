"""Blocked targets: those that lost vehicles or obstacles take up, left out by agreement.

Agents of one network bid on the targets that none of them knows to be blocked, in their order, as
if the others stood at the end of the list.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.obstacle_paths import are_places_clear, is_path_clear
from sato.reconfiguration.orbital_commitment import arrive_among
from sato.reconfiguration.planning import divide_horizon
from sato.reconfiguration.state import DecisionContext
from sato.scp.planner import required_separations

AT_REST = 1e-6  # of the radius in a step: what moves more slowly stays where it is


def find_blocked(context: DecisionContext, agent: int) -> Bool[Array, " targets"]:
    """Find the targets that what an agent knows blocks.

    That is what rests too near to a target, or in orbit drifts too near to the bounded motion of
    the target, once that begins.
    """
    mission, around, targets = context.mission, context.surroundings, context.leg.targets
    blocked = np.zeros(len(targets), dtype=bool)
    if around is None or not around.is_known[agent].any():
        return blocked
    d = mission.axes
    if not mission.is_point_mass:
        left = context.leg.steps - int(context.memory.clock[agent])
        states, known = arrive_among(context, agent, max(1, left))
        paths, clearance = states, required_separations(known.clearance)
        wide = known._replace(clearance=clearance)
        return np.array([not is_path_clear(path, wide) for path in paths])
    horizon = divide_horizon(mission, context.time, 1)
    known = around.known_to(mission, agent, around.fly(mission, horizon), horizon.clearance)
    assert known is not None
    speed = np.linalg.norm(known.velocity, axis=1)
    known = known.select(speed * mission.step <= AT_REST * mission.least_separation)
    if len(known.paths):
        wide = known._replace(clearance=required_separations(known.clearance))
        blocked |= ~are_places_clear(targets[:, :d], wide)
    return blocked


def agree_on_blocked(context: DecisionContext) -> Bool[Array, "agents targets"] | None:
    """Find the targets that any agent of each one's component knows to be blocked; None if none."""
    graph = context.graph
    if context.surroundings is None:
        return None
    blocked = np.zeros((len(graph.alive), len(context.leg.targets)), dtype=bool)
    for i in np.flatnonzero(graph.alive).tolist():
        blocked[i] = find_blocked(context, i)
    for c in range(graph.component.max(initial=-1) + 1):
        members = np.flatnonzero(graph.component == c)
        blocked[members] = blocked[members].any(axis=0)
    return blocked if blocked.any() else None


def put_last(blocked: Bool[Array, "*agents targets"]) -> Int[Array, "*agents targets"]:
    """Return the targets in their order, those that are blocked after all others."""
    return np.argsort(blocked, axis=-1, kind="stable")
