"""What happened in a run, and at which instant."""

import json
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class EventLog:
    """The events of a run."""

    time: Float[Array, " instants"]  # [s]
    events: tuple[dict[str, Any], ...]  # in the order of time

    @classmethod
    def from_dataset(cls, data: "xarray.Dataset") -> "EventLog":
        """Read a run's data."""
        told = tuple(json.loads(str(e)) for e in np.asarray(data["event"]))
        return cls(np.asarray(data["time"], dtype=float), told)

    @cached_property
    def instants(self) -> tuple[int, ...]:
        """The instant of each event: the nearest one."""
        when = np.array([float(e["time"]) for e in self.events])
        middles = (self.time[1:] + self.time[:-1]) / 2
        return tuple(int(k) for k in np.searchsorted(np.sort(middles), when))

    def of_kind(self, *kinds: str) -> list[tuple[int, dict[str, Any]]]:
        """Events of some kinds, each with its instant."""
        return [
            (k, e) for k, e in zip(self.instants, self.events, strict=True) if e["kind"] in kinds
        ]
