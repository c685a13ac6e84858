"""Course of a flight: hover, assign, take up one formation after another.

When the swarm has converged and when it is gridlocked is decided as by the base station of
[Lusk2020]'s trials. No agent receives anything from it.
"""

import warnings
from collections import deque
from collections.abc import Iterator
from enum import Enum
from math import ceil
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.formation.mission import Formation
from sato.formation.settings import BLOCKED_SPEED_SHARE, SupervisorSettings

TIME_TOLERANCE = 1e-9  # [s]


class Phase(Enum):
    """Progress of the swarm with a formation."""

    WAITING = "waiting"  # for the first assignment
    FLYING = "flying"
    CONVERGED = "converged"  # all are slow, which has to last
    GRIDLOCKED = "gridlocked"  # all agents that have to move are blocked
    COMPLETED = "completed"
    ABORTED = "given up"


def find_blocked(
    mission: Formation, velocity: Float[Array, "agents 3"], avoiding: Bool[Array, " agents"]
) -> Bool[Array, " agents"]:
    """Find the agents that others stop; in [Lusk2020]'s trials, all that avoid others."""
    if mission.avoidance.legacy:
        return avoiding.copy()
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    return np.asarray(avoiding & (speed < BLOCKED_SPEED_SHARE * mission.max_speed))


class Supervisor:
    """Observer of a swarm that takes up one formation."""

    def __init__(self, settings: SupervisorSettings, period: float, legacy: bool = False) -> None:
        """Begin in the phase of waiting, with an observation every period [s].

        Legacy, one blocked agent makes a gridlock; else all that have to move.
        """
        self._legacy = legacy
        self.phase, self.time_in_phase = Phase.WAITING, 0.0  # [s]
        self._settings, self._period = settings, period
        window = max(1, round(settings.averaging_window / period))
        self._speeds, self._blocked = deque[Array](maxlen=window), deque[Array](maxlen=window)

    def mark_assigned(self) -> None:
        """Note that every agent knows its point."""
        if self.phase is Phase.WAITING:
            self._enter(Phase.FLYING)

    def observe(self, speed: Float[Array, " agents"], blocked: Bool[Array, " agents"]) -> Phase:
        """Add an observation of speeds that the control law commands, before limits [m/s].

        Return the phase that it leads to; agents that others block are those of `find_blocked`.
        """
        settings, phase = self._settings, self.phase
        self._speeds.append(speed)
        self._blocked.append(blocked)
        self.time_in_phase += self._period
        is_blocked = np.mean(self._blocked, axis=0) > settings.gridlock_share
        has_arrived = np.mean(self._speeds, axis=0) < settings.convergence_speed
        is_slow = bool(has_arrived.all())
        is_stuck = bool(is_blocked.any() if self._legacy else (is_blocked | has_arrived).all())
        if phase is Phase.CONVERGED:
            if not is_slow:
                self._enter(Phase.FLYING)
            elif self._has_lasted(settings.convergence_time):
                self._enter(Phase.COMPLETED)
        elif not self._has_lasted(settings.averaging_window):
            return phase
        elif phase is Phase.FLYING and (is_slow or is_stuck):
            self._enter(Phase.CONVERGED if is_slow else Phase.GRIDLOCKED)
        elif phase is Phase.GRIDLOCKED and not is_stuck:
            self._enter(Phase.FLYING)
        elif phase is Phase.GRIDLOCKED and self._has_lasted(settings.gridlock_timeout):
            self._enter(Phase.ABORTED)
        return self.phase

    def _has_lasted(self, time: float) -> bool:
        return self.time_in_phase >= time - TIME_TOLERANCE

    def _enter(self, phase: Phase) -> None:
        self.phase, self.time_in_phase = phase, 0.0


class FlightCourse:
    """Course of a flight through all formations, in simulation or again from a record."""

    def __init__(self, mission: Formation) -> None:
        """Begin before the first leg, all agents hovering."""
        self.mission, self.phase = mission, Phase.WAITING
        self.leg = self.instant = 0
        self._events: list[dict[str, Any]] = []

    def start_leg(self) -> None:
        """Prepare for the next formation."""

    def hold_auction(self) -> int:
        """Hold an auction, and return its rounds of messages."""
        raise NotImplementedError

    def assign(self) -> None:
        """Let all agents take the points of the last auction."""

    def advance(self) -> tuple[Float[Array, "agents 3"], Bool[Array, " agents"]]:
        """Fly to the next instant; return velocity commands, and the agents that are blocked."""
        raise NotImplementedError

    @property
    def time(self) -> float:
        """Time of this instant [s]."""
        return self.instant * self.mission.steps_per_frame * self.mission.step

    def instants(self) -> Iterator[tuple[dict[str, Any], ...]]:
        """Fly from instant to instant, and yield the events of each.

        Ends early where the swarm has been gridlocked for too long, or the time is over.
        """
        yield ()
        yield from self._hover()
        for leg in range(len(self.mission.legs)):
            self.leg = leg
            self.start_leg()
            self.note("leg_start", range(self.mission.agents), leg=leg)
            yield from self._fly_leg()
            if self.phase is not Phase.COMPLETED:
                return
            yield from self._hover()
        step = self.mission.frame_period
        for push in self.mission.operator_commands:
            first = ceil(push.start / step - TIME_TOLERANCE) * step
            if first >= min(push.end, self.time):
                at = f"a push from {push.start:g} to {push.end:g} s was never given"
                reason = f"at {self.time:.4g} s the flight ended, with steps of {step:g} s"
                warnings.warn(f"{at}: {reason}", stacklevel=2)

    def note(self, kind: str, agents: Any, **details: Any) -> None:
        """Note an event of the next instant."""
        self._events.append({"kind": kind, **details, "agents": list(agents)})

    def _hover(self) -> Iterator[tuple[dict[str, Any], ...]]:
        # Agents that have taken up a formation go on holding it.
        for _ in range(round(self.mission.supervision.hover_time / self.mission.frame_period)):
            self.advance()
            self.instant += 1
            yield ()

    def _fly_leg(self) -> Iterator[tuple[dict[str, Any], ...]]:
        mission, settings = self.mission, self.mission.assignment
        legacy = mission.avoidance.legacy
        supervisor = Supervisor(mission.supervision, mission.frame_period, legacy)
        # Time of the next auction, and when all will know the outcome of the last. Messages take
        # time: until then agents go on as before.
        due, known = self.time + settings.first_delay, np.inf
        if settings.method == "none":
            due, known = np.inf, self.time
        is_over = False
        while not is_over:
            if known == np.inf and self.time >= due - TIME_TOLERANCE:
                rounds = self.hold_auction()
                self.note("auction", [], leg=self.leg, rounds=rounds)
                due = self.time + settings.period
                known = self.time + rounds / mission.radio.message_rate
            if self.time >= known - TIME_TOLERANCE:
                self.assign()
                supervisor.mark_assigned()
                known = np.inf
            command, blocked = self.advance()
            self.instant += 1
            before = supervisor.phase
            speed = np.sqrt(np.einsum("ij,ij->i", command, command))
            self.phase = supervisor.observe(speed, blocked)
            if self.phase is not before and Phase.GRIDLOCKED in (before, self.phase):
                kind = "gridlock" if self.phase is Phase.GRIDLOCKED else "gridlock_end"
                self.note(kind, np.flatnonzero(blocked).tolist(), leg=self.leg)
            is_over = self.phase in (Phase.COMPLETED, Phase.ABORTED)
            is_over |= self.time >= mission.supervision.time_limit - TIME_TOLERANCE
            if is_over:
                kind = "leg_end" if self.phase is Phase.COMPLETED else "given_up"
                self.note(kind, [], leg=self.leg)
            events, self._events = tuple(self._events), []
            yield events
