"""Load of a network by what its agents agree on: synchronous rounds, by purpose."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

PURPOSES = ("census", "auction", "trajectories", "commitment")


class Load(NamedTuple):
    """Load of each agent's network, of one or more stages."""

    rounds: Int[Array, " agents"]  # synchronous ones that the agent gets through

    @classmethod
    def none(cls, agents: int) -> "Load":
        """Return that of agents that send nothing."""
        return cls(*np.zeros((len(cls._fields), agents), dtype=np.int64))

    @classmethod
    def of(cls, agents: Sequence[int], rounds: Int[Array, " agents"]) -> "Load":
        """Return that of some agents, from an array of all."""
        return cls.none(len(rounds)).plus(cls(rounds), np.isin(np.arange(len(rounds)), agents))

    def plus(self, other: "Load", where: Bool[Array, " agents"] | None = None) -> "Load":
        """Add the load of another stage, to some of the agents alone."""
        some = True if where is None else where
        pairs = zip(self, other, strict=True)
        return Load(*(own + np.where(some, more, 0) for own, more in pairs))
