"""Replay of the supervision of a flight, from recorded commands and avoidance alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.formation.mission import Formation
from sato.formation.supervisor import Phase, Supervisor

REPLAYED_EVENTS = ("leg_start", "leg_end", "given_up", "gridlock", "gridlock_end", "auction")


class ReplayedEvent(NamedTuple):
    """Event that a flight must have."""

    instant: int
    kind: str
    leg: int


class FormationLegRecord(NamedTuple):
    """Instants of one leg."""

    leg: int
    first_instant: int  # the one after the start of the leg
    end_instant: int  # the formation is taken up or given up; the last where it never is
    last_instant: int  # the one before the next leg, or the last
    completed: bool  # the formation is taken up, by the supervisor


class Replay(NamedTuple):
    """Course that a flight must have taken, as far as it was recorded."""

    leg: Int[Array, " instants"]  # −1 after the flight had to be over
    phase: tuple[Phase, ...]  # at each instant until then
    events: tuple[ReplayedEvent, ...]
    legs: tuple[FormationLegRecord, ...]
    is_complete: bool  # True where the flight had to be over at the last instant


def replay(
    mission: Formation,
    command: Float[Array, "instants agents 3"],
    avoiding: Bool[Array, "instants agents"],
    rounds: Sequence[int],
) -> Replay:
    """Supervise a flight again.

    Args:
        mission: The mission, drawn.
        command: Velocity commands, in the own frames, before limits [m/s].
        avoiding: True for agents that changed them to avoid others.
        rounds: Rounds of messages of each auction, before its outcome is known.
    """
    speed = np.sqrt(np.einsum("kij,kij->ki", command, command))
    supervision = _SupervisionReplay(mission, speed, avoiding, rounds)
    is_over = supervision.replay_legs()
    k = len(supervision.phase) - 1  # the last instant that there had to be
    leg = np.full(len(command), -1)
    leg[: k + 1] = 0
    legs = []
    for i, (number, first, end, completed) in enumerate(supervision.legs):
        last = supervision.legs[i + 1][1] - 1 if i + 1 < len(supervision.legs) else k
        leg[first : k + 1] = number
        legs.append(FormationLegRecord(number, first, end, last, completed))
    is_complete = is_over and k == len(command) - 1
    return Replay(
        leg, tuple(supervision.phase), tuple(supervision.events), tuple(legs), is_complete
    )


class _SupervisionReplay:
    def __init__(
        self, mission: Formation, speed: Array, avoiding: Array, rounds: Sequence[int]
    ) -> None:
        self.mission, self.speed, self.avoiding = mission, speed, avoiding
        self.auction_durations = iter([count / mission.radio.message_rate for count in rounds])
        self.phase = [Phase.WAITING]
        self.events: list[ReplayedEvent] = []
        self.legs: list[tuple[int, int, int, bool]] = []

    def replay_legs(self) -> bool:
        """Supervise until the flight or the record ends; return True for the former."""
        if not self._hover(Phase.WAITING):
            return False
        for leg in range(len(self.mission.legs)):
            if len(self.phase) == len(self.speed):
                return False
            first = len(self.phase)
            self.events.append(ReplayedEvent(first, "leg_start", leg))
            ending = self._replay_leg(leg)
            end, completed = len(self.phase) - 1, ending is Phase.COMPLETED
            self.legs.append((leg, first, end, completed))
            if ending is None:
                return False
            self.events.append(ReplayedEvent(end, "leg_end" if completed else "given_up", leg))
            if not completed:
                return True
            if not self._hover(Phase.COMPLETED):
                return False
        return True

    def _hover(self, phase: Phase) -> bool:
        wanted = round(self.mission.supervision.hover_time / self.mission.frame_period)
        recorded = min(wanted, len(self.speed) - len(self.phase))
        self.phase += [phase] * recorded
        return recorded == wanted

    def _replay_leg(self, leg: int) -> Phase | None:
        # Returns the phase in which the leg ends; none where the record ends before.
        mission, settings = self.mission, self.mission.assignment
        supervisor = Supervisor(mission.supervision, mission.frame_period, mission.agents)
        due, known = np.inf, np.inf  # next auction, and when all know the outcome of one under way
        if settings.method == "none":
            supervisor.mark_assigned()
        else:
            due = self._time(len(self.phase) - 1) + settings.first_delay
        while (k := len(self.phase)) < len(self.speed):
            time = self._time(k - 1)
            if known == np.inf and time >= due - 1e-9:
                self.events.append(ReplayedEvent(k, "auction", leg))
                known, due = time + next(self.auction_durations, 0.0), time + settings.period
            if time >= known - 1e-9:
                supervisor.mark_assigned()
                known = np.inf
            before = supervisor.phase
            now = supervisor.observe(self.speed[k], self.avoiding[k])
            if now is not before and Phase.GRIDLOCKED in (before, now):
                kind = "gridlock" if now is Phase.GRIDLOCKED else "gridlock_end"
                self.events.append(ReplayedEvent(k, kind, leg))
            self.phase.append(now)
            late = self._time(k) >= mission.supervision.time_limit - 1e-9
            if now in (Phase.COMPLETED, Phase.ABORTED) or late:
                return now
        return None

    def _time(self, instant: int) -> float:
        return instant * self.mission.steps_per_frame * self.mission.step
