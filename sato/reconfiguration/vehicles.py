"""Limits of the vehicles of a mission: the same for all, one a vehicle, or one an axis."""

from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.limit import Limit, Norm
from sato.reconfiguration.fields import ReconfigurationFields
from sato.scenario.definition import Count
from sato.scenario.errors import InputError


class Vehicles(ReconfigurationFields):
    """Properties that follow from the limits of a mission.

    Agents that join later come after those of the start, in the order of legs and joins.
    """

    @property
    def ellipsoid(self) -> tuple[float, ...] | None:
        """Semi-axes of the ellipsoid that two keep, over R; None where it is a ball."""
        if self.separation_semi_axes is None:
            return self.separation_axes
        return tuple(axis / self.largest_separation for axis in self.separation_semi_axes)

    @property
    def separation_scale(self) -> tuple[float, ...] | None:
        """Factors by which the ellipsoid that two keep becomes a ball; None where it is one."""
        axes = self.ellipsoid
        return None if axes is None else tuple(1.0 / a for a in axes)

    @property
    def widest_axis(self) -> float:
        """Largest semi-axis of the ellipsoid that two keep, over R."""
        return 1.0 if self.ellipsoid is None else max(self.ellipsoid)

    def scale_separations(self, vectors: Float[Array, "*k d"]) -> Float[Array, "*k d"]:
        """Return vectors between vehicles whose lengths two keep R apart."""
        scale = self.separation_scale
        return vectors if scale is None else vectors * np.array(scale)

    @property
    def vehicle_count(self) -> int:
        """Number of agents, those that join later included."""
        return (self.agents or 1) + sum(join.size for leg in self.legs for join in leg.joins)

    @cached_property
    def radii(self) -> Float[Array, " vehicles"]:
        """Collision radius R of each vehicle; two keep (R_i + R_j)/2 [m]."""
        return np.array(np.broadcast_to(self.collision_radius, self.vehicle_count), dtype=float)

    def radius(self, agent: Count) -> float:
        """Return an agent's collision radius; of equal ones any number has it [m]."""
        return float(self.radii[agent % len(self.radii)])

    @property
    def has_equal_radii(self) -> bool:
        """True where all pairs keep the same distance."""
        return not isinstance(self.collision_radius, tuple)

    @property
    def has_own_separations(self) -> bool:
        """True where the distance that two keep depends on the pair, or on the direction."""
        return not self.has_equal_radii or self.ellipsoid is not None

    @property
    def largest_separation(self) -> float:
        """Largest distance that any two keep [m]."""
        return float(np.sort(np.atleast_1d(self.collision_radius))[-2:].mean())

    @property
    def least_separation(self) -> float:
        """Least distance that any two keep [m]."""
        return float(np.sort(np.atleast_1d(self.collision_radius))[:2].mean())

    def own_clearances(
        self, clearance: float, agents: Int[Array, " agents"]
    ) -> Float[Array, " agents"]:
        """Return the distance that two of each agent's kind keep [m].

        The clearance is what any two keep, whatever their radii [m].
        """
        if self.has_equal_radii:
            return np.full(len(agents), clearance)
        try:
            return np.asarray(clearance + (self.radii[agents] - self.largest_separation))
        except IndexError as error:
            raise InputError("agents", f"must be below {len(self.radii)}, {error}") from error

    @cached_property
    def control_limits(self) -> tuple[Limit, ...]:
        """Limit of each vehicle's acceleration [m/s²]; a single one where all are equal."""
        return _limits(self.max_control, self.max_control_axes, self.control_norm, self.axes)

    @cached_property
    def speed_limits(self) -> tuple[Limit, ...]:
        """Limit of each vehicle's velocity [m/s]; a single one where all are equal."""
        return _limits(self.max_speed, self.max_speed_axes, self.speed_norm, self.axes)

    def control_limit(self, agent: Count) -> Limit:
        """Return the limit of an agent's acceleration [m/s²]."""
        return self.control_limits[agent % len(self.control_limits)]

    def speed_limit(self, agent: Count) -> Limit:
        """Return the limit of an agent's velocity [m/s]."""
        return self.speed_limits[agent % len(self.speed_limits)]

    @cached_property
    def largest_control(self) -> Float[Array, " axes"]:
        """Largest acceleration of any vehicle along each axis [m/s²]."""
        return np.asarray(
            np.max([limit.most * limit.shares for limit in self.control_limits], axis=0)
        )

    @property
    def least_control(self) -> float:
        """Least limit of the acceleration of any vehicle along any axis [m/s²]."""
        return min(float(limit.most * limit.shares.min()) for limit in self.control_limits)

    @property
    def top_speeds(self) -> Float[Array, " vehicles"]:
        """Largest Euclidean speed of each vehicle, or a single one [m/s]."""
        return np.array([limit.largest_length for limit in self.speed_limits])

    def require_equal_vehicles(self, what: str) -> None:
        """Refuse vehicles with radii or limits of their own; `what` is for equal ones."""
        for where, parts, is_equal in (
            ("model.max_control_m_s2", "limits", len(self.control_limits) == 1),
            ("model.max_speed_m_s", "limits", len(self.speed_limits) == 1),
            ("swarm.collision_radius_m", "radii", self.has_equal_radii),
        ):
            if not is_equal:
                reason = f"is a list, and {what} is for vehicles with equal {parts}"
                raise InputError(where, f"{reason}; a number would do")

    def group_by_limits(self, agents: Int[Array, " k"]) -> list[Int[Array, "..."]]:
        """Group agents that have the same limits, as indices into the agents that are given."""
        if len(self.control_limits) == len(self.speed_limits) == 1:
            return [np.arange(len(agents))] if len(agents) else []
        limits = [(self.control_limit(i).most, self.speed_limit(i).most) for i in agents.tolist()]
        _, group = np.unique(np.array(limits), axis=0, return_inverse=True)
        return [np.flatnonzero(group == g) for g in range(int(group.max(initial=-1)) + 1)]


def check_limits(mission: Any) -> None:
    """Refuse limits that are missing, given twice, or of the wrong length."""
    control, speed = mission.max_control_axes, mission.max_speed_axes
    if mission.max_control is None and control is None:
        missing = "is missing, and has no default; it or max_control_axes_m_s2 would do"
        raise InputError("model.max_control_m_s2", missing)
    for name, unit, axes, norm, is_given in (
        ("max_control", "m_s2", control, "control_norm", mission.max_control is not None),
        ("max_speed", "m_s", speed, "speed_norm", mission.max_speed != np.inf),
    ):
        if axes is None:
            continue
        where = f"model.{name}_axes_{unit}"
        if is_given:
            raise InputError(where, f"is given beside {name}_{unit}; one of the two is enough")
        _check_entries(where, axes, mission.axes)
        if getattr(mission, norm) != "inf":
            reason = f'{norm} = {getattr(mission, norm)}; {norm} = "inf" would do'
            raise InputError(where, f"limits each axis by itself, and there is {reason}")
    if mission.agents is None:
        return
    count = mission.vehicle_count
    _check_ellipsoid(mission)
    for where, value in (
        ("swarm.collision_radius_m", mission.collision_radius),
        ("swarm.priority", mission.priority),
        ("model.max_control_m_s2", mission.max_control),
        ("model.max_speed_m_s", mission.max_speed),
    ):
        if isinstance(value, tuple) and len(value) != count:
            reason = f"has {len(value)} entries for {count} vehicles, those that join included"
            raise InputError(where, f"{reason}; {count} entries would do")
    if mission.bargains and mission.priority is not None:
        reason = "in a negotiation vehicles of higher swarm.priority would give way too"
        raise InputError("plan.bargains", f"{reason}; bargains = 0, or no priorities, would do")


def _check_ellipsoid(mission: Any) -> None:
    """Refuse ratios that look like meters, and an ellipsoid that is given twice, or to others."""
    ratios, meters = mission.separation_axes, mission.separation_semi_axes
    given = ratios if meters is None else meters
    where = "model.separation_axes" + ("" if meters is None else "_m")
    if given is None:
        return
    if None not in (ratios, meters):
        raise InputError(where, "is given beside separation_axes; one of the two is enough")
    _check_entries(where, given, mission.axes)
    if not mission.is_point_mass:
        reason = "is for double integrators; swarm.collision_radius_m would do"
        raise InputError(where, reason)
    if meters is not None and not mission.has_equal_radii:
        reason = "is for vehicles with equal radii; separation_axes, a ratio to them, would do"
        raise InputError(where, reason)
    if ratios is not None and all(abs(ratio - 1) > 1e-9 for ratio in ratios):
        R = mission.largest_separation
        axes, kept = (
            ", ".join(f"{a:.6g}" for a in row) for row in (ratios, [R * a for a in ratios])
        )
        reason = f"are ratios to collision_radius_m = {R:g}, one of them 1: {axes} keep {kept} m"
        cure = f"separation_axes_m = [{axes}], in Python separation_semi_axes, keeps {axes} m"
        raise InputError(where, f"{reason}; {cure}")


def _check_entries(where: str, values: tuple[float, ...], axes: int) -> None:
    if len(values) != axes:
        raise InputError(where, f"has {len(values)} entries, and the model has {axes} axes")
    if min(values) <= 0:
        raise InputError(where, f"must be greater than 0, got {min(values):g}")


def check_automatic_steps(mission: Any) -> None:
    """Refuse automatic steps of later legs where unequal vehicles may stand at any target."""
    is_equal = len(mission.control_limits) == len(mission.speed_limits) == 1
    for number, leg in enumerate(mission.legs):
        if number and leg.steps == "auto" and not is_equal and mission.assignment != "given":
            reason = "is for vehicles with equal limits, or given targets, after the first leg"
            raise InputError(f"leg.{number}.steps", f'"auto" {reason}; a number would do')


def _limits(
    limits: float | tuple[float, ...] | None,
    limits_of_axes: tuple[float, ...] | None,
    norm: Norm,
    axes: int,
) -> tuple[Limit, ...]:
    bounds: Any = limits if isinstance(limits, tuple) else (limits,)
    bounds = bounds if limits_of_axes is None else (np.array(limits_of_axes),)
    return tuple(Limit(bound, norm, axes) for bound in bounds)
