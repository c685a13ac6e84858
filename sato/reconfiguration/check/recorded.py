"""Recorded run as arrays, beside the mission that its own scenario describes."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel, discretize_zoh
from dynamics.model import LinearModel
from dynamics.plant import LinearPlant
from dynamics.trajectory_geometry import (
    Separations,
    interpolation_error_bound,
    sampled_interpolation_error,
    separations,
)
from sato.check.event_log import EventLog
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.record import CHIEF_ELEMENTS

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class LegRecord:
    """One leg as it was flown, by the events at its start and end."""

    leg_index: int
    start_index: int  # instant at which it starts
    end_index: int  # instant at which it ends; the last of the run where it did not end
    end_event: dict[str, Any] | None  # None where the run stopped before

    @property
    def step_count(self) -> int:
        """Number of control steps."""
        return self.end_index - self.start_index


class LegEnd(NamedTuple):
    """State of the agents at the end of a leg."""

    target_index: Int[Array, " agents"]
    alive: Bool[Array, " agents"]
    target_count: Int[Array, " agents"]
    component: Int[Array, " agents"]


@dataclass(frozen=True, eq=False)
class ReconfigurationRecord:
    """Arrays of a recorded run, and the drawn mission."""

    mission: Reconfiguration
    attributes: dict[str, Any]
    time: Float[Array, " instants"]
    state: Float[Array, "instants agents n"]
    alive: Bool[Array, "instants agents"]
    component: Int[Array, "instants agents"]
    control: Float[Array, "instants agents d"]
    applied_control: Float[Array, "instants agents d"]
    measured_state: Float[Array, "instants agents n"] | None  # only under noise
    leg: Int[Array, " instants"]
    target_index: Int[Array, "instants agents"]
    targets: Float[Array, "legs targets n"]  # states; NaN where a leg has fewer
    final_target_count: Int[Array, "legs agents"]
    chief: Float[Array, "instants elements"] | None  # polar-nodal elements of the chief, in orbit
    events: EventLog

    @classmethod
    def from_dataset(
        cls, data: "xarray.Dataset", mission: Reconfiguration
    ) -> "ReconfigurationRecord":
        """Read the arrays of a dataset."""

        def both(name: str) -> Array:
            parts = [np.asarray(data[f"{name}{part}"], dtype=float) for part in _STATE_PARTS]
            return np.concatenate(parts, axis=-1)

        return cls(
            mission=mission,
            attributes={str(k): v for k, v in data.attrs.items()},
            time=np.asarray(data["time"], dtype=float),
            state=both(""),
            alive=np.asarray(data["alive"], dtype=bool),
            component=np.asarray(data["component"]),
            measured_state=both("measured_") if "measured_position" in data else None,
            control=np.asarray(data["control"], dtype=float),
            applied_control=np.asarray(data["applied_control"], dtype=float),
            leg=np.asarray(data["leg_index"]),
            target_index=np.asarray(data["target_index"]),
            targets=both("target_"),
            final_target_count=np.asarray(data["targets_believed"]),
            chief=_read_chief(data),
            events=EventLog.from_dataset(data),
        )

    @property
    def axes(self) -> int:
        """Axes of space."""
        return self.mission.axes

    @property
    def position(self) -> Float[Array, "instants agents d"]:
        """True positions [m]."""
        return self.state[..., : self.axes]

    @property
    def velocity(self) -> Float[Array, "instants agents d"]:
        """True velocities [m/s]."""
        return self.state[..., self.axes :]

    @cached_property
    def leg_records(self) -> tuple[LegRecord, ...]:
        """Legs that began, in order."""
        ends = {int(e["leg"]): (k, e) for k, e in self.events.of_kind("leg_end")}
        found = []
        for first, event in self.events.of_kind("leg_start"):
            leg = int(event["leg"])
            last, end = ends.get(leg, (len(self.time) - 1, None))
            found.append(LegRecord(leg, first, max(first, last), end))
        return tuple(found)

    def leg_end(self, leg: LegRecord) -> LegEnd:
        """Read the end of a leg from its event.

        Its last instant is the first of the next leg, which has its own targets and losses
        by then. A leg that did not end is taken as it stood.
        """
        agents, last = self.alive.shape[1], leg.end_index
        if leg.end_event is None:
            none = np.zeros(agents, dtype=int)
            return LegEnd(self.target_index[last], self.alive[last], none, self.component[last])
        alive = np.zeros(agents, dtype=bool)
        alive[np.asarray(leg.end_event["agents"], dtype=np.int64)] = True
        target, count, component = (
            np.asarray(leg.end_event[name], dtype=np.int64)
            for name in ("target", "believed", "component")
        )
        return LegEnd(target, alive, count, component)

    @cached_property
    def model(self) -> DiscreteModel:
        """Shared model from each instant to the next."""
        return discretize_zoh(self.mission.linear_model, self.mission.step, len(self.time) - 1)

    @cached_property
    def is_flying(self) -> Bool[Array, "steps agents"]:
        """True for agents that fly a step: alive at its start, also if they are lost at its end."""
        return self.alive[:-1]

    def repropagate(self, pieces: int = 1) -> Float[Array, "steps {pieces}+1 agents n"]:
        """Propagate every recorded state by the plant under the applied control of its step.

        NaN for agents that do not fly, or without a finite control.
        """
        mission, agents = self.mission, self.state.shape[1]
        found = np.empty((len(self.is_flying), pieces + 1, agents, self.state.shape[2]))
        is_missing = ~self.is_flying | ~np.isfinite(self.applied_control[:-1]).all(axis=2)
        u = np.where(is_missing[..., None], 0.0, self.applied_control[:-1])
        for k, x in enumerate(self.state[:-1]):
            found[k] = mission.flown_plant.propagate(
                x, u[k], k * mission.step, mission.step, pieces
            )
        found[np.broadcast_to(is_missing[:, None], found.shape[:3])] = np.nan
        return found

    @cached_property
    def pieces_per_step(self) -> int:
        """Cubic pieces per step: one where a cubic is exact, else at most a second each.

        An even number where the interpolation error is measured instead of bounded.
        """
        step = self.mission.step
        if self._time_invariant_model is None:
            return 2 * int(np.ceil(step / 2))
        x, u = np.moveaxis(self.state, 0, 1), np.moveaxis(self.applied_control[:-1], 0, 1)
        is_exact = interpolation_error_bound(self._time_invariant_model, x, u, step) == 0
        return 1 if is_exact else int(np.ceil(step))

    @cached_property
    def separations(self) -> tuple[Separations, float]:
        """Least separation in every piece, and an allowance for the interpolation error [m].

        Pieces lie between states of the plant itself. Two agents may have been closer by twice
        the interpolation error: it is bounded where the plant is a time-invariant linear model
        (`interpolation_error_bound`), and measured elsewhere (`sampled_interpolation_error`).
        """
        s, d = self.pieces_per_step, self.axes
        h = self.mission.step / s
        x = np.repeat(self.state, s, axis=0)[: (len(self.state) - 1) * s + 1]
        if s > 1:
            flown = self.repropagate(s)
            for j in range(1, s):
                x[j::s] = flown[:, j]
        alive = np.vstack([np.repeat(self.is_flying, s, axis=0), self.alive[-1:]])
        found = separations(x[..., :d], x[..., d:], alive, h)
        return found, 2 * self._interpolation_error(np.moveaxis(x, 0, 1), h)

    def _interpolation_error(self, x: Float[Array, "agents instants n"], h: float) -> float:
        s, d = self.pieces_per_step, self.axes
        if self._time_invariant_model is None:
            return sampled_interpolation_error(x[..., :d], x[..., d:], h)
        u = np.repeat(np.moveaxis(self.applied_control[:-1], 0, 1), s, axis=1)
        return interpolation_error_bound(self._time_invariant_model, x, u, h)

    @property
    def _time_invariant_model(self) -> LinearModel | None:
        """Time-invariant linear model that was flown, if it was one."""
        plant = self.mission.flown_plant
        if isinstance(plant, LinearPlant) and plant.model.is_time_invariant:
            return plant.model
        return None


def _read_chief(data: "xarray.Dataset") -> Float[Array, "instants elements"] | None:
    if "chief" not in data:
        return None
    return np.asarray(data["chief"].sel(element=list(CHIEF_ELEMENTS)), dtype=float)


_STATE_PARTS = ("position", "velocity")
