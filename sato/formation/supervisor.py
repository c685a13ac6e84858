"""Supervisor of a flight: has the swarm converged, or is it gridlocked?

The predicates are those of [Lusk2020]'s trials, as its base station applies them. No agent
receives anything from it.
"""

from enum import Enum

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.formation.settings import SupervisorSettings


class Phase(Enum):
    """Progress of the swarm with a formation."""

    WAITING = "waiting"  # for the first assignment
    FLYING = "flying"
    CONVERGED = "converged"  # all are slow, which has to last
    GRIDLOCKED = "gridlocked"  # some agent does nothing but avoid others
    COMPLETED = "completed"
    ABORTED = "given up"


class Supervisor:
    """Observer of a swarm that takes up one formation."""

    def __init__(self, settings: SupervisorSettings, period: float, agents: int) -> None:
        """Begin in the phase of waiting.

        Args:
            settings: When a formation is converged, and a swarm gridlocked.
            period: Time between two observations [s].
            agents: Number of agents.
        """
        self.phase = Phase.WAITING
        self.time_in_phase = 0.0  # [s]
        self._settings, self._period = settings, period
        self._window_length = max(1, round(settings.averaging_window / period))
        self._speed_window = np.zeros((self._window_length, agents))
        self._avoiding_window = np.zeros((self._window_length, agents))
        self._speed_sum, self._avoiding_sum = np.zeros(agents), np.zeros(agents)
        self._observation_count = 0

    def mark_assigned(self) -> None:
        """Note that every agent knows its point."""
        if self.phase is Phase.WAITING:
            self._enter(Phase.FLYING)

    def observe(self, speed: Float[Array, " agents"], avoiding: Bool[Array, " agents"]) -> Phase:
        """Add an observation, and return the phase that it leads to.

        Args:
            speed: Speed that the control law commands each agent, before limits [m/s].
            avoiding: True for agents that change their command to avoid others.
        """
        row = self._observation_count % self._window_length
        self._speed_sum += speed - self._speed_window[row]
        self._avoiding_sum += avoiding - self._avoiding_window[row]
        self._speed_window[row], self._avoiding_window[row] = speed, avoiding
        self._observation_count += 1
        self.time_in_phase += self._period
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
