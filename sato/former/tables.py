"""The tables of a reconfiguration scenario, each key with what it may be."""

from math import degrees, inf, pi
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

from sato.former.refusal import Refusal, downward, shown
from sato.former.shape import AnyShape
from sato.former.start import AnyStart
from sato.former.units import Table

MOST_POINTING = pi / 6  # standard deviation beyond which directions mean nothing [rad]


def _as_list(value: Any) -> Any:
    return [value] if isinstance(value, dict) else value


def _auto_or_number(value: Any) -> Any:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if value is None or value == "auto" or (number and 0 <= value < inf):
        return value
    raise Refusal("", f'must be a number that is not negative, or "auto", got {shown(value)}')


Automatic = Annotated[float | Literal["auto"], BeforeValidator(_auto_or_number)]


class Swarm(Table):
    """Who flies, from where, and how near is near."""

    agents: PositiveInt
    start: AnyStart
    comm_radius_m: PositiveFloat
    collision_radius_m: PositiveFloat
    believed: PositiveInt | None = None  # m of every agent at the start; without it, all agents


class Plan(Table):
    """When is decided what, and how finely."""

    step_s: PositiveFloat
    horizon_steps: PositiveInt  # avoidance looks this far,
    foresight_steps: NonNegativeInt = 0  # and, if it is further, this far among those in earshot
    orders: PositiveInt = 1  # of priority that each plan tries
    bargains: NonNegativeInt = 0  # sweeps in which pairs then plan together; with orders above 1
    replan_steps: PositiveInt  # without it, every horizon; every step under a disturbance
    auction_steps: PositiveInt  # without it, every replan
    epsilon: Automatic = "auto"
    tie_break: NonNegativeFloat = 0.2
    cost: Literal["fuel", "distance"] = "fuel"
    ids: bool = True
    reset: Literal["change", "need"] = "change"
    commit_steps: NonNegativeInt = 0
    margin_m: Automatic | None = None  # without it, "auto" about a chief, else none
    allow_undetectable: bool = False
    position_tolerance_m: PositiveFloat | None = None  # without it, see `sato.former.tolerance`
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
        if self.epsilon == 0:
            raise Refusal("epsilon", 'must be positive, or "auto", got 0')
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
    thrust: NonNegativeFloat = 0.0  # of its size, as a part of it
    pointing_rad: NonNegativeFloat = 0.0  # of its direction

    @model_validator(mode="after")
    def _thrusters_thrust(self) -> "Disturbance":
        if self.thrust >= 1:
            raise Refusal(
                "thrust",
                f"{self.thrust:g} is a standard deviation of {100 * self.thrust:g} % of the "
                f"thrust, of which it is a part; {self.thrust / 100:g} would be "
                f"{self.thrust:g} %",
            )
        if self.pointing_rad > MOST_POINTING:
            raise Refusal(
                "pointing_rad",
                f"{self.pointing_rad:.4g} is {degrees(self.pointing_rad):.4g} degrees, with which "
                f"a thruster points anywhere; at most pointing_deg = "
                f"{degrees(MOST_POINTING):.0f} would do",
            )
        return self


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


def check_plan(plan: Plan, legs: list[LegTable]) -> None:
    """Agents keep to their plans within a leg at most; over all of it is flying open-loop.

    Raises:
        Refusal: For longer than that.
    """
    for number, leg in enumerate(legs):
        if plan.commit_steps > leg.steps:
            raise Refusal(
                "plan.commit_steps",
                f"{plan.commit_steps} is more than the {leg.steps} steps of leg {number}; at most "
                f"{leg.steps} would do, with which the first plan is flown to the end",
            )


def check_noise(swarm: Swarm, disturbance: Disturbance) -> None:
    """Agents know their places better than they have to keep apart.

    Raises:
        Refusal: They do not.
    """
    if disturbance.position_m >= swarm.collision_radius_m:
        raise Refusal(
            "disturbance.position_m",
            f"{disturbance.position_m:g} is not less than swarm.collision_radius_m = "
            f"{swarm.collision_radius_m:g}, so agents could not know whether they collide; "
            f"{downward(swarm.collision_radius_m / 50)} would do",
        )
