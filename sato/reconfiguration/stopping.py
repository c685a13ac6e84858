"""Stopping trajectories of double integrators, which are safe for ever once they are clear.

A committed trajectory ends at rest. Later points of it are at most (R_comm − R)/2 from earlier
instants, so that two vehicles that do not hear each other cannot meet before they do.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.callbacks import CallbackError
from dynamics.model import StateSamples
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
TOO_FAST = 100  # times the speed limit: a stop from there is not looked for


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
    control, live = np.full((len(alive), mission.axes), np.nan), np.flatnonzero(alive)
    control[live] = 0.0
    for i in live.tolist():
        ahead = committed[i].controls_from(step)
        if len(ahead):
            control[i] = ahead[0]
    for limit, rows in mission.group_by_limit(live):
        control[live[rows]] = limit.cut(control[live[rows]])
    return control


def count_stop_steps(limit: Limit, velocity: Float[Array, "*k m"], h: float) -> Int[Array, "*k"]:
    """Count the steps in which double integrators come to rest at once, the fewest."""
    steps = limit.measure(velocity) / (limit.most * h)
    return np.where(steps < REST_TOLERANCE, 0, np.ceil(steps * (1 - 1e-9))).astype(int)


def end_at_rest(
    mission: Reconfiguration,
    agents: Int[Array, " each"],
    velocity: Float[Array, "each m"],
    u: Float[Array, "each _ m"],
    steps: Int[Array, " each"],
) -> tuple[Float[Array, "each T m"], Int[Array, " each"]]:
    """Let double integrators stop at once after some steps of controls.

    The velocities are those before the first step [m/s]. Controls are 0 after the last of each,
    and come with how many each has.
    """
    h, row = mission.step, np.arange(len(agents))
    gained = np.concatenate([np.zeros_like(velocity)[:, None], u.cumsum(axis=1)], axis=1)
    left, count = velocity + h * gained[row, steps], np.zeros(len(agents), dtype=int)
    for limit, rows in mission.group_by_limit(agents):
        count[rows] = count_stop_steps(limit, left[rows], h)
    length, k = steps + count, np.arange(int((steps + count).max(initial=0)))
    found = np.zeros((len(agents), len(k), mission.axes))
    begun = k[: u.shape[1]] < steps[:, None]
    found[:, : u.shape[1]] = np.where(begun[..., None], u[:, : len(k)], 0.0)
    stops = (k >= steps[:, None]) & (k < length[:, None])
    found[stops] = np.repeat(-left / (np.maximum(count, 1) * h)[:, None], count, axis=0)
    return found, length


def committed_controls(
    mission: Reconfiguration, agent: int, committed: Commitments, instant: int
) -> Float[Array, "T m"]:
    """Return the controls that an agent has committed to, from an instant on; none without."""
    if agent not in committed:
        return np.zeros((0, mission.axes))
    return committed[agent].controls_from(instant)


def held_controls(
    mission: Reconfiguration,
    agents: Int[Array, " each"],
    velocity: Float[Array, "each m"],
    committed: Commitments,
    instant: int,
) -> tuple[Float[Array, "each T m"], Int[Array, " each"]]:
    """Return what agents fly if they do not decide again; one without a commitment stops.

    A speed that noise has left is lost as soon as the committed controls end. Controls are 0 after
    the last of each, and come with how many each has.
    """
    speed = np.linalg.norm(velocity, axis=1)
    if len(speed) and speed.max() > TOO_FAST * mission.top_speeds.max():
        reason = f"agent {agents[speed.argmax()]} flies at {speed.max():.3g} m/s"
        cure = f"over {TOO_FAST} times model.max_speed_m_s; a plant and states in SI units would do"
        raise CallbackError("", f"{reason}, {cure}")
    each = [committed_controls(mission, i, committed, instant) for i in agents.tolist()]
    held = pad_controls(each)
    u, length = end_at_rest(mission, agents, velocity, held, count_moving_steps(held))
    length = np.maximum(length, [len(own) for own in each])
    return add_steps(u, int(length.max(initial=0))), length


def count_moving_steps(u: Float[Array, "*k T m"]) -> Int[Array, "*k"]:
    """Count the steps of controls up to the last that is not 0."""
    return np.asarray((u.any(axis=-1) * np.arange(1, u.shape[-2] + 1)).max(axis=-1, initial=0))


def add_steps(u: Float[Array, "each _ m"], steps: int) -> Float[Array, "each T m"]:
    """Return controls over so many steps, 0 in those that are added."""
    return np.pad(u, ((0, 0), (0, steps - u.shape[1]), (0, 0)))


def pad_controls(
    each: Sequence[Float[Array, "_ m"]], steps: int | None = None
) -> Float[Array, "each T m"]:
    """Stack controls, with zeros up to so many steps, or up to those of the longest."""
    if steps is None:
        steps = max(map(len, each), default=0)
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
    x: StateSamples,
    paths: Float[Array, "*k pieces 4 d"],
) -> Bool[Array, "*k"]:
    """Find the trajectories on which no later point is too far from an earlier instant.

    Two that do not hear each other then cannot meet before both have decided again.
    """
    reach, position = longest_way(mission), x[..., : mission.axes]
    # Most trajectories lie in a small box, or lead too far from where they begin.
    paths = horizon.unscale_points(paths)
    low, high = bounding_boxes(paths)
    size = np.linalg.norm(high - low, axis=-1)
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


def bounding_boxes(
    paths: Float[Array, "*k pieces 4 d"],
) -> tuple[Float[Array, "*k d"], Float[Array, "*k d"]]:
    """Return the lowest and the highest coordinates of control points [m]."""
    axes = [paths[..., axis] for axis in range(paths.shape[-1])]  # each by itself is far faster
    low, high = ([f(own, axis=(-2, -1)) for own in axes] for f in (np.min, np.max))
    return np.stack(low, axis=-1), np.stack(high, axis=-1)


class Avoided(NamedTuple):
    """Others and obstacles of which a stopping trajectory has to be clear."""

    others: Float[Array, "others pieces 4 d"]  # control points over the horizon
    clearance: Float[Array, " others"]  # to keep from each [m]
    obstacles: ObstaclePaths | None
    rest_steps: int = 0  # at the end of the horizon, for which the vehicle rests already


def find_stop(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    agent: int,
    start: Float[Array, " n"],
    wanted: Float[Array, " n"],
    wanted_step: int,
    nominal: Float[Array, "pieces 4 d"],
    avoided: Avoided,
    solver: Solver = solve_program,
    side: convexify.PassingSide = "same",
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
        avoided: Others and obstacles.
        solver: Solver of the program.
        side: Side on which to pass others that the nominal meets.

    Returns:
        Controls, states and control points; None where none is found.
    """
    others, clearance, obstacles, rest_steps = avoided
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
