"""Evasion in orbit: trajectories past what comes over both a plan and what an agent flies now.

Nothing rests in orbit. An agent that evades adds to its controls those of least energy that move it
aside where it would come nearest to a body. After that it returns to where it was going, or to a
motion that drifts no more than that would have, or moves on, whichever takes the least energy.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import ControlSamples, StateSamples
from dynamics.trajectory_geometry import hull_distance
from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import ObstaclePaths, are_points_clear, is_path_clear, measure_gaps
from problems.path_separation import are_hulls_separated
from sato.obstacles import spread_directions
from sato.reconfiguration.evasion import ROUNDING
from sato.reconfiguration.free_motion import drift_freely, simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.offers import Offers

DIRECTIONS = {2: 12, 3: 40}  # in which to move aside
SHARES = 0.1, 0.25, 0.5, 1.0, 1.5, 2.0  # of the distance to keep, by which
UNMET = 1e-6  # of a displacement: by how much controls of least energy may miss it
MAX_DETOURS = 40  # for each agent


class Flights(NamedTuple):
    """Trajectories over a horizon, and the free motion after them."""

    mission: Reconfiguration  # model and limits
    horizon: AvoidanceHorizon
    time: float  # at which they begin [s]
    pieces: int  # of the free motion
    duration: float  # of each of these [s]

    def follow(
        self, x: StateSamples, u: ControlSamples, end: Float[Array, "*k n"]
    ) -> Float[Array, "*k pieces 4 d"]:
        """Return control points of trajectories, and of free motion from their ends."""
        later = self.time + self.horizon.steps * self.mission.step
        after = drift_freely(self.mission, end, self.pieces, later, self.duration)
        return np.concatenate([self.horizon.control_points(x, u), after], axis=-3)


class Detours(NamedTuple):
    """Trajectories of an agent past all that it knows, those of least energy first."""

    u: Float[Array, "detours T m"]
    paths: Float[Array, "detours pieces 4 d"]


def list_detours(
    flights: Flights,
    agent: int,
    state: Float[Array, " n"],
    u: Float[Array, "T m"],
    path: Float[Array, "pieces 4 d"],
    known: ObstaclePaths,
) -> Detours:
    """List trajectories that pass all bodies that an agent knows, within its limits.

    They change the controls u, by which the agent would fly the path, to the end of the free
    motion. The bodies are known over as many pieces as the agent looks ahead.
    """
    mission, ahead, d = flights.mission, known.paths.shape[1], flights.mission.axes
    gap = measure_gaps(path[:ahead] - known.paths, known)[0]
    if (gap[:, 0] < known.clearance).any():  # too near already: it leaves by what it flies
        return Detours(np.zeros((0, *u.shape)), np.zeros((0, *path.shape)))
    body, piece = np.unravel_index((gap - known.clearance[:, None]).argmin(), gap.shape)
    each = spread_directions(d, DIRECTIONS[d])
    aside = float(known.clearance[body]) * np.concatenate([share * each for share in SHARES])
    changed = u + np.concatenate(list(_move_aside(flights, int(piece), aside)))
    changed = changed[~mission.planned_control_limit(agent).is_exceeded(changed).any(axis=1)]
    begin = np.broadcast_to(state, (len(changed), *state.shape))
    x = simulate(mission, begin, changed, flights.time, mission.step)
    slow = ~mission.speed_limit(agent).is_exceeded(x[:, 1:, d:]).any(axis=1)
    x, changed = x[slow], changed[slow]
    paths = flights.follow(x, changed, x[:, -1])
    for one in range(len(known.paths)):
        clear = are_points_clear(paths[:, :ahead, 0], known, one).all(axis=1)
        changed, paths = changed[clear], paths[clear]
    order = np.argsort(((changed - u) ** 2).sum(axis=(1, 2)), kind="stable")
    rows = [a for a in order.tolist() if is_path_clear(paths[a, :ahead], known)][:MAX_DETOURS]
    return Detours(changed[rows], paths[rows])


def _move_aside(
    flights: Flights, piece: int, aside: Float[Array, "ways d"]
) -> Iterator[Float[Array, "_ T m"]]:
    """List controls of least energy that displace an agent at a piece, if any do.

    With those that return to where it was going, to the same drift, and that move on, in turn.
    """
    horizon, mission, d = flights.horizon, flights.mission, flights.mission.axes
    T, S, n = horizon.steps, horizon.pieces_per_step, 2 * mission.axes
    on_state = horizon.discrete_model.respond()
    end, later = on_state[T], flights.time + T * mission.step
    count = max(flights.pieces, 1)
    free = discretize_zoh(mission.linear_model, flights.duration, count, later).A
    if piece < T * S:
        rows = on_state[min(piece // S + 1, T)][:d]
    else:
        rows = np.linalg.multi_dot([*free[piece - T * S :: -1], end])[:d]
    scale = np.repeat([1.0, flights.duration], d)
    over = np.linalg.multi_dot([*free[::-1], np.eye(n)]) if count > 1 else free[0]
    drift = np.linalg.svd((over - np.eye(n))[:d] / scale)[2][:1] * scale
    for kept in (end, drift @ end, end[:0]):
        response = np.vstack([rows, kept])
        wanted = np.pad(aside, ((0, 0), (0, len(kept))))
        found = wanted @ np.linalg.pinv(response).T
        missed = np.abs(found @ response.T - wanted).max(axis=1)
        is_met = missed <= UNMET * np.linalg.norm(aside, axis=1)
        yield found[is_met].reshape(-1, T, d)


def make_room(offers: Offers) -> Offers:
    """Return offers with one in between, for a detour; nobody has chosen one yet."""
    u, paths, allowed = (part[:, [0, 1, 1]] for part in (offers.u, offers.paths, offers.is_allowed))
    allowed[:, 1] = False
    steps = (*offers.plan_steps[:1], 0, 0)
    return offers._replace(plan_steps=steps, u=u, paths=paths, is_allowed=allowed)


def offer_detour(
    offers: Offers,
    row: int,
    detours: Detours,
    others: Float[Array, "others pieces 4 d"],
    clearance: Float[Array, " others"],
) -> Offers:
    """Let an agent offer, in place of its plan, the first detour that is clear of all others.

    The others are what those that it hears have committed to. Where the agent is too near to one
    already, the detour comes no nearer. The offers have room for a detour.
    """
    kept = hull_distance(offers.paths[row, -1] - others)[0].min(axis=1)
    clearance = np.minimum(clearance, kept * (1 - ROUNDING))
    u, paths, allowed = map(np.array, (offers.u[:, :], offers.paths[:, :], offers.is_allowed))
    for own, path in zip(detours.u, detours.paths, strict=True):
        if are_hulls_separated(path - others, clearance).all():
            u[row, 1], paths[row, 1], allowed[row, :2] = own, path, (False, True)
            return offers._replace(u=u, paths=paths, is_allowed=allowed)
    return offers
