"""Who watches the flight from outside: has the swarm settled, is it stuck?

The predicates of [Lusk2020]'s trials, as its base station applies them. No vehicle hears of it.
"""

from enum import Enum

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.formation.mission import Protocol


class Phase(Enum):
    """How far the swarm has come with a shape."""

    WAITING = "waiting"  # for the first assignment
    FLYING = "flying"
    SETTLED = "settled"  # everybody is slow; it has to last
    GRIDLOCKED = "gridlocked"  # somebody does nothing but avoid
    DONE = "done"
    GIVEN_UP = "given up"


class Supervisor:
    """Watches a swarm that takes up one shape."""

    def __init__(self, protocol: Protocol, sample: float, agents: int) -> None:
        """Begin to wait.

        Args:
            protocol: What counts as settled and as stuck.
            sample: Time between two observations [s].
            agents: Number of vehicles.
        """
        self.phase = Phase.WAITING
        self.since = 0.0  # in this phase [s]
        self._protocol, self._sample = protocol, sample
        self._length = max(1, round(protocol.window / sample))
        self._speed = np.zeros((self._length, agents))
        self._avoids = np.zeros((self._length, agents))
        self._speeds, self._avoided = np.zeros(agents), np.zeros(agents)  # sums of the window
        self._seen = 0

    def assigned(self) -> None:
        """Everybody knows its point now."""
        if self.phase is Phase.WAITING:
            self._enter(Phase.FLYING)

    def observe(self, speed: Float[Array, " agents"], avoids: Bool[Array, " agents"]) -> Phase:
        """One more observation; returns the phase that it leads to.

        Args:
            speed: What the law commands of each vehicle, before any limit [m/s].
            avoids: Who changes its command to avoid others.
        """
        row = self._seen % self._length
        self._speeds += speed - self._speed[row]
        self._avoided += avoids - self._avoids[row]
        self._speed[row], self._avoids[row] = speed, avoids
        self._seen += 1
        self.since += self._sample
        if self.phase is Phase.SETTLED and not self._slow:
            self._enter(Phase.FLYING)
        elif self.phase is Phase.SETTLED and self._lasts(self._protocol.hold):
            self._enter(Phase.DONE)
        elif self._seen >= self._length and self._lasts(self._protocol.window):
            self._judge()
        return self.phase

    def _judge(self) -> None:
        if self.phase is Phase.FLYING and self._slow:
            self._enter(Phase.SETTLED)
        elif self.phase is Phase.FLYING and self._stuck:
            self._enter(Phase.GRIDLOCKED)
        elif self.phase is Phase.GRIDLOCKED and not self._stuck:
            self._enter(Phase.FLYING)
        elif self.phase is Phase.GRIDLOCKED and self._lasts(self._protocol.patience):
            self._enter(Phase.GIVEN_UP)

    @property
    def _slow(self) -> bool:
        return bool((self._speeds < self._protocol.settled * self._length).all())

    @property
    def _stuck(self) -> bool:
        return bool((self._avoided > self._protocol.stuck * self._length).any())

    def _lasts(self, time: float) -> bool:
        return self.since >= time - 1e-9

    def _enter(self, phase: Phase) -> None:
        self.phase, self.since = phase, 0.0
        if phase is not Phase.SETTLED:
            self._seen = 0
