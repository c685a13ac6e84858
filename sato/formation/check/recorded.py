"""Record of a flight: the arrays of a run, and the course that it must have taken."""

from functools import cached_property
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix
from sato.check.common import ClosestPair, find_closest_approach
from sato.formation.loop import FormationFrame
from sato.formation.mission import Formation
from sato.formation.record import FormationVariables
from sato.formation.supervisor import FlightCourse, Phase
from sato.record import RunRecord


class FormationLegRecord(NamedTuple):
    """Instants of one leg."""

    leg: int
    first_instant: int  # the one after the start of the leg
    end_instant: int  # the formation is taken up or given up; the last where it never is
    last_instant: int  # the one before the next leg, or the last
    completed: bool  # the formation is taken up, by the supervisor


class Replay(NamedTuple):
    """Course that a flight must have taken by the recorded commands and avoidance."""

    leg: Int[Array, " instants"]  # −1 after the flight had to be over
    phase: tuple[Phase, ...]  # at each instant until then
    events: tuple[tuple[int, str, int], ...]  # instant, kind and leg
    legs: tuple[FormationLegRecord, ...]
    is_complete: bool  # True where the flight had to be over at the last instant


class FormationRecord(RunRecord[Formation, FormationFrame, FormationVariables]):
    """A flight as recorded, and the mission as drawn again from its scenario."""

    @property
    def leg_index(self) -> Int[Array, " instants"]:
        """Leg under way at each instant."""
        return np.asarray(self.frames.leg_index)

    @cached_property
    def auction_rounds(self) -> tuple[int, ...]:
        """Rounds of messages of each auction, before its outcome is known."""
        return tuple(int(event["rounds"]) for _, event in self.events.of_kind("auction"))

    @cached_property
    def replay(self) -> Replay:
        """Course that the flight had to take by the recorded commands and avoidance."""
        course = _RecordedCourse(self)
        instants, leg = course.instants(), np.full(len(self.time), -1)
        phase: list[Phase] = []
        noted: list[tuple[int, str, int]] = []
        for k, events in enumerate(islice(instants, len(self.time))):
            leg[k] = course.leg
            phase.append(course.phase)
            noted += [(k, event["kind"], event["leg"]) for event in events]
        is_complete = len(phase) == len(self.time) and next(instants, None) is None
        last = len(phase) - 1  # the last instant that there had to be
        starts = [k for k, kind, _ in noted if kind == "leg_start"]
        ends = [(k, kind == "leg_end") for k, kind, _ in noted if kind in ("leg_end", "given_up")]
        if len(ends) < len(starts):
            ends.append((last, False))
        until = [*(k - 1 for k in starts[1:]), last]
        legs = tuple(
            FormationLegRecord(number, starts[number], end, until[number], completed)
            for number, (end, completed) in enumerate(ends)
        )
        return Replay(leg, tuple(phase), tuple(noted), legs, is_complete)

    @cached_property
    def closest_approach(self) -> ClosestPair:
        """Closest two vehicles in the plane, on straight lines between the instants."""
        return find_closest_approach(self.frames.position[..., :2], self.frames.alive)

    def load_gains(self, leg: int) -> GainMatrix:
        """Return the recorded gains, for the scenario's own formation.

        Raises:
            ValueError: They are not stable gains of it.
        """
        real, imaginary, z = self.variables.gains[leg]
        formation = self.mission.gains[leg].formation
        return GainMatrix(formation, real + 1j * imaginary, z, "recorded", np.inf, np.inf)


class _RecordedCourse(FlightCourse):
    # Reads what the loop computes, as far as it was recorded.
    def __init__(self, record: FormationRecord) -> None:
        super().__init__(record.mission)
        self.frames, self.rounds = record.frames, iter(record.auction_rounds)

    def hold_auction(self) -> int:
        return next(self.rounds, 0)

    def advance(self) -> tuple[Array, Array]:
        k = min(self.instant + 1, len(self.frames.avoiding) - 1)
        return self.frames.velocity_command[k], self.frames.avoiding[k]
