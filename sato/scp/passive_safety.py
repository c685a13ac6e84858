"""Knowledge of an agent that is to be passively safe among others."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from problems.convexify import PassingSide
from problems.drifts import KEPT_FACTOR, NEARBY_FACTOR, DriftHorizon, Drifts, Encounters
from problems.half_spaces import HalfSpaces
from problems.transfer import Trajectory


class PassiveSafety(NamedTuple):
    """Drifts of an agent, and what it knows of all others before they plan."""

    horizon: DriftHorizon
    others: Mapping[int, Drifts]  # by number: only from now on, and from the end of plans on
    nominal: Trajectory
    own: Drifts  # along the nominal

    def follow(self, nominal: Trajectory) -> "PassiveSafety":
        """Return the same about another nominal."""
        if nominal is self.nominal:
            return self
        return self._replace(nominal=nominal, own=self.horizon.follow(nominal.x, nominal.u))

    def is_safe(self, above: Mapping[int, Drifts]) -> bool:
        """Tell whether all drifts keep the distance, and the plan from the drifts of others.

        Those above, by number, it must avoid; the others avoid it.
        """
        return self.find_conflicts(above, KEPT_FACTOR).size == 0

    def find_conflicts(
        self, above: Mapping[int, Drifts], factor: float = NEARBY_FACTOR
    ) -> "DriftConflicts":
        """Find where drifts are nearer than the distance, times a factor."""
        each = [above.get(i, known) for i, known in self.others.items()]
        parts = (
            np.array([one[n] for one in each]).reshape(-1, *own.shape)
            for n, own in enumerate(self.own)
        )
        others = Drifts(*parts)
        is_above = np.array([i in above for i in self.others], dtype=bool)
        found = self.horizon.find_encounters(self.own, others, is_above, factor)
        return DriftConflicts(self, others, is_above, *found)


class DriftConflicts(NamedTuple):
    """Encounters in which an agent or others drift too near, and half-spaces against them."""

    agent: PassiveSafety
    others: Drifts
    is_above: Bool[Array, " others"]  # True for those whose plans and drifts are known
    of_drifts: Encounters  # of its own drifts with plans of others
    of_plan: Encounters  # of its plan with drifts of others

    @property
    def size(self) -> int:
        """Number of encounters."""
        return len(self.of_drifts.row) + len(self.of_plan.row)

    def with_solution(self, found: Trajectory) -> "DriftConflicts":
        """Add the encounters of a solution."""
        horizon, nominal = self.agent.horizon, self.agent.nominal
        own = horizon.predict(self.agent.own, nominal, found)
        more = horizon.find_encounters(own, self.others, self.is_above, KEPT_FACTOR)
        of_drifts, of_plan = self.of_drifts.join(more[0]), self.of_plan.join(more[1])
        return self._replace(of_drifts=of_drifts, of_plan=of_plan)

    def constrain(self, side: PassingSide) -> HalfSpaces:
        """Constrain the plan in all encounters, on a side of those that the nominal meets."""
        agent, met = self.agent, (self.of_drifts, self.of_plan)
        return agent.horizon.constrain(agent.own, self.others, met, agent.nominal, side)
