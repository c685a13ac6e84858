"""The tables of a reconfiguration scenario, each key with what it may be."""

from math import floor, inf, sqrt
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    model_validator,
)

from dynamics import ClohessyWiltshire, DoubleIntegrator
from sato.scenario.refusal import Refusal, downward, listed, upward
from sato.scenario.shape import AnyShape
from sato.scenario.start import AnyStart
from sato.scenario.units import Table

EARTH_MU = 3.986004418e14  # gravitational parameter [m³/s²] [IERS2010, table 1.1]


def _not_a_flag(value: Any) -> Any:
    # To Python, true is 1.
    if isinstance(value, bool):
        raise Refusal("", 'must be 1, 2 or "inf"')
    return value


def _as_list(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


Norm = Annotated[Literal[1, 2, "inf"], BeforeValidator(_not_a_flag)]


class Swarm(Table):
    """Who flies, from where, and how near is near."""

    agents: PositiveInt
    start: AnyStart
    comm_radius_m: PositiveFloat
    collision_radius_m: PositiveFloat
    believed: PositiveInt | None = None  # m of every agent at the start; without it, all agents


class _Model(Table):
    max_control_m_s2: PositiveFloat
    max_speed_m_s: PositiveFloat | None = None
    control_norm: Norm = "inf"
    fuel_norm: Norm = 1


class PointMasses(_Model):
    """r̈ = u."""

    kind: Literal["double_integrator"]
    dimension: Literal[2, 3] = 2

    def model(self) -> DoubleIntegrator:
        """The model that moves the agents."""
        return DoubleIntegrator(self.dimension)


class CircularOrbit(_Model):
    """Relative motion about a circular orbit of the Earth."""

    kind: Literal["clohessy_wiltshire"]
    semi_major_axis_m: PositiveFloat | None = None
    mean_motion_rad_s: PositiveFloat | None = None

    @model_validator(mode="after")
    def _one_orbit(self) -> "CircularOrbit":
        if (self.semi_major_axis_m is None) == (self.mean_motion_rad_s is None):
            raise Refusal("", "give semi_major_axis_km or mean_motion_rad_s, one of them")
        return self

    def model(self) -> ClohessyWiltshire:
        """The model that moves the agents."""
        if self.mean_motion_rad_s is not None:
            return ClohessyWiltshire(self.mean_motion_rad_s)
        assert self.semi_major_axis_m is not None
        return ClohessyWiltshire(sqrt(EARTH_MU / self.semi_major_axis_m**3))


AnyModel = Annotated[PointMasses | CircularOrbit, Field(discriminator="kind")]


class Plan(Table):
    """When is decided what, and how finely."""

    step_s: PositiveFloat
    horizon_steps: PositiveInt
    replan_steps: PositiveInt  # without it, every horizon; every step under a disturbance
    auction_steps: PositiveInt  # without it, every replan
    epsilon: PositiveFloat | Literal["auto"] = "auto"
    tie_break: NonNegativeFloat = 0.2
    cost: Literal["fuel", "distance"] = "fuel"
    ids: bool = True
    allow_undetectable: bool = False
    position_tolerance_m: PositiveFloat | None = None  # without it, as `sato.scenario.build` says
    velocity_tolerance_m_s: PositiveFloat | None = None

    @model_validator(mode="before")
    @classmethod
    def _periods(cls, data: Any) -> Any:
        if not isinstance(data, dict) or "horizon_steps" not in data:
            return data
        replan = data.get("replan_steps", data["horizon_steps"])
        return {"replan_steps": replan, "auction_steps": replan} | data

    @model_validator(mode="after")
    def _periods_nest(self) -> "Plan":
        if self.replan_steps > self.horizon_steps:
            raise Refusal(
                "replan_steps",
                f"{self.replan_steps} is more than horizon_steps = {self.horizon_steps}, so "
                f"collisions would be left unseen; at most {self.horizon_steps} would do",
            )
        if self.auction_steps > self.horizon_steps:
            most = self.horizon_steps // self.replan_steps * self.replan_steps
            raise Refusal(
                "auction_steps",
                f"{self.auction_steps} is more than horizon_steps = {self.horizon_steps}, so two "
                f"agents could reach one target before they bid for it; {most} would do",
            )
        if self.auction_steps % self.replan_steps:
            below = self.auction_steps // self.replan_steps * self.replan_steps
            raise Refusal(
                "auction_steps",
                f"{self.auction_steps} is no multiple of replan_steps = {self.replan_steps}; "
                f"{below or self.replan_steps} would do",
            )
        return self


class Disturbance(Table):
    """Standard deviations of what goes wrong, drawn anew at every step."""

    acceleration_m_s2: NonNegativeFloat = 0.0
    position_m: NonNegativeFloat = 0.0
    velocity_m_s: NonNegativeFloat = 0.0


class LoseShare(Table):
    """A share of the live agents vanishes: those nearest the middle, or any."""

    kind: Literal["middle", "random"]
    share: Annotated[float, Field(gt=0, lt=1)]
    at_step: NonNegativeInt = 0


class LoseAgents(Table):
    """Named agents vanish."""

    kind: Literal["agents"]
    agents: Annotated[list[NonNegativeInt], Field(min_length=1)]
    at_step: NonNegativeInt = 0


class Join(Table):
    """Agents come in."""

    agents: PositiveInt
    start: AnyStart
    at_step: NonNegativeInt = 0


AnyLoss = Annotated[LoseShare | LoseAgents, Field(discriminator="kind")]


class LegTable(Table):
    """A shape to take up, and the time to do it in."""

    shape: AnyShape
    steps: PositiveInt
    targets: PositiveInt | None = None  # M; without it, as many as the swarm may believe in
    recount: bool = False
    lose: Annotated[list[AnyLoss], BeforeValidator(_as_list)] = Field(default=[])
    join: Annotated[list[Join], BeforeValidator(_as_list)] = Field(default=[])

    @model_validator(mode="after")
    def _within_the_leg(self) -> "LegTable":
        for name, events in (("lose", self.lose), ("join", self.join)):
            for event in events:
                if event.at_step >= self.steps:
                    raise Refusal(
                        f"{name}.at_step",
                        f"{event.at_step} is after the leg's {self.steps} steps; "
                        f"at most {self.steps - 1} would do",
                    )
        return self


def detectable(swarm: Swarm, model: AnyModel, plan: Plan) -> bool:
    """Whether two agents that could meet within the horizon hear each other at its start.

        R_comm ≥ 2 V_max T_H Δt + R_col

    [Morgan2016, Proposition 9].
    """
    return swarm.comm_radius_m >= _least_radius(swarm, model, plan) * (1 - 1e-12)


def check_detectable(swarm: Swarm, model: AnyModel, plan: Plan) -> None:
    """Refuse agents that could meet unseen, unless that is what is to be shown.

    Raises:
        Refusal: They could; says which radius, speed or horizon would do.
    """
    if plan.allow_undetectable or detectable(swarm, model, plan):
        return
    needed, speed = _least_radius(swarm, model, plan), model.max_speed_m_s
    room = swarm.comm_radius_m - swarm.collision_radius_m
    cures = []
    if speed is not None:
        cures.append(f"swarm.comm_radius_m = {upward(needed)}")
    if room > 0:
        slower = room / (2 * plan.horizon_steps * plan.step_s)
        cures.append(f"model.max_speed_m_s = {downward(slower)}")
    if speed is not None and (shorter := floor(room / (2 * speed * plan.step_s) + 1e-9)) > 0:
        cures.append(f"plan.horizon_steps = {shorter}")
    if not cures:
        cures.append("a larger comm_radius_m with a model.max_speed_m_s")
    limit = f"{needed:.4g} m" if speed else "infinite, for there is no model.max_speed_m_s"
    raise Refusal(
        "swarm.comm_radius_m",
        f"{swarm.comm_radius_m:g} is less than 2 V_max T_H Δt + R_col, which is {limit}, so two "
        f"agents could meet within the horizon unseen (Proposition 9); {listed(cures)} would do, "
        "and plan.allow_undetectable = true flies it all the same",
    )


def _least_radius(swarm: Swarm, model: AnyModel, plan: Plan) -> float:
    speed = model.max_speed_m_s or inf
    return 2 * speed * plan.horizon_steps * plan.step_s + swarm.collision_radius_m
