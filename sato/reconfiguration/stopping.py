"""Stopping trajectories of double integrators, which are safe for ever once they are clear.

A committed trajectory ends at rest. Later points of it are at most (R_comm − R)/2 from earlier
instants, so that two vehicles that do not hear each other cannot meet before they do.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems import convexify
from problems.conic import Unsolved
from problems.convexify import AvoidanceHorizon
from problems.limit import Limit
from problems.obstacle_paths import ObstaclePaths, choose_half_spaces
from problems.safety_filter import SafetyFilterProblem
from problems.solvers.verified import solve_program
from problems.transfer import Solver
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import divide_horizon
from sato.scp.planner import required_separations

REST_TOLERANCE = 1e-12  # of the speed that a step at full control makes: slower is at rest
REACH_TOLERANCE = 1e-9  # relative


class Commitment(NamedTuple):
    """Controls that an agent flies until it commits to others; after them it rests."""

    first_step: int  # since the start of the mission
    u: Float[Array, "T m"]

    def controls_from(self, step: int) -> Float[Array, "left m"]:
        """Return the controls from a step of the mission on."""
        return self.u[step - self.first_step :]


Commitments = dict[int, Commitment]  # by the number of the agent


def controls_at(
    committed: Commitments, step: int, alive: Bool[Array, " agents"], mission: Reconfiguration
) -> Float[Array, "agents m"]:
    """Return the controls at a step of the mission: 0 after the last, NaN if lost.

    Solvers exceed the limit by rounding, which is cut.
    """
    control = np.full((len(alive), mission.axes), np.nan)
    for i in np.flatnonzero(alive).tolist():
        u = committed[i].controls_from(step)
        control[i] = mission.planned_control_limit(i).cut(u[0]) if len(u) else 0.0
    return control


def stop_at_once(limit: Limit, velocity: Float[Array, " m"], h: float) -> Float[Array, "T m"]:
    """Return equal controls that bring a double integrator to rest, in the fewest steps."""
    steps = float(limit.measure(velocity)) / (limit.most * h)
    count = 0 if steps < REST_TOLERANCE else ceil(steps * (1 - 1e-9))
    u = np.empty((count, len(velocity)))
    u[:] = -velocity / (max(count, 1) * h)
    return u


def end_at_rest(
    limit: Limit, velocity: Float[Array, " m"], u: Float[Array, "k m"], h: float
) -> Float[Array, "T m"]:
    """Return controls, and those that then stop a double integrator, from a velocity on."""
    return np.concatenate([u, stop_at_once(limit, velocity + h * u.sum(axis=0), h)])


def committed_controls(
    mission: Reconfiguration, agent: int, committed: Commitments, instant: int
) -> Float[Array, "T m"]:
    """Return the controls that an agent has committed to, from an instant on; none without."""
    if agent not in committed:
        return np.zeros((0, mission.axes))
    return committed[agent].controls_from(instant)


def held_controls(
    mission: Reconfiguration,
    agent: int,
    velocity: Float[Array, " m"],
    committed: Commitments,
    instant: int,
) -> Float[Array, "T m"]:
    """Return what an agent flies if it does not decide again; one without a commitment stops.

    A speed that noise has left is lost as soon as the committed controls end.
    """
    held = committed_controls(mission, agent, committed, instant)
    limit = mission.planned_control_limit(agent)
    u = end_at_rest(limit, velocity, trim_rest(held), mission.step)
    return np.concatenate([u, held[len(u) :]])


def trim_rest(u: Float[Array, "T m"]) -> Float[Array, "_ m"]:
    """Return controls without the zeros at their end."""
    return u[: int(np.flatnonzero(u.any(axis=1)).max(initial=-1)) + 1]


def pad_controls(each: Sequence[Float[Array, "_ m"]], steps: int) -> Float[Array, "each T m"]:
    """Stack controls, with zeros up to so many steps."""
    u = np.zeros((len(each), steps, each[0].shape[1]))
    for own, filled in zip(each, u, strict=True):
        filled[: len(own)] = own
    return u


@lru_cache(maxsize=64)
def stopping_horizon(mission: Reconfiguration, steps: int) -> AvoidanceHorizon:
    """Return the horizon of so many steps of a double integrator."""
    return divide_horizon(mission, 0.0, steps)


def longest_way(mission: Reconfiguration) -> float:
    """Return how far a later point may be from an earlier instant, rounding included [m]."""
    return mission.reach_unheard(mission.margin) * (1 + REACH_TOLERANCE)


def stays_within_reach(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    position: Float[Array, "*k instants d"],
    paths: Float[Array, "*k pieces 4 d"],
) -> Bool[Array, "*k"]:
    """Find the trajectories on which no later point is too far from an earlier instant.

    Two that do not hear each other then cannot meet before both have decided again.
    """
    reach = longest_way(mission)
    # Most trajectories lie in a small box, or lead too far from where they begin.
    paths = horizon.unscale_points(paths)
    axes = (paths[..., axis] for axis in range(paths.shape[-1]))  # each by itself is far faster
    size = np.linalg.norm([np.ptp(own, axis=(-2, -1)) for own in axes], axis=0)
    ahead = paths - position[..., :1, None, :]
    away = np.sqrt(np.einsum("...d,...d->...", ahead, ahead).max(axis=(-2, -1)))
    within, is_open = np.asarray(size <= reach), np.asarray((size > reach) & (away <= reach))
    instants, points = position[is_open], paths[is_open]
    farthest = np.zeros(len(points))
    for k in range(1, horizon.steps):
        later = points[:, k * horizon.pieces_per_step :] - instants[:, k, None, None]
        squares = np.einsum("apcd,apcd->apc", later, later)
        farthest = np.maximum(farthest, squares.max(axis=(1, 2)))
    within[is_open] = farthest <= reach**2
    return within


def find_stop(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    agent: int,
    start: Float[Array, " n"],
    wanted: Float[Array, " n"],
    wanted_step: int,
    nominal: Float[Array, "pieces 4 d"],
    others: Float[Array, "others pieces 4 d"],
    clearance: Float[Array, " others"],
    solver: Solver = solve_program,
    side: convexify.PassingSide = "same",
    obstacles: ObstaclePaths | None = None,
    rest_steps: int = 0,
) -> tuple[Float[Array, "T m"], Float[Array, "instants n"], Float[Array, "pieces 4 d"]] | None:
    """Find a stopping trajectory among others, near a wanted state after some steps.

    Args:
        mission: Limits.
        horizon: Horizon in which all have come to rest.
        agent: Number of the agent.
        start: State of the agent.
        wanted: Wanted state.
        wanted_step: Steps after which it is wanted.
        nominal: Control points about which the half-spaces are chosen.
        others: Control points of the others.
        clearance: Distance to keep from each [m].
        solver: Solver of the program.
        side: Side on which to pass others that the nominal meets.
        obstacles: Obstacles over the horizon.
        rest_steps: Steps at the end of the horizon for which the agent rests already.

    Returns:
        Controls, states and control points; None where none is found.
    """
    T = max(horizon.steps - 1 - rest_steps, 1)
    required, count = required_separations(clearance), len(others)
    between = choose_half_spaces(nominal, others, required, obstacles, side)
    half_spaces = convexify.convexify(horizon, T, *between)
    if obstacles is not None:
        rest = convexify.convexify_end(horizon, T, *(part[count:] for part in between))
        half_spaces = half_spaces.join(rest)
    if rest_steps:
        rest = convexify.convexify_end(horizon, T, *(part[:count] for part in between))
        half_spaces = half_spaces.join(rest)
    limit = mission.planned_control_limit(agent)
    transfer = mission.make_transfer(horizon.discrete_model[:T], agent)
    problem = SafetyFilterProblem(transfer, start, wanted, wanted_step, half_spaces, solver)
    try:
        found = problem.solve()
    except Unsolved:
        return None
    # The solver leaves a speed within its tolerance, which the last step takes away.
    last = -found.x[-1, mission.axes :] / mission.step
    if limit.measure(last) > limit.most:
        return None
    u = np.vstack([found.u, last, np.zeros((horizon.steps - T - 1, mission.axes))])
    x = horizon.discrete_model.simulate(start, u)
    return u, x, horizon.control_points(x, u)
