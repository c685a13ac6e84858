"""Knowledge of an agent that is to be passively safe among others."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.convexify import PassingSide
from problems.drifts import KEPT_FACTOR, NEARBY_FACTOR, DriftHorizon, Drifts, Encounters
from problems.half_spaces import HalfSpaces
from problems.transfer import Trajectory


class PassiveSafety(NamedTuple):
    """Drifts of an agent, and what it knows of the others: where they move freely in the end."""

    horizon: DriftHorizon
    arrivals: Mapping[int, Float[Array, "later 4 d"]]  # by number, all others
    nominal: Trajectory
    own: Drifts  # along the nominal

    def follow(self, nominal: Trajectory) -> "PassiveSafety":
        """Return the same about another nominal."""
        return self._replace(nominal=nominal, own=self.horizon.follow(nominal.x, nominal.u))

    def is_safe(self, others: Mapping[int, Drifts]) -> bool:
        """Tell whether all drifts keep the distance, and the plan from the drifts of others.

        Args:
            others: Drifts of those that it must avoid, by number; the rest avoid it.
        """
        return self.find_conflicts(others, KEPT_FACTOR).size == 0

    def find_conflicts(
        self, others: Mapping[int, Drifts], factor: float = NEARBY_FACTOR
    ) -> "DriftConflicts":
        """Find where drifts are nearer than the distance, times a factor."""
        rest = [path for i, path in self.arrivals.items() if i not in others]
        each = list(others.values())
        known = Drifts(
            _stack(self.own.path, [one.path for one in each]),
            _stack(self.own.drifts, [one.drifts for one in each]),
        )
        later = _stack(self.own.path[self.horizon.steps.steps :], rest)
        found = self.horizon.find_encounters(self.own, known, later, factor)
        return DriftConflicts(self, known, later, *found)


class DriftConflicts(NamedTuple):
    """Where an agent or others may drift too near, and half-spaces against it."""

    agent: PassiveSafety
    others: Drifts  # of those whose paths it knows
    later: Float[Array, "rest later 4 d"]  # of those of which it knows only what follows
    drifting: Encounters  # in its own drifts
    following: Encounters  # of its plan, in the drifts of others

    @property
    def size(self) -> int:
        """Number of encounters."""
        return len(self.drifting.drift) + len(self.following.drift)

    def with_solution(self, found: Trajectory) -> "DriftConflicts":
        """Add the encounters of a solution."""
        horizon, nominal = self.agent.horizon, self.agent.nominal
        own = horizon.predict(self.agent.own, nominal.x, found.x, found.u)
        more = horizon.find_encounters(own, self.others, self.later, KEPT_FACTOR)
        drifting, following = self.drifting.join(more[0]), self.following.join(more[1])
        return self._replace(drifting=drifting, following=following)

    def constrain(self, side: PassingSide) -> HalfSpaces:
        """Constrain the plan in all encounters, on a side of those that the nominal meets."""
        own, nominal = self.agent.own, self.agent.nominal
        known = self.others, self.later, (self.drifting, self.following)
        return self.agent.horizon.constrain(own, *known, nominal.x, nominal.u, side)


def _stack(like: Float[Array, "pieces 4 d"], each: list[Array]) -> Float[Array, "k pieces 4 d"]:
    """Stack arrays of a shape, perhaps none."""
    return np.array(each).reshape(-1, *like.shape)
