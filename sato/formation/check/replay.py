"""The flight once more, as who watched it saw it: by commands and avoidance alone."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.formation.mission import Formation
from sato.formation.supervisor import Phase, Supervisor

REPLAYED_EVENTS = ("leg_start", "leg_end", "given_up", "gridlock", "gridlock_end", "auction")


class ReplayedEvent(NamedTuple):
    """An event that had to be."""

    instant: int
    kind: str
    leg: int


class FormationLegRecord(NamedTuple):
    """One leg as it had to be flown."""

    leg: int
    first_instant: int  # instant after the call for the shape
    end_instant: int  # instant at which it is taken up or given up; the last where it never is
    last_instant: int  # instant before the next call, or the last
    completed: bool  # taken up, as who watches it sees it


class Replay(NamedTuple):
    """How a flight had to go, as far as it was recorded."""

    leg: Int[Array, " instants"]  # −1 after the flight had to be over
    phase: tuple[Phase, ...]  # at every instant that had to be
    events: tuple[ReplayedEvent, ...]
    legs: tuple[FormationLegRecord, ...]
    is_complete: bool  # the last instant is the one at which the flight had to be over


def replay(
    mission: Formation,
    command: Float[Array, "instants agents 3"],
    avoiding: Bool[Array, "instants agents"],
    rounds: Sequence[int],
) -> Replay:
    """Watch a flight again.

    Args:
        mission: What was to be flown.
        command: By the law, in the own frames, before limits [m/s].
        avoiding: Who changed it to avoid others.
        rounds: Of messages, of each auction: so long it takes until its end is known.
    """
    speed = np.sqrt(np.einsum("kij,kij->ki", command, command))
    watch = _SupervisionReplay(mission, speed, avoiding, rounds)
    complete = watch.replay_legs()
    k = len(watch.phase) - 1  # the last instant that had to be
    leg = np.full(len(command), -1)
    leg[: k + 1] = 0
    stretches = list[FormationLegRecord]()
    for begun, (number, first, end, settled) in enumerate(watch.legs):
        last = watch.legs[begun + 1][1] - 1 if begun + 1 < len(watch.legs) else k
        leg[first : k + 1] = number
        stretches.append(FormationLegRecord(number, first, end, last, settled))
    complete = complete and k == len(command) - 1
    return Replay(leg, tuple(watch.phase), tuple(watch.events), tuple(stretches), complete)


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
        """Watch until the flight is over, or the record; whether it is the former."""
        if not self._hover(Phase.WAITING):
            return False
        for leg in range(len(self.mission.gains)):
            if len(self.phase) == len(self.speed):
                return False
            first = len(self.phase)
            self.events.append(ReplayedEvent(first, "leg_start", leg))
            ending = self._replay_leg(leg)
            end = len(self.phase) - 1
            self.legs.append((leg, first, end, ending is Phase.COMPLETED))
            if ending is None:
                return False
            self.events.append(
                ReplayedEvent(end, "leg_end" if ending is Phase.COMPLETED else "given_up", leg)
            )
            if ending is not Phase.COMPLETED:
                return True
            if not self._hover(Phase.COMPLETED):
                return False
        return True

    def _hover(self, phase: Phase) -> bool:
        wanted = round(self.mission.supervision.hover_time / self.mission.frame_period)
        there = min(wanted, len(self.speed) - len(self.phase))
        self.phase += [phase] * there
        return there == wanted

    def _replay_leg(self, leg: int) -> Phase | None:
        # The phase in which the leg ends; none where the record ends before.
        mission, way = self.mission, self.mission.assignment
        watcher = Supervisor(mission.supervision, mission.frame_period, mission.agents)
        if way.method == "none":
            watcher.mark_assigned()
        due = np.inf if way.method == "none" else self._time(len(self.phase) - 1) + way.first_delay
        known = np.inf  # when all know how the auction under way has ended
        while (k := len(self.phase)) < len(self.speed):
            now_at = self._time(k - 1)
            if known == np.inf and now_at >= due - 1e-9:
                self.events.append(ReplayedEvent(k, "auction", leg))
                known, due = now_at + next(self.auction_durations, 0.0), now_at + way.period
            if now_at >= known - 1e-9:
                watcher.mark_assigned()
                known = np.inf
            before = watcher.phase
            now = watcher.observe(self.speed[k], self.avoiding[k])
            if now is not before and Phase.GRIDLOCKED in (before, now):
                stuck = now is Phase.GRIDLOCKED
                self.events.append(ReplayedEvent(k, "gridlock" if stuck else "gridlock_end", leg))
            self.phase.append(now)
            late = self._time(k) >= mission.supervision.time_limit - 1e-9
            if now in (Phase.COMPLETED, Phase.ABORTED) or late:
                return now
        return None

    def _time(self, instant: int) -> float:
        return instant * self.mission.steps_per_frame * self.mission.control_step
