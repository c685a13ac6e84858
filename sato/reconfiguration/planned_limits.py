"""Limits of plans: what noise, margins and the reach of hearing leave of those of the vehicles."""

from dataclasses import replace
from functools import cached_property
from math import inf
from typing import Annotated, Any

from jaxtyping import Int
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel
from problems.limit import Limit
from problems.transfer import TransferProblem
from sato.reconfiguration.tracking import (
    MAX_RESERVE,
    RESERVE_SIGMAS,
    TrackingDeviations,
    compute_deviations,
    largest_disturbance,
    measurement_deviations,
)
from sato.reconfiguration.vehicles import Vehicles
from sato.scenario.definition import Count, Positive, is_auto


class PlannedLimits(Vehicles):
    """Properties that follow from the limits of a mission, its noise and its margin."""

    @property
    def lag_steps(self) -> int:
        """Steps from the beginning of a decision until what is decided is flown."""
        return self.decision_period if self.link.round > 0 else 0

    @property
    def decision_period(self) -> int:
        """Steps from one decision to the next, also where they are still automatic."""
        return self.replan_steps or int(self.choices()["replan_steps"])

    @property
    def decision_rounds(self) -> int:
        """Rounds of the network until a decision has to be made; 0 where they take no time."""
        left = self.lag_steps * self.step - self.compute
        return int(self.link.count_rounds(max(left, 0.0))) if self.lag_steps else 0

    @property
    def sight(self) -> float:
        """Distance within which what is not known is seen [m]."""
        return self.comm_radius if self.sensing_radius is None else self.sensing_radius

    @property
    def has_unseen(self) -> bool:
        """True where there is anything that agents do not know of before they see it."""
        coasts = any(loss.body == "coast" for leg in self.legs for loss in leg.losses)
        return coasts or not all(obstacle.known for obstacle in self.obstacles)

    @property
    def has_noise(self) -> bool:
        """True where motion or measurements are disturbed at random."""
        noise = self.position_noise, self.velocity_noise, self.disturbance
        return any((*noise, self.thrust_error, self.pointing_error))

    @cached_property
    def tracking(self) -> TrackingDeviations | None:
        """Deviations from references; None where agents plan from their estimates."""
        return self.tracking_after(0)

    def tracking_after(self, steps: Count) -> TrackingDeviations | None:
        """Return deviations from references that are at least so many steps old.

        Double integrators have references if they fly as modeled, but for noise.
        """
        if not (self.is_point_mass and self.flies_model and self.has_noise) or self.printed:
            return None
        measured, pushed = measurement_deviations(self), largest_disturbance(self)
        return compute_deviations(self.step, *measured, pushed, steps)

    def planned_control_limit(self, agent: Count) -> Limit:
        """Return the limit of the acceleration in the plans of an agent [m/s²].

        They leave a part of it to the feedback that keeps it near its reference.
        """
        return self._planned_control_limits[agent % len(self.control_limits)]

    def group_by_limit(
        self, agents: Int[Array, " agents"]
    ) -> list[tuple[Limit, Int[Array, " rows"]]]:
        """Return each limit of the acceleration in plans, and the rows of agents that have it."""
        groups = self.group_by_limits(agents)
        return [(self.planned_control_limit(int(agents[some[0]])), some) for some in groups]

    @cached_property
    def _planned_control_limits(self) -> tuple[Limit, ...]:
        return tuple(self._leave_reserve(limit) for limit in self.control_limits)

    def _leave_reserve(self, limit: Limit) -> Limit:
        # Of the sum of all axes, the feedback is that of each times the root of their number.
        wide = self.axes**0.5 if limit.norm == 1 else 1.0
        share = min(wide * self.reserve / float(limit.most * limit.shares.min()), MAX_RESERVE)
        return replace(limit, bound=limit.bound * (1 - share)) if share else limit

    @property
    def reserve(self) -> float:
        """Acceleration along each axis that feedback takes for noise [m/s²]."""
        return 0.0 if self.tracking is None else RESERVE_SIGMAS * self.tracking.feedback

    @property
    def has_margin(self) -> bool:
        """True where the margin is a number, and not still to be computed."""
        return self.margin is not None and not is_auto(self.margin)

    @property
    def known_margin(self) -> float:
        """Margin beyond the collision radius; 0 while it is still to be computed [m]."""
        return float(self.margin) if self.has_margin else 0.0

    @property
    def reaching_key(self) -> str:
        """Key of the radius that bounds how far vehicles know."""
        is_sight = self.has_unseen and self.sight < self.comm_radius
        return "swarm.sensing_radius_m" if is_sight else "swarm.comm_radius_m"

    def reach_unheard(self, margin: float) -> float:
        """Return how far vehicles may fly on before they could meet what they do not know [m].

        Others that they do not hear, which fly as far, n = 2, or also before a clock that is
        behind says so, n = 3; or what rests beyond their sensing radius, n = 1. At their speed V
        they have come nearer before they know, and before they fly by what they decide:

            r = (R_comm − R)/n − V (2 τ + L Δt)     [m]
        """
        if self.allow_undetectable or self.printed:
            return inf
        rooms = self._list_rooms(self.decision_period, margin)
        if self.link.is_ideal:
            return min(room for room, _ in rooms)
        V = self.fastest_plans(self.decision_period, margin)
        return min(room - V * delay for room, delay in rooms)

    def _list_rooms(self, steps: Count, margin: float) -> list[tuple[float, float]]:
        """List the ways that n vehicles share (R_comm − R)/n [m], and delays 2 τ + L Δt [s].

        τ is the time for which one may go unheard, and clocks may differ. What is decided is flown
        from L steps on: the replanning period, where rounds take time, or 0.
        """
        kept, link = self.distance_unheard(margin), self.link
        waits = steps * self.step if link.round else 0.0
        unheard = 2 * (link.silent_rounds * link.round + link.skew)
        rooms = [((self.comm_radius - kept) / self.sharing_unheard, unheard + waits)]
        return [*rooms, (self.sight - kept, waits)] if self.has_unseen else rooms

    @property
    def sharing_unheard(self) -> int:
        """Number n of ways that the distance of two that do not hear each other is enough for."""
        return 3 if self.link.skew else 2

    def distance_unheard(self, margin: float) -> float:
        """Return the least of R_comm, with which vehicles could not move at all [m]."""
        # The references of two may be nearer than these by a margin, and keep another.
        kept = self.largest_separation + margin * (1 if self.tracking is None else 2)
        return kept * self.widest_axis

    def speed_within_reach(
        self, steps: Count, margin: float, control_factor: Annotated[float, Positive] = 1.0
    ) -> float:
        """Return a speed from which vehicles stop before they meet others that they do not hear.

        They fly on for so many steps h, and stop at the least control U of plans in whole steps.
        The margin is in R [m]:

            V n h + V²/2U + V h/2 ≤ r(V)     [m]
        """
        if not self.is_point_mass or self.allow_undetectable or self.printed:
            return inf
        U, speeds = control_factor * self.least_braking, []
        for room, delay in self._list_rooms(steps, margin):
            t = (steps + 0.5) * self.step + delay
            speeds.append(U * ((t**2 + 2 * max(room, 0.0) / U) ** 0.5 - t))
        return float(min(speeds))

    def fastest_plans(self, steps: Count, margin: float) -> float:
        """Return the largest speed of any plan, where vehicles fly on for so many steps [m/s]."""
        return min(float(self.top_speeds.max()), self.speed_within_reach(steps, margin))

    def skew_margin(self, margin: float) -> float:
        """Return by how much two come nearer than planned as their clocks differ [m]."""
        skew = self.link.skew
        return skew * self.fastest_plans(self.decision_period, margin) if skew else 0.0

    @property
    def least_braking(self) -> float:
        """Least deceleration of any vehicle in plans, whatever its direction [m/s²]."""
        agents = range(len(self.control_limits))
        return min(self.planned_control_limit(i).least_length for i in agents)

    @property
    def slow_speed(self) -> float | None:
        """Speed to which plans keep where vehicles could not stop within reach from more [m/s]."""
        slow = self.speed_within_reach(self.decision_period, self.known_margin)
        return slow if 0 < slow < self.top_speeds.max() else None

    @property
    def radius_for_full_speed(self) -> float:
        """Communication radius with which vehicles stop within reach from full speed [m]."""
        V, t = float(self.top_speeds.max()), (self.decision_period + 0.5) * self.step
        return self.radius_for_way(V * t + V**2 / (2 * self.least_braking))

    def radius_for_way(self, way: float) -> float:
        """Return the communication radius that lets vehicles at full speed fly on so far [m]."""
        V, margin = float(self.top_speeds.max()), self.known_margin
        [(_, delay), *_] = self._list_rooms(self.decision_period, margin)
        if delay:
            way += V * delay
            margin += self.link.skew * (V - self.fastest_plans(self.decision_period, margin))
        return self.distance_unheard(margin) + self.sharing_unheard * way

    def planned_speed_limit(
        self, agent: Count, control_factor: Annotated[float, Positive] = 1.0
    ) -> Limit:
        """Return the limit of the velocity in the plans of an agent [m/s].

        Where it could not stop within reach from full speed, it plans to fly more slowly.
        """
        limit = self.speed_limit(agent)
        slow = self.speed_within_reach(self.decision_period, self.known_margin, control_factor)
        if slow >= limit.largest_length or slow == 0:
            return limit
        if limit.largest_length < inf:
            return replace(limit, bound=limit.bound * (slow / limit.largest_length))
        diagonal = self.axes**0.5 if self.speed_norm == "inf" else 1.0
        return replace(limit, bound=slow / diagonal)

    def stop_speed_limit(self, agent: Count) -> Limit:
        """Return the limit of the velocity in stops and evasions of an agent [m/s].

        Its own, unless its reach counts on its speed, as where messages are late.
        """
        return self.speed_limit(agent) if self.link.is_ideal else self.planned_speed_limit(agent)

    def make_transfer(self, model: DiscreteModel, agent: Count, **more: Any) -> TransferProblem:
        """Make the transfer problem of an agent over some steps, at the speed of stops at most."""
        names = "fuel_norm", "control_norm", "speed_norm"
        options: dict[str, Any] = {name: getattr(self, name) for name in names}
        options |= {"max_control": self.planned_control_limit(agent).bound}
        options |= {"max_speed": self.stop_speed_limit(agent).bound}
        return TransferProblem(model, **(options | more))
