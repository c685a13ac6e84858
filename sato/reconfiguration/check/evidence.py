"""What a run file holds, as arrays, beside the mission that its own text describes."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretise import Steps, hold
from dynamics.model import LinearModel
from dynamics.path import Separations, error_bound, missed_by_halves, separations
from dynamics.plant import Modelled
from sato.check.happened import Happened
from sato.reconfiguration.log import ELEMENTS
from sato.reconfiguration.mission import Reconfiguration

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class Stretch:
    """One leg as it was flown, told by the events at its ends."""

    leg: int
    first: int  # instant at which it starts
    last: int  # instant at which it ends; the last of the run where it never did
    end: dict[str, Any] | None  # the event at its end; None where the run stopped before

    @property
    def steps(self) -> int:
        """Control steps that it took."""
        return self.last - self.first


@dataclass(frozen=True, eq=False)
class Evidence:
    """A run as recorded, and the mission rebuilt from its scenario."""

    mission: Reconfiguration
    attributes: dict[str, Any]
    time: Float[Array, " instants"]
    state: Float[Array, "instants agents n"]
    alive: Bool[Array, "instants agents"]
    component: Int[Array, "instants agents"]
    control: Float[Array, "instants agents d"]
    applied: Float[Array, "instants agents d"]
    measured: Float[Array, "instants agents n"] | None  # where it differs from the state
    leg: Int[Array, " instants"]
    target: Int[Array, "instants agents"]
    goals: Float[Array, "legs targets n"]  # states; NaN where a leg has fewer
    believed: Int[Array, "legs agents"]
    chief: Float[Array, "instants elements"] | None  # the six of its orbit, where there is one
    happened: Happened

    @classmethod
    def of(cls, data: "xarray.Dataset", mission: Reconfiguration) -> "Evidence":
        """Read a run's data."""

        def both(name: str) -> Array:
            parts = [np.asarray(data[f"{name}{part}"], dtype=float) for part in _PARTS]
            return np.concatenate(parts, axis=-1)

        return cls(
            mission=mission,
            attributes={str(k): v for k, v in data.attrs.items()},
            time=np.asarray(data["time"], dtype=float),
            state=both(""),
            alive=np.asarray(data["alive"], dtype=bool),
            component=np.asarray(data["component"]),
            measured=both("measured_") if "measured_position" in data else None,
            control=np.asarray(data["control"], dtype=float),
            applied=np.asarray(data["applied_control"], dtype=float),
            leg=np.asarray(data["leg"]),
            target=np.asarray(data["target"]),
            goals=both("target_"),
            believed=np.asarray(data["targets_believed"]),
            chief=_chief(data),
            happened=Happened.of(data),
        )

    @property
    def axes(self) -> int:
        """Axes of space."""
        return self.mission.model.axes

    @property
    def position(self) -> Float[Array, "instants agents d"]:
        """True positions [m]."""
        return self.state[..., : self.axes]

    @property
    def velocity(self) -> Float[Array, "instants agents d"]:
        """True velocities [m/s]."""
        return self.state[..., self.axes :]

    @cached_property
    def stretches(self) -> tuple[Stretch, ...]:
        """The legs that were begun, in order."""
        ends = {int(e["leg"]): (k, e) for k, e in self.happened.told("leg_end")}
        found = []
        for first, event in self.happened.told("leg_start"):
            leg = int(event["leg"])
            last, end = ends.get(leg, (len(self.time) - 1, None))
            found.append(Stretch(leg, first, max(first, last), end))
        return tuple(found)

    @cached_property
    def steps(self) -> Steps:
        """The shared model from each instant to the next."""
        return hold(self.mission.model, self.mission.step, len(self.time) - 1)

    @cached_property
    def flies(self) -> Bool[Array, "steps agents"]:
        """Who flies each step: those alive at its start, also if they are lost at its end."""
        return self.alive[:-1]

    def flown(self, pieces: int = 1) -> Float[Array, "steps {pieces}+1 agents n"]:
        """Every step flown again by the plant, from the recorded state by the applied control.

        NaN for who does not fly, and for whom numbers are lacking.
        """
        mission, agents = self.mission, self.state.shape[1]
        found = np.empty((len(self.flies), pieces + 1, agents, self.state.shape[2]))
        lacking = ~self.flies | ~np.isfinite(self.applied[:-1]).all(axis=2)
        u = np.where(lacking[..., None], 0.0, self.applied[:-1])
        for k, x in enumerate(self.state[:-1]):
            found[k] = mission.truth.fly(x, u[k], k * mission.step, mission.step, pieces)
        found[np.broadcast_to(lacking[:, None], found.shape[:3])] = np.nan
        return found

    @cached_property
    def refinement(self) -> int:
        """Pieces a step is cut into: one where a cubic is exact, else a second long at most.

        Where what they miss is measured, there is an even number of them.
        """
        step = self.mission.step
        if self._constant is None:
            return 2 * int(np.ceil(step / 2))
        x, u = np.moveaxis(self.state, 0, 1), np.moveaxis(self.applied[:-1], 0, 1)
        return 1 if error_bound(self._constant, x, u, step) == 0 else int(np.ceil(step))

    @cached_property
    def pieces(self) -> tuple[Separations, float]:
        """The closest two agents of every piece, and how much closer they may have been.

        Pieces lie between states of the plant itself. That two agents may have been closer
        by twice of what one piece misses is proven where the plant is a model with constant
        matrices (`error_bound`) and measured elsewhere (`missed_by_halves`).
        """
        s, d = self.refinement, self.axes
        h = self.mission.step / s
        x = np.repeat(self.state, s, axis=0)[: (len(self.state) - 1) * s + 1]
        if s > 1:
            flown = self.flown(s)
            for j in range(1, s):
                x[j::s] = flown[:, j]
        alive = np.vstack([np.repeat(self.flies, s, axis=0), self.alive[-1:]])
        found = separations(x[..., :d], x[..., d:], alive, h)
        return found, 2 * self._missed(np.moveaxis(x, 0, 1), h)

    def _missed(self, x: Float[Array, "agents instants n"], h: float) -> float:
        s, d = self.refinement, self.axes
        if self._constant is None:
            return missed_by_halves(x[..., :d], x[..., d:], h)
        u = np.repeat(np.moveaxis(self.applied[:-1], 0, 1), s, axis=1)
        return error_bound(self._constant, x, u, h)

    @property
    def _constant(self) -> LinearModel | None:
        """The model with constant matrices that flew, if it was one."""
        plant = self.mission.truth
        return plant.model if isinstance(plant, Modelled) and plant.model.constant else None


def _chief(data: "xarray.Dataset") -> Float[Array, "instants elements"] | None:
    if "chief" not in data:
        return None
    return np.asarray(data["chief"].sel(element=list(ELEMENTS)), dtype=float)


_PARTS = ("position", "velocity")
