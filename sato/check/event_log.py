"""Events of a run, with the instants of the record at which they happened."""

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
    """Events of a run."""

    time: Float[Array, " instants"]  # of the record [s]
    events: tuple[dict[str, Any], ...]  # in the order of time

    @classmethod
    def from_dataset(cls, data: "xarray.Dataset") -> "EventLog":
        """Read the events of a run."""
        events = tuple(json.loads(str(text)) for text in np.asarray(data["event"]))
        return cls(np.asarray(data["time"], dtype=float), events)

    @cached_property
    def instants(self) -> tuple[int, ...]:
        """Index of the instant nearest to each event."""
        times = np.array([float(event["time"]) for event in self.events])
        middles = (self.time[1:] + self.time[:-1]) / 2
        return tuple(int(k) for k in np.searchsorted(np.sort(middles), times))

    def of_kind(self, *kinds: str) -> list[tuple[int, dict[str, Any]]]:
        """Return the events of some kinds, each with the index of its instant."""
        return [
            (k, e) for k, e in zip(self.instants, self.events, strict=True) if e["kind"] in kinds
        ]
