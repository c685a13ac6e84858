"""Recorded run, beside the mission that its own scenario describes."""

import tomllib
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray as Array

from dynamics import trajectory_geometry
from dynamics.discretize import DiscreteModel, discretize_zoh
from dynamics.model import LinearModel
from dynamics.plant import LinearPlant
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.record import ReconfigurationVariables
from sato.reconfiguration.state import ReconfigurationFrame
from sato.record import RunRecord

if TYPE_CHECKING:
    from sato.reconfiguration.check.clearance import Clearance
    from sato.reconfiguration.check.drifts import DriftApproaches


@dataclass(frozen=True, eq=False)
class LegRecord:
    """One leg as it was flown, by the events at its start and end.

    Its last instant is the first of the next leg, which has its own targets and losses by then,
    so the agents at its end are those of its event. A leg that did not end is taken as it stood.
    """

    leg_index: int
    start_index: int  # instant at which it starts
    end_index: int  # instant at which it ends; the last of the run where it did not end
    end_event: dict[str, Any] | None  # None where the run stopped before
    entry_index: Int[Array, " agents"]  # instant from which on each agent takes part
    alive: Bool[Array, " agents"]  # at the end, as the following
    target_index: Int[Array, " agents"]
    target_count: Int[Array, " agents"]
    component: Int[Array, " agents"]

    @property
    def step_count(self) -> int:
        """Number of control steps."""
        return self.end_index - self.start_index

    @property
    def largest_target_count(self) -> int:
        """Largest number of targets that a live agent bids on, m."""
        return int(self.target_count[self.alive].max(initial=0))


class AssignmentCost(NamedTuple):
    """Fuel [m/s] or energy [m²/s³] of an assignment, without regard to collisions."""

    bound: float  # least over the choice that there was; NaN if unknown, as the others
    held: float  # of the targets held at the end
    optimum: float  # least over all assignments of these targets


class FuelBound(NamedTuple):
    """Least fuel of a leg, from its initial states, in the time that it took."""

    total: float  # of the central optimum [m/s]
    agents: Int[Array, " survivors"]
    per_agent: Float[Array, " survivors"]  # to the target that each held at the end [m/s]
    correction_fuel: Float[Array, " survivors"]  # to correct the shared model's end state [m/s]
    assignment: AssignmentCost


class Pieces(NamedTuple):
    """Cubic pieces of all trajectories, by the states at their ends."""

    state: Float[Array, "instants agents n"]
    alive: Bool[Array, "instants agents"]
    is_adrift: Bool[Array, "instants agents"]
    duration: float  # of each [s]
    error: float  # largest distance of a trajectory from its piece [m]


class ReconfigurationRecord(
    RunRecord[Reconfiguration, ReconfigurationFrame, ReconfigurationVariables]
):
    """Frames and variables of a run, and the drawn mission."""

    @cached_property
    def state(self) -> Float[Array, "instants agents n"]:
        """True positions and velocities [m, m/s]."""
        return np.concatenate([self.frames.position, self.frames.velocity], axis=-1)

    @cached_property
    def targets(self) -> Float[Array, "legs targets n"]:
        """Targets of each leg, as states; NaN where a leg has fewer."""
        parts = [self.variables.target_position, self.variables.target_velocity]
        return np.concatenate(parts, axis=-1)

    def leg_targets(self, leg: LegRecord) -> Float[Array, "targets n"]:
        """Return the targets of one leg, as states."""
        targets = self.targets[leg.leg_index]
        return np.asarray(targets[np.isfinite(targets).all(axis=1)])

    @cached_property
    def used_targets(self) -> tuple[Float[Array, "targets n"], ...]:
        """Targets of each leg that agents bid on, as states; all if the leg did not end."""
        counts = self.variables.targets_believed.max(axis=1, initial=0)
        known = [t[np.isfinite(t).all(axis=1)] for t in self.targets]
        return tuple(t[: count or len(t)] for t, count in zip(known, counts.tolist(), strict=True))

    @cached_property
    def leg_names(self) -> list[str]:
        """Name of each leg: its text, or the kind of its shape."""
        tables = tomllib.loads(str(self.attributes["scenario"])).get("leg", [])
        shapes = [table.get("shape", {}) for table in tables]
        names = [f"‘{s['text']}’" if "text" in s else str(s.get("kind", "shape")) for s in shapes]
        return names + ["shape"] * (len(self.mission.legs) - len(names))

    @cached_property
    def leg_records(self) -> tuple[LegRecord, ...]:
        """Legs that began, in order."""
        ends = {int(e["leg"]): (k, e) for k, e in self.events.of_kind("leg_end")}
        last = len(self.time) - 1, None
        found = []
        for start, event in self.events.of_kind("leg_start"):
            leg = int(event["leg"])
            found.append(self._read_leg(leg, start, *ends.get(leg, last)))
        return tuple(found)

    def _read_leg(self, leg: int, start: int, end: int, event: dict[str, Any] | None) -> LegRecord:
        frames, end = self.frames, max(start, end)
        enters = np.diff(frames.alive[start : end + 1].astype(int), axis=0, prepend=0) > 0
        entry = end - np.argmax(enters[::-1], axis=0)  # the last time
        if event is None:
            alive, targets = frames.alive[end], frames.target_index[end]
            counts, component = np.zeros_like(targets), frames.component[end]
        else:
            alive = np.zeros(len(entry), dtype=bool)
            alive[np.asarray(event["agents"], dtype=np.int64)] = True
            names = ("target", "believed", "component")
            targets, counts, component = (np.asarray(event[n], dtype=np.int64) for n in names)
        return LegRecord(leg, start, end, event, entry, alive, targets, counts, component)

    @cached_property
    def drift_approaches(self) -> "DriftApproaches | None":
        """Approaches after a loss of thrust; None where that is not asked for."""
        from sato.reconfiguration.check.drifts import find_drift_approaches

        return find_drift_approaches(self) if self.mission.is_passively_safe else None

    @cached_property
    def clearance(self) -> "Clearance | None":
        """Nearest approach to an obstacle, see `find_clearance`."""
        from sato.reconfiguration.check.clearance import find_clearance

        return find_clearance(self)

    @cached_property
    def fuel_bounds(self) -> list[FuelBound | None]:
        """Lower bound on the fuel of each leg, see `compute_fuel_bound`."""
        from sato.reconfiguration.check.fuel import compute_fuel_bound

        return [compute_fuel_bound(self, leg) for leg in self.leg_records]

    @cached_property
    def energy_bounds(self) -> list[AssignmentCost]:
        """Lower bound on the energy of each leg, see `compute_energy_bound`."""
        from sato.reconfiguration.check.fuel import compute_energy_bound

        return [compute_energy_bound(self, leg) for leg in self.leg_records]

    @cached_property
    def model(self) -> DiscreteModel:
        """Shared model from each instant to the next."""
        return discretize_zoh(self.mission.linear_model, self.mission.step, len(self.time) - 1)

    def find_left_out(self, leg: LegRecord) -> Int[Array, " targets"]:
        """Find the targets of a leg that agents left out, as they were blocked."""
        events = self.events.of_kind("blocked")
        found = [e["targets"] for k, e in events if leg.start_index <= k < leg.end_index]
        return np.unique(np.concatenate([np.zeros(0), *found])).astype(int)

    @property
    def is_flying(self) -> Bool[Array, "steps agents"]:
        """True for agents that fly a step: alive at its start, also if they are lost at its end."""
        return self.frames.alive[:-1]

    @property
    def flown_control(self) -> Float[Array, "steps agents d"]:
        """Commanded control of each step; 0 for agents that do not fly it [m/s²]."""
        return np.where(self.is_flying[..., None], self.frames.control[:-1], 0.0)

    def repropagate(self, pieces: int = 1) -> Float[Array, "steps {pieces}+1 agents n"]:
        """Propagate every recorded state by the plant under the applied control of its step.

        NaN for agents that do not fly, or without a finite control; lost ones may drift.
        """
        plant, step, x = self.mission.flown_plant, self.mission.step, self.state
        has_control = np.isfinite(self.frames.applied_control[:-1]).all(axis=2)
        is_missing = ~self.is_adrift[:-1] & ~(self.is_flying & has_control)
        is_free = is_missing | self.is_adrift[:-1]
        controls = np.where(is_free[..., None], 0.0, self.frames.applied_control[:-1])
        found = np.empty((len(controls), pieces + 1, *x.shape[1:]))
        for k, u in enumerate(controls):
            found[k] = plant.propagate(x[k], u, k * step, step, pieces)
        found[np.broadcast_to(is_missing[:, None], found.shape[:3])] = np.nan
        return found

    @cached_property
    def separations(self) -> tuple[trajectory_geometry.Separations, float]:
        """Least separation in every piece, and an allowance for the interpolation error [m].

        Pieces lie between states of the plant itself. Two agents may have been closer by twice
        the interpolation error: it is bounded where the plant is a time-invariant linear model
        (`interpolation_error_bound`), and measured elsewhere (`sampled_interpolation_error`).
        """
        x, alive, adrift, h, error = self.pieces
        p, v = np.split(x, 2, axis=-1)
        return trajectory_geometry.separations(p, v, alive, h, is_adrift=adrift), 2 * error

    @cached_property
    def relative_separations(self) -> tuple[trajectory_geometry.Separations, float]:
        """The same, relative to the distance that each pair keeps in its direction."""
        mission, (x, alive, adrift, h, error) = self.mission, self.pieces
        p, v = map(mission.scale_separations, np.split(x, 2, axis=-1))
        found = trajectory_geometry.separations(p, v, alive, h, mission.radii, adrift)
        relative = max(mission.separation_scale or (1.0,)) / mission.least_separation
        return found, 2 * error * relative

    @cached_property
    def pieces(self) -> "Pieces":
        """States at the ends of all cubic pieces."""
        count = self.pieces_per_step
        x = np.repeat(self.state, count, axis=0)[: len(self.is_flying) * count + 1]
        if count > 1:
            within = x[:-1].reshape(-1, count, *x.shape[1:])
            within[:, 1:] = self.repropagate(count)[:, 1:-1]
        flags = self.frames.alive, self.is_adrift
        alive, adrift = (np.repeat(flag, count, axis=0)[: len(x)] for flag in flags)
        error = self._interpolation_error(x, count)
        if self.clock_steps.any():
            x, alive, adrift = (
                delay_rows(part, count * self.clock_steps) for part in (x, alive, adrift)
            )
        return Pieces(x, alive, adrift, self.mission.step / count, error)

    @cached_property
    def clock_steps(self) -> Int[Array, " agents"]:
        """Steps by which the clock of each agent is behind, by which its rows are recorded."""
        steps = np.zeros(self.state.shape[1], dtype=int)
        for _, event in self.events.of_kind("clocks"):
            steps[:] = event["steps"]
        return steps

    @cached_property
    def is_adrift(self) -> Bool[Array, "instants agents"]:
        """True for agents that are lost, and fly on without control."""
        found = np.zeros_like(self.frames.alive)
        for k, event in self.events.of_kind("loss"):
            if event.get("body") == "coast":
                found[k:, np.asarray(event["agents"], dtype=int)] = True
        return found

    def refined(self) -> "ReconfigurationRecord":
        """Return the same record with twice as many cubic pieces per step."""
        finer = replace(self)
        finer.__dict__["pieces_per_step"] = 2 * self.pieces_per_step
        return finer

    @cached_property
    def pieces_per_step(self) -> int:
        """Cubic pieces per step: one where a cubic is exact, else at most a second each.

        At most a quarter of the shortest time constant of the model each, and an even number
        where the interpolation error is measured instead of bounded.
        """
        step = self.mission.step
        model = self._time_invariant_model
        if model is None:
            return 2 * int(np.ceil(step / 2))
        finest = max(1.0, 4 * float(np.abs(np.linalg.eigvals(model.A(0.0))).max()))
        return 1 if self._interpolation_error(self.state, 1) == 0 else int(np.ceil(finest * step))

    def _interpolation_error(self, x: Float[Array, "instants agents n"], pieces: int) -> float:
        x, h, d = np.moveaxis(x, 0, 1), self.mission.step / pieces, self.mission.axes
        model = self._time_invariant_model
        if model is None:
            return trajectory_geometry.sampled_interpolation_error(x[..., :d], x[..., d:], h)
        u = np.repeat(self.frames.applied_control[:-1], pieces, axis=0)
        return trajectory_geometry.interpolation_error_bound(model, x, np.moveaxis(u, 0, 1), h)

    @property
    def _time_invariant_model(self) -> LinearModel | None:
        plant = self.mission.flown_plant
        if isinstance(plant, LinearPlant) and plant.model.is_time_invariant:
            return plant.model
        return None


def delay_rows(
    recorded: Shaped[Array, "instants agents *k"], steps: Int[Array, " agents"]
) -> Shaped[Array, "later agents *k"]:
    """Return what agents did by one clock, where theirs are behind by some steps.

    Before it begins, and after it ends, each is as at the first or the last instant.
    """
    count, most = len(recorded), int(steps.max())
    instant = np.clip(np.arange(count + most)[:, None] - steps, 0, count - 1)
    return np.asarray(recorded[instant, np.arange(len(steps))])
