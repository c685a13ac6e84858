"""Blocked targets: those that lost vehicles or obstacles take up, left out by agreement.

Agents of one network bid on the targets that none of them knows to be blocked, in their order, as
if the others stood at the end of the list.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.obstacle_paths import ObstaclePaths, is_path_clear
from sato.reconfiguration.free_motion import drift_freely, free_motion
from sato.reconfiguration.orbital_commitment import drift_on
from sato.reconfiguration.orbital_evasion import Flights
from sato.reconfiguration.planning import divide_horizon
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.surroundings import Surroundings
from sato.scp.planner import required_separations


class Places(NamedTuple):
    """Targets as agents would stand there from arrival on, and all that does not decide."""

    paths: Float[Array, "targets pieces 4 d"]
    others: ObstaclePaths | None  # without clearances
    clearance: float  # that any two vehicles keep [m]


def find_places(context: DecisionContext, around: Surroundings, steps: int, escape: int) -> Places:
    """Return the places that agents would take up after some steps.

    In orbit they move on with their targets, and elsewhere they rest. For `escape` steps after
    that they could get out of the way of what moves.
    """
    mission, leg, targets = context.mission, context.leg, context.leg.targets
    if mission.is_point_mass:
        horizon = divide_horizon(mission, context.time, steps + max(escape, 1))
        flown, begin = around.fly(mission, horizon), steps * horizon.pieces_per_step
        later = flown and flown.after_pieces(begin)
        shape = len(targets), len(horizon.fine_model) - begin, 4, mission.axes
        here = np.broadcast_to(targets[:, None, None, : mission.axes], shape)
        return Places(horizon.scale_points(here), later, horizon.clearance)
    horizon = divide_horizon(mission, context.time, steps, leg)
    free = free_motion(mission, leg, context.instant + steps)
    flown = drift_on(context, around, Flights(mission, horizon, context.time, *free))
    later = flown and flown.after_pieces(len(horizon.fine_model))
    count, time = len(later.paths[0]) if later else 0, context.time + steps * mission.step
    return Places(drift_freely(mission, targets, count, time, free[1]), later, horizon.clearance)


def find_all_blocked(context: DecisionContext) -> Bool[Array, "agents targets"] | None:
    """Find the targets that each agent knows to be blocked; None if none, or if they are given.

    At these it would come too near to what it knows.
    """
    graph, clock, around = context.graph, context.memory.clock, context.surroundings
    mission, places = context.mission, dict[tuple[int, int], Places]()
    if around is None or mission.assignment == "given":
        return None
    blocked = np.zeros((len(graph.alive), len(context.leg.targets)), dtype=bool)
    for i in np.flatnonzero(graph.alive).tolist():
        when = max(1, context.leg.steps - int(clock[i])), around.escape_steps(mission, i)
        if when not in places:
            places[when] = find_places(context, around, *when)
        paths, others, clearance = places[when]
        known = around.known_to(mission, i, others, clearance)
        if known is not None:
            wide = known._replace(clearance=required_separations(known.clearance))
            blocked[i] = [not is_path_clear(path, wide) for path in paths]
    return blocked if blocked.any() else None


def order_targets(
    count: Int[Array, "*agents"], blocked: Bool[Array, "*agents targets"]
) -> tuple[Int[Array, "*agents targets"], Int[Array, "*agents"]]:
    """Return the targets in the order in which agents bid on them, and on how many.

    Those that are blocked come last.
    """
    open_count = np.maximum((~blocked).sum(axis=-1), 1)
    order = np.argsort(blocked, axis=-1, kind="stable")
    return order, np.asarray(np.minimum(count, open_count))
