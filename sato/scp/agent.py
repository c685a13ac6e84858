"""What one agent does in an exchange [Morgan2016, Method 2].

It hears the paths of its neighbours, keeps clear of those that go before it, and tells
its own.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.avoidance import Avoidance, HalfSpaces, Passage, Yield, no_spaces
from problems.conic import Unsolved
from problems.convexify import Horizon, Way, apart, balls_apart, half_spaces, normals
from problems.transfer import Flight, Transfer

LEANING = 1e-3  # of R: a half-space with less room than this may bind
BROKEN = 1e-7  # of R: a half-space that an answer breaks by more is put into the programme
NEAR = 2.0  # times R: who comes closer has half-spaces from the first
STILL = 1e-3  # ε_SCP over R: a path that moves less has converged
# Ways past the neighbours where nominals collide, by the axes of space: the cheapest is taken.
WAYS: dict[int, tuple[Way, ...]] = {2: ("near", "far"), 3: ("near", "far", "over", "under")}
# Where there is none, what may give way, and about what to convexify: past the neighbours on
# the near side, on the far side, or about standing still. Tried in this order.
RELENTING: tuple[tuple[Yield, Literal["near", "far", "stand"]], ...] = (
    ("arrival", "near"),
    ("arrival", "far"),
    ("arrival", "stand"),
    ("separation", "near"),
)
TIGHT = 1e-6  # of R: who breaks half-spaces by less keeps clear, who misses by less arrives
MOST_SOLVES = 20  # programmes, after which an agent stops improving (Proposition 4 keeps it safe)


class Plan(NamedTuple):
    """What an agent tells its neighbours."""

    rank: tuple[bool, float, int]  # who goes before whom; the smaller goes first
    path: Float[Array, "pieces 4 d"]
    settled: bool


class Planner(NamedTuple):
    """One agent that plans: all that it knows.

    Before the first exchange `flight` is `free`, or the plan that it had, where that went
    another way to keep clear: so it stays on the side on which it passes.
    """

    rank: tuple[bool, float, int]  # (it can still move, −fuel spent, number) [Remark 5]
    goal: Float[Array, " n"]
    transfer: Transfer
    horizon: Horizon
    free: Flight  # its flight if it were alone: iterate 0
    flight: Flight  # the nominal
    path: Float[Array, "pieces 4 d"]  # of the nominal, over the horizon
    about: Callable[[Flight], Transfer] | None = None  # linearises about a nominal; None: no need
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

    @property
    def relinearised(self) -> "Planner":
        """The same about its nominal, where its model has to be."""
        if self.about is None:
            return self
        return self._replace(transfer=self.about(self.flight))

    @property
    def level(self) -> "Planner":
        """The same without the slope of its weights, which keeps to one of many equals."""
        return self._replace(transfer=replace(self.transfer, slope=0.0))

    def flying(self, flight: Flight) -> "Planner":
        """The same with a flight, whose path is what it tells."""
        return self._replace(flight=flight, path=self.horizon.path(flight.x, flight.u))

    def arrives(self, flight: Flight) -> bool:
        """Whether a flight ends at its goal."""
        return ends_at(flight, self.goal, self.horizon.radius)


def ends_at(flight: Flight, goal: Float[Array, " n"], radius: float) -> bool:
    """Whether a flight ends at a goal."""
    return bool(np.abs(flight.x[-1] - goal).max() <= TIGHT * radius)


class Others(NamedTuple):
    """Those whom an agent keeps clear of."""

    paths: Float[Array, "above pieces 4 d"]
    near: Bool[Array, " above"]  # who comes near its nominal; the rest need no half-spaces yet

    @classmethod
    def of(cls, agent: Planner, above: tuple[Plan, ...]) -> "Others":
        """Sort out who is near."""
        paths = np.stack([plan.path for plan in above])
        far = balls_apart(agent.path - paths, NEAR * agent.horizon.radius)
        return cls(paths, np.asarray(~far.all(axis=1)))

    def met(self, path: Float[Array, "pieces 4 d"], radius: float) -> Bool[Array, " above"]:
        """Whose path another would meet."""
        return np.asarray(~apart(path - self.paths, radius).all(axis=1))


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
    if untouched(agent):
        return not clear(agent.path, above, agent.horizon.radius)
    heard = len(above) == len(agent.heard) and all(
        np.array_equal(a.path, b.path) for a, b in zip(above, agent.heard, strict=True)
    )
    return not (heard and agent.steady)


def untouched(agent: Planner) -> bool:
    """Whether an agent flies as if it were alone and has never had reason to ask."""
    return agent.solves == 0 and agent.flight is agent.free and agent.steady


def clear(path: Float[Array, "pieces 4 d"], above: tuple[Plan, ...], radius: float) -> bool:
    """Whether a path keeps clear of every other."""
    return not above or bool(apart(path - np.stack([p.path for p in above]), radius).all())


def _answer(agent: Planner, above: tuple[Plan, ...]) -> Planner:
    """The next iterate, and whether it stands still."""
    free = agent.horizon.path(agent.free.x, agent.free.u)
    if clear(free, above, agent.horizon.radius):
        after = agent._replace(flight=agent.free, path=free, late=0.0, slack=0.0, failed=False)
    else:
        after = _around(agent, above)
    moved = float(np.abs(after.flight.x - agent.flight.x).max())
    still = moved <= STILL * agent.horizon.radius or after.solves >= MOST_SOLVES
    return after._replace(steady=still, heard=above)


def _around(agent: Planner, above: tuple[Plan, ...]) -> Planner:
    """Solve Problem 7 about the nominal; what gives way gives way last to separation."""
    agent = agent.relinearised
    others = Others.of(agent, above)
    collides = not clear(agent.path, above, agent.horizon.radius)
    ways = WAYS[agent.path.shape[-1]] if collides else ("near",)
    tried = [past(agent, others, agent.path, way) for way in ways]
    passages, solves = [p for p in tried if p is not None], agent.solves + len(ways)
    passage = min(passages, key=lambda p: p.flight.fuel, default=None)
    if passage is None:
        passage, count = _relenting(agent, others)
        solves += count
    if passage is None:  # what it tells is what it flies, whatever it began with
        return agent.flying(agent.flight)._replace(solves=solves, failed=True)
    return agent.flying(passage.flight)._replace(
        solves=solves,
        late=passage.late,
        slack=passage.slack,
        failed=False,
    )


def _relenting(agent: Planner, others: Others) -> tuple[Passage | None, int]:
    """The first that is found with something given up, and the programmes that took."""
    for count, (gives, way) in enumerate(RELENTING, 1):
        if way == "stand":
            nominal = _standing(agent)
            passage = None if nominal is None else past(agent, others, nominal, "near", gives)
        else:
            passage = past(agent, others, agent.path, way, gives)
        if passage is not None:
            return passage, count
    return None, len(RELENTING)


def past(
    agent: Planner,
    others: Others,
    nominal: Float[Array, "pieces 4 d"],
    way: Way,
    gives: Yield = "nothing",
) -> Passage | None:
    """Problem 7 about a nominal, clear of all others; None where it has no answer."""
    near = others.near
    while True:
        paths = others.paths[near]
        normal = normals(nominal - paths, agent.horizon.keep, way)
        spaces = half_spaces(agent.horizon, len(agent.flight.u), paths, normal)
        try:
            passage = _solve(agent, spaces, gives)
        except Unsolved:
            return None
        met = others.met(agent.horizon.path(*passage.flight[:2]), agent.horizon.radius) & ~near
        if not met.any():
            return passage
        near = near | met


def _standing(agent: Planner) -> Float[Array, "pieces 4 d"] | None:
    """The path of an agent that comes to rest where it is, as nearly as it can."""
    start = agent.flight.x[0]
    here = np.concatenate([start[: len(start) // 2], np.zeros(len(start) // 2)])
    try:
        rest = Avoidance(agent.transfer).solve(start, here, no_spaces(agent.transfer), "arrival")
    except Unsolved:
        return None
    return agent.horizon.path(rest.flight.x, rest.flight.u)


def _solve(agent: Planner, spaces: HalfSpaces, gives: Yield) -> Passage:
    # Few half-spaces bind: those on which the nominal leans, and at each step the one that
    # the answer would break most, until it breaks none.
    programme, nominal, R = Avoidance(agent.transfer), agent.flight, agent.horizon.radius
    chosen = np.abs(spaces.missing(nominal.x, nominal.u)) < LEANING * R
    over = spaces.missing(agent.free.x, agent.free.u)
    while True:
        chosen |= _worst_of_each_step(spaces.step, np.where(chosen, 0.0, over), BROKEN * R)
        passage = programme.solve(nominal.x[0], agent.goal, spaces.only(chosen), gives)
        over = spaces.missing(passage.flight.x, passage.flight.u) - passage.slack
        if not ((over > BROKEN * R) & ~chosen).any():
            return passage


def _worst_of_each_step(
    step: Int[Array, " rows"], over: Float[Array, " rows"], tolerance: float
) -> Bool[Array, " rows"]:
    worst = np.full(int(step.max(initial=-1)) + 1, tolerance)
    np.maximum.at(worst, step, over)
    return np.asarray((over >= worst[step]) & (over > tolerance))
