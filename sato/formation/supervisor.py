"""Who watches the flight from outside: has the swarm settled, is it stuck?

The predicates of [Lusk2020]'s trials, as its base station applies them. No vehicle hears of it.
"""

from enum import Enum

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.formation.mission import SupervisorSettings


class Phase(Enum):
    """How far the swarm has come with a shape."""

    WAITING = "waiting"  # for the first assignment
    FLYING = "flying"
    CONVERGED = "settled"  # everybody is slow; it has to last
    GRIDLOCKED = "gridlocked"  # somebody does nothing but avoid
    COMPLETED = "done"
    ABORTED = "given up"


class Supervisor:
    """Watches a swarm that takes up one shape."""

    def __init__(self, protocol: SupervisorSettings, sample: float, agents: int) -> None:
        """Begin to wait.

        Args:
            protocol: What counts as settled and as stuck.
            sample: Time between two observations [s].
            agents: Number of vehicles.
        """
        self.phase = Phase.WAITING
        self.time_in_phase = 0.0  # in this phase [s]
        self._settings, self._frame_period = protocol, sample
        self._window_length = max(1, round(protocol.averaging_window / sample))
        self._speed_window = np.zeros((self._window_length, agents))
        self._avoiding_window = np.zeros((self._window_length, agents))
        self._speed_sum, self._avoiding_sum = (
            np.zeros(agents),
            np.zeros(agents),
        )  # sums of the window
        self._observation_count = 0

    def mark_assigned(self) -> None:
        """Everybody knows its point now."""
        if self.phase is Phase.WAITING:
            self._enter(Phase.FLYING)

    def observe(self, speed: Float[Array, " agents"], avoids: Bool[Array, " agents"]) -> Phase:
        """One more observation; returns the phase that it leads to.

        Args:
            speed: What the law commands of each vehicle, before any limit [m/s].
            avoids: Who changes its command to avoid others.
        """
        row = self._observation_count % self._window_length
        self._speed_sum += speed - self._speed_window[row]
        self._avoiding_sum += avoids - self._avoiding_window[row]
        self._speed_window[row], self._avoiding_window[row] = speed, avoids
        self._observation_count += 1
        self.time_in_phase += self._frame_period
        if self.phase is Phase.CONVERGED and not self._is_slow:
            self._enter(Phase.FLYING)
        elif self.phase is Phase.CONVERGED and self._has_lasted(self._settings.convergence_time):
            self._enter(Phase.COMPLETED)
        elif self._observation_count >= self._window_length and self._has_lasted(
            self._settings.averaging_window
        ):
            self._update_phase()
        return self.phase

    def _update_phase(self) -> None:
        if self.phase is Phase.FLYING and self._is_slow:
            self._enter(Phase.CONVERGED)
        elif self.phase is Phase.FLYING and self._is_gridlocked:
            self._enter(Phase.GRIDLOCKED)
        elif self.phase is Phase.GRIDLOCKED and not self._is_gridlocked:
            self._enter(Phase.FLYING)
        elif self.phase is Phase.GRIDLOCKED and self._has_lasted(self._settings.gridlock_timeout):
            self._enter(Phase.ABORTED)

    @property
    def _is_slow(self) -> bool:
        return bool(
            (self._speed_sum < self._settings.convergence_speed * self._window_length).all()
        )

    @property
    def _is_gridlocked(self) -> bool:
        return bool(
            (self._avoiding_sum > self._settings.gridlock_share * self._window_length).any()
        )

    def _has_lasted(self, time: float) -> bool:
        return self.time_in_phase >= time - 1e-9

    def _enter(self, phase: Phase) -> None:
        self.phase, self.time_in_phase = phase, 0.0
        if phase is not Phase.CONVERGED:
            self._observation_count = 0
