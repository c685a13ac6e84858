"""Record of a flight: the arrays of a run, and the mission that its scenario describes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix
from sato.check.event_log import EventLog
from sato.formation.check.closest import ClosestPair, find_closest_approach
from sato.formation.check.replay import Replay, replay
from sato.formation.loop import FormationFrame
from sato.formation.mission import Formation
from sato.formation.record import GAIN_PARTS, FormationVariables, collect_variables
from sato.record import read_frames, read_variables

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class FormationRecord:
    """A flight as recorded, and the mission as drawn again from its scenario."""

    mission: Formation
    frames: FormationFrame  # with time as leading axis
    variables: FormationVariables
    attributes: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_dataset(cls, data: "xarray.Dataset", mission: Formation) -> "FormationRecord":
        """Read the data of a run."""
        frames, variables = (
            read_frames(FormationFrame, data),
            read_variables(FormationVariables, data),
        )
        return cls(mission, frames, variables, {str(k): v for k, v in data.attrs.items()})

    @classmethod
    def from_frames(cls, frames: Sequence[FormationFrame], mission: Formation) -> "FormationRecord":
        """Stack the frames of a flight."""
        columns = zip(*(frame[:-1] for frame in frames), strict=True)
        stacked = [np.array(values) for values in columns]
        events = tuple({"time": f.time, **event} for f in frames for event in f.events)
        variables = collect_variables(frames, mission)
        return cls(mission, FormationFrame._make([*stacked, events]), variables)

    @property
    def time(self) -> Float[Array, " instants"]:
        """Time of each instant [s]."""
        return np.asarray(self.frames.time)

    @property
    def leg_index(self) -> Int[Array, " instants"]:
        """Leg under way at each instant."""
        return np.asarray(self.frames.leg_index)

    @cached_property
    def events(self) -> EventLog:
        """Events of the flight, by instant."""
        return EventLog(self.time, self.frames.events)

    @cached_property
    def replay(self) -> Replay:
        """Course that the flight had to take by the recorded commands and avoidance."""
        rounds = [int(e["rounds"]) for _, e in self.events.of_kind("auction")]
        return replay(self.mission, self.frames.velocity_command, self.frames.avoiding, rounds)

    @cached_property
    def closest_approach(self) -> ClosestPair:
        """Closest two vehicles in the plane, on straight lines between the instants."""
        return find_closest_approach(self.frames.position[..., :2])

    def load_gains(self, leg: int) -> GainMatrix:
        """Return the recorded gains, for the scenario's own formation.

        Raises:
            ValueError: They are not stable gains of it.
        """
        parts = dict(zip(self.variables.part.tolist(), self.variables.gains[leg], strict=True))
        real, imaginary, z = (parts[name] for name in GAIN_PARTS)
        formation = self.mission.gains[leg].formation
        return GainMatrix(formation, real + 1j * imaginary, z, "recorded", np.inf, np.inf)
