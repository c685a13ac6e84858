"""The tables of a formation scenario, each key with what it may be.

What is not said is as in the paper's vehicles and, with `legacy_avoidance`, as in its code.
"""

from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, model_validator

from sato.formation import (
    AssignmentSettings,
    CollisionAvoidance,
    ControlLaw,
    Formation,
    FormationLimits,
    SupervisorSettings,
)
from sato.formation.mission import legacy_formation
from sato.former.formation_start import AnyVehicleStart
from sato.former.refusal import Refusal, upward
from sato.former.units import Table, meaning
from sato.network.radio import Radio

_LAW, _LIMITS, _RULES = ControlLaw(), FormationLimits(), CollisionAvoidance()
_ASSIGNING, _PROTOCOL, _RADIO = AssignmentSettings(), SupervisorSettings(), Radio()
PRINTED = legacy_formation(np.empty((0, 3)), (), "cbaa")  # the paper's code, with nobody in the air


class Vehicles(Table):
    """Who flies, from where, how fast, and how near is too near."""

    agents: Annotated[int, Field(ge=3)]
    start: AnyVehicleStart
    keep_out_m: PositiveFloat = _RULES.keep_out
    max_speed_m_s: PositiveFloat = _LIMITS.speed
    max_climb_m_s: PositiveFloat = _LIMITS.climb
    max_acceleration_m_s2: PositiveFloat = _LIMITS.acceleration
    max_climb_acceleration_m_s2: PositiveFloat = _LIMITS.climb_acceleration


class Control(Table):
    """What vehicles want; the printed law has a size control of its own, beside `size`."""

    step_s: PositiveFloat = Formation.control_step
    gain: PositiveFloat = _LAW.gain
    size: PositiveFloat = _LAW.size_rate
    upright: bool = _LAW.upright  # false: a mirror image, upside down, will do


class Clearance(Table):
    """How they keep apart; the printed way heeds `notice_m` alone."""

    notice_m: PositiveFloat = _RULES.avoidance_range
    margin_m: NonNegativeFloat = _RULES.margin
    brake_m_s2: PositiveFloat = _RULES.braking
    aside_rad: NonNegativeFloat = _RULES.right_turn_bias
    legacy_avoidance: bool = False


class Assignment(Table):
    """Who takes which point, and when that is asked again."""

    kind: Literal["vsdaa", "cbaa", "hungarian", "none"] = _ASSIGNING.method
    first_s: NonNegativeFloat = _ASSIGNING.first_delay
    period_s: PositiveFloat = _ASSIGNING.period
    fineness: PositiveFloat = _ASSIGNING.relative_epsilon


class Reckoning(Table):
    """The frames that vehicles reckon in, and how far that is wrong."""

    yaw: Literal["random", "aligned"] = "random"
    offset_m: NonNegativeFloat = 10.0  # origins are drawn so far from zero on each axis
    drift: NonNegativeFloat = 0.01  # of the distance flown
    noise_m: NonNegativeFloat = 0.02  # standard deviation of every coordinate measured


class Messages(Table):
    """How vehicles hear each other."""

    rate_hz: PositiveFloat = _RADIO.message_rate
    delay_s: NonNegativeFloat = _RADIO.delay
    loss: Annotated[float, Field(ge=0, lt=1)] = _RADIO.loss_probability


class Judging(Table):
    """When a formation counts as taken up, and when a swarm is given up."""

    settled_m_s: PositiveFloat = _PROTOCOL.convergence_speed
    hover_s: NonNegativeFloat = _PROTOCOL.hover_time
    patience_s: PositiveFloat = _PROTOCOL.gridlock_timeout
    limit_s: PositiveFloat = _PROTOCOL.time_limit
    shape_m: PositiveFloat = _PROTOCOL.shape_tolerance


class Stick(Table):
    """What an operator asks of one vehicle for a while, in its own frame."""

    vehicle: NonNegativeInt
    start_s: NonNegativeFloat
    end_s: PositiveFloat
    velocity_m_s: list[float]

    @model_validator(mode="after")
    def _in_space(self) -> "Stick":
        if len(self.velocity_m_s) != 3:
            raise Refusal("velocity_m_s", f"needs 3 coordinates, got {len(self.velocity_m_s)}")
        return self


def as_in_the_printed_code(data: dict[str, Any]) -> dict[str, Any]:
    """The tables of a file, where what is not said is as in the paper's code."""
    defaults: dict[str, tuple[type[Table], dict[str, Any]]] = {
        "control": (
            Control,
            {"step_s": PRINTED.control_step, "upright": PRINTED.control_law.upright},
        ),
        "avoidance": (Clearance, {"notice_m": PRINTED.avoidance.avoidance_range}),
        "assignment": (Assignment, {"kind": PRINTED.assignment.method}),
        "frames": (
            Reckoning,
            {
                "yaw": "aligned",
                "offset_m": 0.0,
                "drift": 0.0,
                "noise_m": PRINTED.coordinate_frames.noise,
            },
        ),
        "protocol": (Judging, {"settled_m_s": PRINTED.supervision.convergence_speed}),
    }
    filled = dict(data)
    for name, (kind, values) in defaults.items():
        given = data.get(name, {})
        if isinstance(given, dict):
            filled[name] = _unsaid(given, kind, values) | given
    return filled


def check_clearance(swarm: Vehicles, control: Control, avoidance: Clearance) -> None:
    """Vehicles heed others while they can still stop for them.

    Raises:
        Refusal: They do not.
    """
    if avoidance.legacy_avoidance:
        if control.upright:
            raise Refusal(
                "control.upright",
                "the printed law cannot tell a shape from its mirror image; upright = false, or "
                "legacy_avoidance = false, would do",
            )
        return
    if avoidance.brake_m_s2 > swarm.max_acceleration_m_s2:
        raise Refusal(
            "avoidance.brake_m_s2",
            f"{avoidance.brake_m_s2:g} is more than max_acceleration_m_s2 = "
            f"{swarm.max_acceleration_m_s2:g}, so no vehicle could brake as it counts on; half "
            "of that would do",
        )
    braking = swarm.max_speed_m_s**2 / avoidance.brake_m_s2
    least = swarm.keep_out_m + avoidance.margin_m + braking
    if avoidance.notice_m < least * (1 - 1e-12):
        raise Refusal(
            "avoidance.notice_m",
            f"{avoidance.notice_m:g} is too near to stop before keep_out_m = "
            f"{swarm.keep_out_m:g} from {swarm.max_speed_m_s:g} m/s; {upward(least)} would do",
        )


def check_rate(control: Control, radio: Messages) -> None:
    """Messages fall on control steps.

    Raises:
        Refusal: They do not.
    """
    steps = 1 / (radio.rate_hz * control.step_s)
    whole = max(1, round(steps))
    if abs(steps - whole) > 1e-6 * whole:
        raise Refusal(
            "radio.rate_hz",
            f"{radio.rate_hz:g} messages a second do not fall on control steps of "
            f"{control.step_s:g} s; {1 / (whole * control.step_s):.6g} would do",
        )


def check_sticks(sticks: list[Stick]) -> None:
    """An operator has one stick.

    Raises:
        Refusal: Two vehicles are steered at a time.
    """
    order = sorted(range(len(sticks)), key=lambda k: sticks[k].start_s)
    for before, after in pairwise(order):
        if sticks[after].start_s < sticks[before].end_s:
            raise Refusal(
                f"push.{after}.start_s",
                f"{sticks[after].start_s:g} is before push {before} ends, and there is one "
                f"stick; {sticks[before].end_s:g} would do",
            )


def _unsaid(given: dict[str, Any], kind: type[Table], values: dict[str, Any]) -> dict[str, Any]:
    said: set[str] = set()
    for key in given:
        try:
            said.add(meaning(key, kind.model_fields)[0])
        except Refusal:
            continue  # the table will say so itself
    return {field: value for field, value in values.items() if field not in said}
