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

BothEncounters = tuple[Encounters, Encounters]  # in its own drifts, and in those of others


class PassiveSafety(NamedTuple):
    """Drifts of an agent, and what it knows of the others: where they move freely in the end."""

    horizon: DriftHorizon
    arrivals: Mapping[int, Float[Array, "later 4 d"]]  # by number, all others
    nominal: Trajectory | None = None
    own: Drifts | None = None

    def follow(self, nominal: Trajectory, known: Drifts | None = None) -> "PassiveSafety":
        """Return the same about another nominal, whose drifts may be known."""
        own = known or self.horizon.follow(nominal.x, nominal.u)
        return self._replace(nominal=nominal, own=own)

    def is_safe(self, others: Mapping[int, Drifts]) -> bool:
        """Tell whether all drifts keep the distance, and the plan from the drifts of others.

        Args:
            others: Drifts of those that it must avoid, by number; the rest avoid it.
        """
        found = self._find(self.own, others, KEPT_FACTOR)
        return not any(len(each.drift) for each in found)

    def find_encounters(self, others: Mapping[int, Drifts]) -> BothEncounters:
        """Find where half-spaces are needed at first."""
        return self._find(self.own, others, NEARBY_FACTOR)

    def find_new(
        self, others: Mapping[int, Drifts], found: Trajectory, known: BothEncounters
    ) -> BothEncounters | None:
        """Add the encounters of a solution; None where there are no new ones."""
        assert self.own is not None and self.nominal is not None
        own = self.horizon.predict(self.own, self.nominal.x, found.x, found.u)
        more = self._find(own, others, KEPT_FACTOR)
        joined = known[0].join(more[0]), known[1].join(more[1])
        is_new = any(len(a.drift) > len(b.drift) for a, b in zip(joined, known, strict=True))
        return joined if is_new else None

    def constrain(
        self, others: Mapping[int, Drifts], encounters: BothEncounters, side: PassingSide
    ) -> HalfSpaces:
        """Constrain the plan in encounters."""
        assert self.own is not None and self.nominal is not None
        x, u = self.nominal[:2]
        return self.horizon.constrain(self.own, *self._stack(others), encounters, x, u, side)

    def _find(
        self, own: Drifts | None, others: Mapping[int, Drifts], factor: float
    ) -> BothEncounters:
        assert own is not None
        return self.horizon.find_encounters(own, *self._stack(others), factor)

    def _stack(self, others: Mapping[int, Drifts]) -> tuple[Drifts, Float[Array, "rest later 4 d"]]:
        rest = [path for i, path in self.arrivals.items() if i not in others]
        shape = len(self.horizon.later), 4, self.horizon.steps.discrete_model.axes
        later = np.array(rest).reshape(len(rest), *shape)
        path = np.array([each.path for each in others.values()])
        drifts = np.array([each.drifts for each in others.values()])
        paths = path.reshape(len(others), len(self.horizon.lengths), *shape[1:])
        return Drifts(paths, drifts.reshape(len(others), len(self.horizon.step), *shape[1:])), later
