"""Trials as in [Lusk2020, Sec. V-A]: two random formations from a random start."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.formation import Formation
from problems.formation_gain import design
from problems.gains import Gains
from sato.formation.flight import Frame, fly
from sato.formation.mission import FormationFlight
from sato.formation.shape import Likeness, likeness
from sato.formation.supervisor import Phase
from sato.shapes.random_formation import random_formation, random_start, thinned

HEIGHT = 1.0  # at which all hover before the first formation [m]


class Draw(NamedTuple):
    """What is drawn for a trial, the same for every way of flying it."""

    start: Float[Array, "agents 3"]  # [m]
    shapes: tuple[Gains, Gains]


@dataclass(frozen=True)
class Trial:
    """What came of a trial."""

    settled: bool  # both formations, by the protocol: everybody's command is small
    likeness: tuple[Likeness, ...]  # of each formation settled in, after hovering in it
    path: float  # flown in the plane while under way, mean of the vehicles, both together [m]
    time: float  # from each first assignment until settled, both together [s]
    assignments: int  # the first of each formation, and changes
    separation: float  # least distance of two vehicles in the plane, at control steps [m]
    gridlocked: float  # time in gridlock [s]

    @property
    def inverted(self) -> bool:
        """Whether a formation is upside down."""
        return any(x.inverted for x in self.likeness)

    @property
    def error(self) -> float:
        """The larger error of shape of the two [m]; infinite if one was not taken up."""
        return max((x.error for x in self.likeness), default=np.inf) if self.settled else np.inf


def draw(rng: np.random.Generator, agents: int = 30, thin: bool = False) -> Draw:
    """A start and two formations, on one graph.

    Args:
        rng: Draws everything.
        agents: Number of vehicles.
        thin: The graph is complete, but for 1 to agents − 4 random pairs that are taken away.
    """
    flat = random_start(agents, (20.0, 20.0), 1.5, rng)
    start = np.column_stack([flat, np.full(agents, HEIGHT)])
    points = [random_formation(agents, (15.0, 15.0, 2.0), 2.0, rng) for _ in range(2)]
    graph = _graph(agents, thin, rng)
    first, second = (design(Formation(p, graph), "projection") for p in points)
    return Draw(start, (first, second))


def fly_trial(mission: FormationFlight, rng: np.random.Generator) -> Trial:
    """Fly a trial and judge it.

    Args:
        mission: What is flown.
        rng: Draws noise and losses.
    """
    return judged(mission, fly(mission, rng))


def judged(mission: FormationFlight, frames: Iterable[Frame]) -> Trial:
    """What came of a trial that is flown, by all its frames."""
    account = _Account(mission)
    for frame in frames:
        account.add(frame)
    return account.close()


class _Account:
    def __init__(self, mission: FormationFlight) -> None:
        self.mission = mission
        self.last: Frame | None = None
        self.likeness: list[Likeness] = []
        self.path = self.time = self.gridlocked = 0.0
        self.assignments = 0

    def add(self, frame: Frame) -> None:
        last, self.last = self.last, frame
        self.assignments += sum(e["kind"] == "assignment" for e in frame.events)
        if last is None:
            return
        if last.leg != frame.leg and last.phase is Phase.DONE:
            self._settle(last)
        # From the frame after the first assignment to the one that shows the end.
        done = last.leg == frame.leg and last.phase is Phase.DONE
        if frame.phase is not Phase.WAITING and not done:
            self.path += float((frame.path - last.path).sum()) / len(frame.path)
            self.time += frame.time - last.time
        if last.phase is Phase.GRIDLOCKED:
            self.gridlocked += frame.time - last.time

    def close(self) -> Trial:
        assert self.last is not None
        if self.last.phase is Phase.DONE:
            self._settle(self.last)
        settled = len(self.likeness) == len(self.mission.shapes)
        return Trial(
            settled, tuple(self.likeness), self.path, self.time, self.assignments,
            float(self.last.nearest.min()), self.gridlocked,
        )  # fmt: skip

    def _settle(self, frame: Frame) -> None:
        holder = np.argsort(frame.point)
        points = self.mission.shapes[frame.leg].formation.points
        self.likeness.append(likeness(frame.position[holder], points))


def _graph(agents: int, thin: bool, rng: np.random.Generator) -> Bool[Array, "agents agents"]:
    if not thin:
        return ~np.eye(agents, dtype=bool)
    return thinned(agents, int(rng.integers(1, agents - 3)), rng)
