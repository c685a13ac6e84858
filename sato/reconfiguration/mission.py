"""Definition of a reconfiguration: who starts where, what shapes are wanted, how it is planned."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance
from sato.reconfiguration import feasibility, link_feasibility, models, own_motion, vehicles
from sato.reconfiguration.leg import Leg, states_of
from sato.reconfiguration.planned_limits import PlannedLimits
from sato.reconfiguration.start import start_without_files
from sato.scenario.definition import Count, errors_in, is_auto
from sato.shapes import Points

WHOLE_LEG = 10**9  # steps, more than a leg has


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Reconfiguration(PlannedLimits):
    """A swarm that takes up one shape after another [Morgan2016, Method 3].

    Args:
        model: Equations of motion: of the library, or any `LinearModel` or `NonlinearModel`.
        start: Array of (N, d) positions or (N, 2 d) states, or a start or shape.
        legs: Reconfigurations, one after another.

    All others are explained by `sato keys reconfiguration`. Values are in SI units.
    """

    system: ClassVar[str] = "reconfiguration"

    @classmethod
    def with_defaults(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Refuse an orbital model without a chief, before the keys of the model are read."""
        model = data.get("model")
        if isinstance(model, dict):
            models.check_orbital_model(
                model.get("kind"), "chief" in data or "mean_motion_rad_s" in model
            )
        return data

    def completed(self) -> dict[str, Any]:
        """Return what follows from the other fields where it is not given."""
        model, chief = models.as_definition(self.model, self.chief)
        values: dict[str, Any] = {"model": model, "chief": chief}
        if self.agents is None and isinstance(self.start, Points):
            with errors_in("swarm.start"):
                values["agents"] = len(self.start.listed)
        return values

    def choices(self) -> dict[str, Any]:
        """Return periods, and the rules of the auction, where they are not given."""
        tie_break, reset = (0.0, "change") if self.printed else (0.2, "need")
        plain = {"bidder_ids": not self.printed, "tie_break": tie_break, "reset": reset}
        values = {name: value for name, value in plain.items() if getattr(self, name) is None}
        if self.replan_steps is None and self.printed:
            values["replan_steps"] = self.horizon_steps
        elif self.replan_steps is None:
            wrong = self.disturbance, self.thrust_error, self.pointing_error
            is_disturbed = not self.flies_model or (any(wrong) and not self.is_point_mass)
            values["replan_steps"] = 1 if is_disturbed else self._longest_period()
        if self.auction_steps is None:
            period = values.get("replan_steps", self.replan_steps)
            values["auction_steps"] = max(self.horizon_steps // period, 1) * period
        return values

    def _longest_period(self) -> int:
        # Half of the horizon, so that avoidance looks beyond the next decision, or less where a
        # vehicle at full speed could not stop within reach, or auctions come more often.
        if self.is_point_mass:
            vehicles.check_limits(self)
        fastest, margin = float(self.top_speeds.max()), self.known_margin
        skewed = self.link.skew * fastest if self.link.skew and not self.has_margin else 0.0
        for period in range(self.horizon_steps // 2, 1, -1):
            if (self.auction_steps or period) % period:
                continue
            if self.is_point_mass and self.has_noise and not self.has_margin:
                from sato.reconfiguration.tolerances import compute_random_margin

                margin = compute_random_margin(self, period)
            if self.speed_within_reach(period, margin + skewed) >= fastest:
                return period
        return 1

    def check(self) -> None:
        """Refuse fields that contradict each other, and legs without targets enough."""
        models.check_motion(self.model, self.chief, self.plant)
        steps = sum(leg.steps for leg in self.legs if not is_auto(leg.steps))
        own_motion.check_own_motion(self.model, self.plant, self.step, steps)
        vehicles.check_limits(self)
        vehicles.check_automatic_steps(self)
        feasibility.check(self)

    def draw(self, rng: np.random.Generator) -> "Reconfiguration":
        """Return the mission with drawn starts, resolved margins, tolerances and plant."""
        from sato.reconfiguration.draw import draw

        return draw(self, rng)

    def warnings(self) -> list[str]:
        """List doubts about a drawn mission, a sentence each."""
        from sato.reconfiguration import tolerances

        doubts = feasibility.list_doubts(self) + link_feasibility.list_doubts(self)
        doubts += tolerances.arrival_doubts(self)
        if self.tracking is not None:
            return doubts + tolerances.tracking_doubts(self)
        if self.chief is None or self.nonlinear_model is not None or self.flies_model:
            return doubts
        return doubts + tolerances.model_doubts(self, self.chief)

    def without_files(self) -> "Reconfiguration":
        """Return the same mission with the contents of files and fonts."""
        legs = []
        for leg, most in zip(self.legs, feasibility.target_demand(self), strict=True):
            joins = tuple(
                replace(join, start=start_without_files(join.start, join.size, self.axes))
                for join in leg.joins
            )
            shape = leg.place(most, self.axes) if leg.shape.uses_files else leg.shape
            legs.append(replace(leg, shape=shape, joins=joins))
        start = start_without_files(self.start, self.agent_count, self.axes)
        return replace(self, start=start, legs=tuple(legs))

    @property
    def has_surroundings(self) -> bool:
        """True where there is anything to avoid but each other."""
        return bool(self.obstacles) or self.box is not None or self.has_unseen

    @property
    def agent_count(self) -> int:
        """Number of agents at the start."""
        assert self.agents is not None
        return self.agents

    @property
    def foresight(self) -> int:
        """Steps that avoidance looks ahead among agents in hearing, but no farther than the leg.

        Where drifts keep a distance from the plans of others, these go to the end of the leg.
        """
        if self.foresight_steps is not None and not self.is_passively_safe:
            return self.foresight_steps
        return WHOLE_LEG if self.keeps_plans or not (self.is_point_mass or self.printed) else 0

    @property
    def is_passively_safe(self) -> bool:
        """True where drifts after a loss of thrust keep a distance."""
        return self.passive_safety is not None

    @property
    def keeps_plans(self) -> bool:
        """True where plans that are clear to their ends are flown to their ends.

        Double integrators do, if they fly as modeled: nothing changes what they, or with noise
        their references, would fly.
        """
        is_exact = self.is_point_mass and self.flies_model and not self.printed
        return is_exact and self.assignment != "central" and self.orders == 1

    @property
    def commits(self) -> bool:
        """True where agents that can stop fly only trajectories that they have found clear."""
        return self.is_point_mass and not self.printed

    @property
    def has_own_clocks(self) -> bool:
        """True where each agent has a clock of its own, and not one with its component."""
        return self.keeps_plans and self.assignment == "given"

    @property
    def assignment_steps(self) -> int:
        """Steps between decisions on targets and clocks; the least between two, for kept plans."""
        return self.replan_steps if self.keeps_plans else self.auction_steps

    @cached_property
    def initial_states(self) -> Float[Array, "agents n"]:
        """States in which all agents start, in SI units, those that join last; once drawn."""
        joins = [states_of(join.start) for leg in self.legs for join in leg.joins]
        return np.concatenate([states_of(self.start), *joins])

    def uses_all_targets(self, leg: Leg) -> bool:
        """Tell whether agents look at all targets of a leg, and not only at the first m."""
        return leg.is_free or self.assignment == "given"

    @property
    def alive(self) -> Bool[Array, " agents"]:
        """True for agents that are there at the start."""
        return np.arange(len(self.initial_states)) < self.agent_count

    def joining(self, number: Count) -> list[tuple[list[int], int]]:
        """List the joins of a leg: indices of the agents, and the step at which they join."""
        first = self.agent_count
        found: list[tuple[list[int], int]] = []
        for leg in self.legs[: number + 1]:
            found = []
            for join in leg.joins:
                found.append((list(range(first, first + join.size)), join.at_step))
                first += join.size
        return found

    @cached_property
    def waits(self) -> Bool[Array, " agents"]:
        """True for agents that wait to join where there is no room; false for all others."""
        joins = [join for leg in self.legs for join in leg.joins]
        rooms = np.repeat([join.room == "wait" for join in joins], [join.size for join in joins])
        return np.concatenate([np.zeros(self.agent_count, dtype=bool), rooms.astype(bool)])

    @cached_property
    def target_spacing(self) -> float:
        """Least distance between two targets of a leg [m]; once drawn."""
        places = (leg.targets[:, : self.axes] for leg in self.legs)
        return min(min_distance(self.scale_separations(place)) for place in places)

    @property
    def keeps_targets_by_pair(self) -> bool:
        """True where it is known which two vehicles stand at two targets, and they are unequal."""
        return self.assignment == "given" and not self.has_equal_radii

    def find_tightest(self, targets: Float[Array, "targets n"]) -> tuple[float, float]:
        """Find the two targets with the least room: their distance, and R of their vehicles [m].

        Args:
            targets: Positions [m] and velocities [m/s].
        """
        place, R = self.scale_separations(targets[:, : self.axes]), self.largest_separation
        count = min(len(place), self.vehicle_count)
        if not self.keeps_targets_by_pair or count < 2:
            return min_distance(place), R
        i, j = np.triu_indices(count, 1)
        distance = np.linalg.norm(place[i] - place[j], axis=1)
        kept = (self.radii[i] + self.radii[j]) / 2
        k = int((distance - kept).argmin())
        return float(distance[k]), float(kept[k])
