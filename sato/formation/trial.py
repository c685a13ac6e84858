"""Trials as in [Lusk2020, Sec. V-A]: two random formations from a random start."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from problems.gain_matrix import GainMatrix
from sato.formation.loop import FormationFrame, simulate
from sato.formation.mission import Formation
from sato.formation.shape_error import ShapeError, compute_shape_error
from sato.formation.supervisor import Phase
from sato.shapes.graphs import random_dense_graph
from sato.shapes.random_points import sample_formation, sample_positions

HEIGHT = 1.0  # at which all hover before the first formation [m]


class TrialSetup(NamedTuple):
    """What is drawn for a trial, the same for every way of flying it."""

    start: Float[Array, "agents 3"]  # [m]
    gains: tuple[GainMatrix, GainMatrix]


@dataclass(frozen=True)
class FormationTrial:
    """What came of a trial."""

    completed: bool  # both formations, by the protocol: everybody's command is small
    shape_errors: tuple[ShapeError, ...]  # of each formation settled in, after hovering in it
    path_length: (
        float  # flown in the plane while under way, mean of the vehicles, both together [m]
    )
    time: float  # from each first assignment until settled, both together [s]
    assignments: int  # the first of each formation, and changes
    min_separation: float  # least distance of two vehicles in the plane, at control steps [m]
    gridlock_time: float  # time in gridlock [s]

    @property
    def inverted(self) -> bool:
        """Whether a formation is upside down."""
        return any(x.inverted for x in self.shape_errors)

    @property
    def shape_error(self) -> float:
        """The larger error of shape of the two [m]; infinite if one was not taken up."""
        return (
            max((x.error for x in self.shape_errors), default=np.inf) if self.completed else np.inf
        )


def draw_trial(
    rng: np.random.Generator, agents: int = 30, remove_edges: bool = False
) -> TrialSetup:
    """A start and two formations, on one graph.

    Args:
        rng: Draws everything.
        agents: Number of vehicles.
        thin: The graph is complete, but for 1 to agents − 4 random pairs that are taken away.
    """
    flat = sample_positions(agents, (20.0, 20.0), 1.5, rng)
    start = np.column_stack([flat, np.full(agents, HEIGHT)])
    points = [sample_formation(agents, (15.0, 15.0, 2.0), 2.0, rng) for _ in range(2)]
    graph = _draw_graph(agents, remove_edges, rng)
    first, second = (design_gains(DesiredFormation(p, graph), "projection") for p in points)
    return TrialSetup(start, (first, second))


def run_trial(mission: Formation, rng: np.random.Generator) -> FormationTrial:
    """Fly a trial and judge it.

    Args:
        mission: What is flown.
        rng: Draws noise and losses.
    """
    return evaluate_trial(mission, simulate(mission, rng))


def evaluate_trial(mission: Formation, frames: Iterable[FormationFrame]) -> FormationTrial:
    """What came of a trial that is flown, by all its frames."""
    account = _TrialStatistics(mission)
    for frame in frames:
        account.update(frame)
    return account.result()


class _TrialStatistics:
    def __init__(self, mission: Formation) -> None:
        self.mission = mission
        self.last: FormationFrame | None = None
        self.shape_errors: list[ShapeError] = []
        self.path_length = self.time = self.gridlock_time = 0.0
        self.assignments = 0

    def update(self, frame: FormationFrame) -> None:
        last, self.last = self.last, frame
        self.assignments += sum(e["kind"] == "assignment" for e in frame.events)
        if last is None:
            return
        if last.leg_index != frame.leg_index and last.phase is Phase.COMPLETED:
            self._record_shape_error(last)
        # From the frame after the first assignment to the one that shows the end.
        done = last.leg_index == frame.leg_index and last.phase is Phase.COMPLETED
        if frame.phase is not Phase.WAITING and not done:
            self.path_length += float((frame.path_length - last.path_length).sum()) / len(
                frame.path_length
            )
            self.time += frame.time - last.time
        if last.phase is Phase.GRIDLOCKED:
            self.gridlock_time += frame.time - last.time

    def result(self) -> FormationTrial:
        assert self.last is not None
        if self.last.phase is Phase.COMPLETED:
            self._record_shape_error(self.last)
        settled = len(self.shape_errors) == len(self.mission.gains)
        return FormationTrial(
            settled, tuple(self.shape_errors), self.path_length, self.time, self.assignments,
            float(self.last.min_separation.min()), self.gridlock_time,
        )  # fmt: skip

    def _record_shape_error(self, frame: FormationFrame) -> None:
        holder = np.argsort(frame.point_index)
        points = self.mission.gains[frame.leg_index].formation.points
        self.shape_errors.append(compute_shape_error(frame.position[holder], points))


def _draw_graph(agents: int, thin: bool, rng: np.random.Generator) -> Bool[Array, "agents agents"]:
    if not thin:
        return ~np.eye(agents, dtype=bool)
    return random_dense_graph(agents, int(rng.integers(1, agents - 3)), rng)
