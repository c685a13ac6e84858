"""Collision-free paths by sequential convex programming [Morgan2016, Method 2].

`revise` is the definition: what one agent does in an exchange. It hears the paths of
its neighbours, keeps clear of those that go before it, and tells its own. `settle`
runs the same for all agents and calls it only where something binds; a test holds the
two equal, exchange by exchange.

The distance is kept by pieces of path and not at samples. Two agents are apart over a
piece when the hull of its relative control points is outside the circle of radius R:
that is Problem 4 here, it implies the same for the continuous path, and Propositions
4 to 6 hold for it with the normals chosen as the directions to the hulls.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics import Steps
from dynamics.path import hull_distance
from problems.avoidance import Avoidance, HalfSpaces, Passage, Yield
from problems.conic import Unsolved
from problems.transfer import Flight, Transfer

STILL = 1e-3  # ε_SCP over R: a path that moves less has converged
HOLD = 1e-6  # part of R by which paths are planned to be further apart than asked
# What may give way, and on which side of a colliding neighbour to pass: tried in this order.
ATTEMPTS: tuple[tuple[Yield, bool], ...] = (
    ("nothing", False),
    ("nothing", True),
    ("arrival", False),
    ("arrival", True),
    ("separation", False),
)
MOST_SOLVES = 15  # after which an agent that is clear stops improving (Proposition 4 keeps it safe)


@dataclass(frozen=True, eq=False)
class Horizon:
    """The steps for which collisions are looked for, cut into pieces between the samples."""

    ahead: Steps  # the steps to come, at least as many as the horizon has
    fine: Steps  # the same time in steps a whole number of times shorter
    radius: float  # R_col, with what the pieces could miss [m]

    @cached_property
    def pieces(self) -> int:
        """Pieces in a step."""
        return len(self.fine) // len(self.ahead)

    @property
    def steps(self) -> int:
        """T_H."""
        return len(self.ahead)

    @cached_property
    def keep(self) -> float:
        """The distance that paths are planned to keep [m]."""
        return self.radius * (1 + HOLD)

    @cached_property
    def frames(self) -> tuple[Array, Array, Array]:
        """P, Q, r: control points c = P x[k] + Q u[k] + r, as (T_H, pieces, 4, d, ·)."""
        T, S, d, h = self.steps, self.pieces, self.ahead.axes, self.fine.dt
        n = 2 * d
        P, Q, r = np.zeros((T, S, 4, d, n)), np.zeros((T, S, 4, d, d)), np.zeros((T, S, 4, d))
        third = np.concatenate([np.eye(d), np.eye(d) * h / 3], axis=1)
        back = np.concatenate([np.eye(d), -np.eye(d) * h / 3], axis=1)
        pick = np.stack([np.eye(d, n), third, back, np.eye(d, n)])
        for k in range(T):
            x, u, z = np.eye(n), np.zeros((n, d)), np.zeros(n)
            for s in range(S):
                A, B, c = (m[k * S + s] for m in (self.fine.A, self.fine.B, self.fine.z))
                after = A @ x, A @ u + B, A @ z + c
                for i in range(4):
                    x_i, u_i, z_i = (x, u, z) if i < 2 else after
                    P[k, s, i], Q[k, s, i], r[k, s, i] = pick[i] @ x_i, pick[i] @ u_i, pick[i] @ z_i
                x, u, z = after
        return P, Q, r

    def path(
        self, x: Float[Array, "*agents T+1 n"], u: Float[Array, "*agents T m"]
    ) -> Float[Array, "*agents pieces 4 d"]:
        """Control points over the horizon; after its last step an agent drifts."""
        P, Q, r = self.frames
        T = min(u.shape[-2], self.steps)
        rest = self.steps - T
        still = np.zeros((*u.shape[:-2], rest, u.shape[-1]))
        after = self.ahead[T:].roll(x[..., T, :], still)
        X = np.concatenate([x[..., :T, :], after[..., :-1, :]], axis=-2)
        U = np.concatenate([u[..., :T, :], still], axis=-2)
        points = (
            np.einsum("ksidn,...kn->...ksid", P, X) + np.einsum("ksidm,...km->...ksid", Q, U) + r
        )
        return points.reshape(*points.shape[:-4], -1, 4, self.ahead.axes)


class Plan(NamedTuple):
    """What an agent tells its neighbours."""

    rank: tuple[bool, float, int]  # who goes before whom; the smaller goes first
    path: Float[Array, "pieces 4 d"]
    settled: bool


class Planner(NamedTuple):
    """One agent that plans: all that it knows."""

    rank: tuple[bool, float, int]  # (it can still move, −fuel spent, number) [Remark 5]
    goal: Float[Array, " n"]
    transfer: Transfer
    horizon: Horizon
    free: Flight  # its flight if it were alone: iterate 0
    flight: Flight  # the nominal
    path: Float[Array, "pieces 4 d"]
    settled: bool = False
    steady: bool = True  # the nominal answered the last programme, or none was needed
    heard: tuple[Plan, ...] = ()  # whom it answered then
    solves: int = 0
    late: float = 0.0  # distance from the goal at the end, where it could not be kept
    slack: float = 0.0  # break of a half-space, where even that could not be kept [m]
    failed: bool = False  # no programme had an answer

    @property
    def plan(self) -> Plan:
        """What it tells."""
        return Plan(self.rank, self.path, self.settled)


def planner(
    rank: tuple[bool, float, int],
    goal: Float[Array, " n"],
    transfer: Transfer,
    horizon: Horizon,
    free: Flight,
) -> Planner:
    """An agent before the first exchange, with the flight it would take alone."""
    path = horizon.path(free.x, free.u)
    return Planner(rank, goal, transfer, horizon, free, free, path)


def revise(agent: Planner, inbox: list[Plan]) -> Planner:
    """One exchange of one agent: hear, plan around those who go before, tell.

    An agent is settled when its path stands still, keeps clear, and all whom it must
    avoid are settled: from then on it cannot change, so agents settle in the order of
    their priorities [Morgan2016, Theorem 8], each by what it heard.
    """
    if agent.settled:
        return agent
    above = tuple(plan for plan in inbox if plan.rank < agent.rank)
    if must_solve(agent, above):
        agent = _answer(agent, above)
    return agent._replace(settled=agent.steady and all(plan.settled for plan in above))


def must_solve(agent: Planner, above: tuple[Plan, ...]) -> bool:
    """Whether an agent has a programme to solve: something binds, and it is news."""
    if len(agent.flight.u) == 0:
        return False
    if agent.solves == 0:
        return not clear(agent.path, above, agent.horizon.radius)
    heard = len(above) == len(agent.heard) and all(
        np.array_equal(a.path, b.path) for a, b in zip(above, agent.heard, strict=True)
    )
    return not (heard and agent.steady)


def clear(path: Float[Array, "pieces 4 d"], above: tuple[Plan, ...], radius: float) -> bool:
    """Whether a path keeps clear of every other."""
    return not above or bool(apart(path - np.stack([p.path for p in above]), radius).all())


def apart(relative: Float[Array, "*pairs 4 d"], radius: float) -> Bool[Array, "*pairs"]:
    """Whether the hull of the control points stays outside the circle."""
    middle = relative.mean(axis=-2)
    spread = np.linalg.norm(relative - middle[..., None, :], axis=-1).max(axis=-1)
    outside = np.asarray(np.linalg.norm(middle, axis=-1) - spread >= radius)
    near = ~outside
    if near.any():
        outside[near] = hull_distance(relative[near])[0] >= radius
    return outside


def _answer(agent: Planner, above: tuple[Plan, ...]) -> Planner:
    """The next iterate, and whether it stands still."""
    free = agent.horizon.path(agent.free.x, agent.free.u)
    if clear(free, above, agent.horizon.radius):
        after = agent._replace(flight=agent.free, path=free, late=0.0, slack=0.0, solves=agent.solves)
    else:
        after = _around(agent, above)
    moved = float(np.abs(after.flight.x - agent.flight.x).max())
    still = moved <= STILL * agent.horizon.radius or after.solves >= MOST_SOLVES
    return after._replace(steady=still, heard=above)


def _around(agent: Planner, above: tuple[Plan, ...]) -> Planner:
    """Solve Problem 7 about the nominal; what gives way gives way last to separation."""
    relative = agent.path - np.stack([plan.path for plan in above])
    solves = agent.solves
    for gives, other_side in ATTEMPTS:
        spaces = _half_spaces(agent, above, normals(relative, agent.horizon.keep, other_side))
        solves += 1
        try:
            passage = _solve(agent, spaces, gives)
        except Unsolved:
            continue
        return agent._replace(
            flight=passage.flight,
            path=agent.horizon.path(passage.flight.x, passage.flight.u),
            solves=solves,
            late=passage.late,
            slack=passage.slack,
        )
    return agent._replace(solves=solves, failed=True)


def _solve(agent: Planner, spaces: HalfSpaces, gives: Yield) -> Passage:
    # Most half-spaces do not bind: those that the answer would break are added to it.
    programme = Avoidance(agent.transfer)
    room = -spaces.missing(agent.flight.x, agent.flight.u)
    chosen = room < 0.5 * agent.horizon.radius
    while True:
        passage = programme.solve(agent.flight.x[0], agent.goal, _only(spaces, chosen), gives)
        broken = spaces.missing(*passage.flight[:2]) > passage.slack + 1e-7 * agent.horizon.radius
        if not (broken & ~chosen).any():
            return passage
        chosen |= broken


def _only(spaces: HalfSpaces, rows: Bool[Array, " rows"]) -> HalfSpaces:
    return HalfSpaces(*(field[rows] for field in spaces))


def _half_spaces(
    agent: Planner, above: tuple[Plan, ...], n: Float[Array, "above pieces d"]
) -> HalfSpaces:
    """n·(c − c̄) ≥ R for every control point that the agent can still move."""
    P, Q, r = agent.horizon.frames
    d, S = r.shape[-1], r.shape[1]
    T = min(len(agent.flight.u), len(P))
    n = n.reshape(len(above), -1, S, d)[:, :T]
    theirs = np.stack([plan.path for plan in above]).reshape(len(above), -1, S, 4, d)[:, :T]
    on_state = np.einsum("aksd,ksidn->aksin", n, P[:T])
    on_control = np.einsum("aksd,ksidm->aksim", n, Q[:T])
    least = agent.horizon.keep + np.einsum("aksd,aksid->aksi", n, theirs - r[:T])
    step = np.broadcast_to(np.arange(T)[:, None, None], least.shape[1:])
    movable = (step > 0) | np.any(Q[:T] != 0, axis=(3, 4))
    rows = np.broadcast_to(movable, least.shape).ravel()
    return HalfSpaces(
        np.broadcast_to(step, least.shape).ravel()[rows],
        on_state.reshape(-1, 2 * d)[rows],
        on_control.reshape(-1, d)[rows],
        least.ravel()[rows],
    )


def normals(
    relative: Float[Array, "above pieces 4 d"], keep: float, other_side: bool = False
) -> Float[Array, "above pieces d"]:
    """Directions of the half-spaces, a unit vector a piece [Morgan2016, Fig. 2].

    Over a piece that is clear: from the other agent to the nominal, which then satisfies
    its own half-space. Two nominals that collide have no such directions, so theirs are
    read off a nominal that is pushed aside at the closest approach, more and more as it
    gets there, until it just passes.

    Args:
        relative: Control points of the nominal less those of the others [m].
        keep: Distance to keep [m].
        other_side: Push a colliding nominal to the far side instead of the near one.
    """
    distance, nearest = hull_distance(relative)
    pushed = relative
    collides = np.flatnonzero(distance.min(axis=1) < keep)
    if len(collides):
        pushed = relative.copy()
        for a in collides:
            pushed[a] += _push(relative[a], distance[a], nearest[a], keep, other_side)
        distance, nearest = hull_distance(pushed)
    inside = distance <= 0
    nearest[inside] = pushed[inside].mean(axis=-2)  # only where even the push is in vain
    length = np.linalg.norm(nearest, axis=-1, keepdims=True)
    return nearest / np.maximum(length, 1e-300)


def _push(
    relative: Array, distance: Array, nearest: Array, keep: float, other_side: bool
) -> Float[Array, "pieces 4 d"]:
    p = int(np.argmin(distance))
    miss = float(distance[p])
    aside = nearest[p] / miss if miss > 1e-6 * keep else _square(relative[p])
    far = keep + miss if other_side else keep - miss
    aside = -aside if other_side else aside
    # Control points stand at thirds of a piece; the push grows as the reach of a control.
    time = np.arange(len(relative))[:, None] + np.arange(4) / 3
    ramp = np.minimum(1.0, time / (p + 0.5)) ** 2
    return np.asarray(1.2 * far * ramp[..., None] * aside)


def _square(piece: Float[Array, "4 d"]) -> Float[Array, " d"]:
    """A unit vector across the motion: to its right in the plane, and as near it in space."""
    along = piece[-1] - piece[0]
    across = np.zeros_like(along)
    across[:2] = along[1], -along[0]
    if not across.any():
        across[0] = 1.0
    return across / np.linalg.norm(across)


def settle(
    planners: dict[int, Planner], hears: Bool[Array, "agents agents"]
) -> tuple[dict[int, Planner], int]:
    """Method 2 for all agents: exchange until every one is settled.

    Args:
        planners: The agents that plan, by number.
        hears: Who hears whom.

    Returns:
        The agents settled, and the number of exchanges it took.
    """
    exchanges = 0
    for planners in exchanged(planners, hears):
        exchanges += 1
    return planners, exchanges


def by_messages(
    planners: dict[int, Planner], hears: Bool[Array, "agents agents"]
) -> Iterator[dict[int, Planner]]:
    """Run the definition itself: every agent after every exchange."""
    now = planners
    while not all(agent.settled for agent in now.values()):
        told = {i: agent.plan for i, agent in now.items()}
        now = {
            i: revise(agent, [told[j] for j in np.flatnonzero(hears[i]) if j in told])
            for i, agent in now.items()
        }
        yield now


def exchanged(
    planners: dict[int, Planner], hears: Bool[Array, "agents agents"]
) -> Iterator[dict[int, Planner]]:
    """The same as `by_messages`, geometry for all at once and only where paths changed.

    Exchanges in which an agent has nothing to solve only carry whether it is settled.
    """
    numbers = sorted(planners)
    now = [planners[i] for i in numbers]
    if not now:
        return
    radius = now[0].horizon.radius
    order = np.empty(len(now), dtype=int)
    order[sorted(range(len(now)), key=lambda i: now[i].rank)] = np.arange(len(now))
    above = hears[np.ix_(numbers, numbers)] & (order < order[:, None])
    lower, upper = np.nonzero(above)
    paths = np.stack([agent.path for agent in now])
    meets = ~apart(paths[lower] - paths[upper], radius).all(axis=-1)
    settled, solved = np.zeros(len(now), dtype=bool), np.zeros(len(now), dtype=bool)
    while not settled.all():
        binds = np.zeros(len(now), dtype=bool)
        binds[lower[meets]] = True
        waits = (above & ~settled).any(axis=1)
        acts = ~settled & (binds | solved)
        told = [agent.plan for agent in now] if acts.any() else []
        settled = settled | (~acts & ~waits)
        now = [a._replace(settled=True) if s else a for a, s in zip(now, settled, strict=True)]
        moved = np.zeros(len(now), dtype=bool)
        for i in np.flatnonzero(acts):
            after = revise(now[i], [told[j] for j in np.flatnonzero(above[i])])
            moved[i] = after.path is not now[i].path
            now[i], solved[i], settled[i] = after, after.solves > 0, after.settled
            paths[i] = after.path
        afresh = moved[lower] | moved[upper]
        meets[afresh] = ~apart(paths[lower[afresh]] - paths[upper[afresh]], radius).all(axis=-1)
        yield dict(zip(numbers, now, strict=True))
