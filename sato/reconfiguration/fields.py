"""Fields of a reconfiguration, from which its properties follow."""

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import Le, Lt
from pydantic import BeforeValidator
from pydantic import Field as Constraint

from dynamics.orbit import MAX_TIME
from dynamics.plant import Plant
from dynamics.units import Acceleration, Angle, Key, Length, Speed, Time, Unit
from sato.network.link import Link
from sato.obstacles import AnyObstacle
from sato.reconfiguration import models
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.models import PlantSettings
from sato.reconfiguration.orbit import Chief
from sato.reconfiguration.start import Start
from sato.scenario.definition import (
    EACH,
    LATER,
    Amount,
    Convert,
    Coordinates,
    Count,
    In,
    Inline,
    Matrix,
    NotNegative,
    Positive,
)
from sato.scenario.errors import InputError, format_value
from sato.scenario.file import Mission
from sato.shapes.shape import as_points

if TYPE_CHECKING:
    Automatic = float  # once the mission is drawn
    PerVehicle = float | tuple[float, ...]  # the same for all, or an entry for each
else:
    Automatic = Annotated[float, NotNegative] | Literal["auto"]
    PerVehicle = float

SWARM, MODEL, PLAN, NOISE = In("swarm"), In("model"), In("plan"), In("disturbance")
AUTO: Any = "auto"


def _norm(value: Any) -> Any:
    # To Python, true is 1.
    if isinstance(value, bool):
        raise InputError("", f'must be 1, 2 or "inf", got {format_value(value)}')
    is_inf = isinstance(value, float) and value == inf
    return "inf" if is_inf else value  # as `--set control_norm=inf` and numpy.inf have it


Norm = Annotated[Literal[1, 2, "inf"], BeforeValidator(_norm)]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ReconfigurationFields(models.Motion, Mission):
    """Fields that scenario files and Python give."""

    agents: Annotated[int | None, SWARM, Positive, "number of agents at the start"] = None
    start: Annotated[Start, SWARM, Convert(as_points), "initial positions or states"]
    comm_radius: Annotated[Length, SWARM, Positive, "communication radius R_comm"]
    collision_radius: Annotated[
        PerVehicle,
        Unit("m"),
        SWARM,
        Positive,
        "least distance of two, R_col; (R_i + R_j)/2 of a list",
        EACH,
    ]
    sensing_radius: Annotated[
        float | None,
        Unit("m"),
        SWARM,
        Positive,
        "obstacles not known, and lost vehicles, are seen within; comm_radius_m if absent",
    ] = None
    priority: Annotated[
        Coordinates | None, SWARM, "number of each; the lower gives way, else who spent less"
    ] = None
    target_count: Annotated[
        int | None,
        SWARM,
        Key("believed"),
        Positive,
        "targets m that agents bid on at first; one an agent if absent",
    ] = None

    chief: Annotated[Chief | None, In(""), Convert(models.as_chief), "orbit of the chief"] = None

    model: Annotated[
        models.AnyModel, MODEL, Inline(), Convert(models.as_point_mass), "equations of motion"
    ]
    max_control: Annotated[
        PerVehicle | None, Unit("m_s2"), MODEL, Positive, "largest acceleration", EACH
    ] = None
    max_control_axes: Annotated[
        Coordinates | None, Unit("m_s2"), MODEL, "largest acceleration along each axis, instead"
    ] = None
    max_speed: Annotated[
        PerVehicle,
        Unit("m_s"),
        MODEL,
        Positive,
        Constraint(allow_inf_nan=True),
        "largest speed",
        EACH,
    ] = inf
    max_speed_axes: Annotated[
        Coordinates | None, Unit("m_s"), MODEL, "largest speed along each axis, instead"
    ] = None
    control_norm: Annotated[Norm, MODEL, "norm of the acceleration's limit"] = "inf"
    speed_norm: Annotated[Norm, MODEL, "norm of the velocity's limit"] = 2
    fuel_norm: Annotated[Norm, MODEL, "norm of the acceleration in the fuel"] = 1

    separation_axes: Annotated[
        Coordinates | None,
        MODEL,
        "semi-axes of the ellipsoid that two keep, over R, one of them 1; a ball if absent",
    ] = None
    separation_semi_axes: Annotated[
        Coordinates | None, Unit("m"), Key("separation_axes"), MODEL, "semi-axes, instead"
    ] = None
    box: Annotated[
        Matrix | None, Unit("m"), MODEL, "allowed positions: lowest and highest corner"
    ] = None

    obstacles: Annotated[tuple[AnyObstacle, ...], In(""), Key("obstacle"), "obstacles"] = ()

    plant: Annotated[PlantSettings | Plant, In(""), "motion that is flown"] = PlantSettings()

    step: Annotated[Time, PLAN, Positive, Le(MAX_TIME), "control step Δt"]
    horizon_steps: Annotated[Amount, PLAN, "steps that avoidance looks ahead, T_H"] = 4
    foresight_steps: Annotated[
        Count | None,
        PLAN,
        "steps it looks ahead in hearing; if absent, 0, in orbit and for kept plans the leg",
    ] = None
    orders: Annotated[Amount, PLAN, "orders of priority that each plan tries"] = 1
    bargains: Annotated[Count, PLAN, "sweeps of negotiation in pairs; with orders above 1"] = 0
    replan_steps: Annotated[
        Amount, PLAN, "replanning period; if absent, up to half the horizon"
    ] = LATER
    compute: Annotated[
        Time, PLAN, NotNegative, "time that an agent computes in a decision, over a network"
    ] = 0.0
    auction_steps: Annotated[
        Amount,
        PLAN,
        "auction period, in replan_steps, where plans are not kept; if absent, the horizon",
    ] = LATER
    assignment: Annotated[
        Literal["auction", "given", "central"],
        PLAN,
        "targets by auction, agent i to target i, or the optimum with all data in one place",
    ] = "auction"
    epsilon: Annotated[Automatic, PLAN, "bid increment ε; auto: w s²/2, s the least spacing"] = AUTO
    tie_break: Annotated[
        float, PLAN, NotNegative, "weight w [1/m] of the tie-break; if absent, 0.2, printed 0"
    ] = LATER
    cost: Annotated[Literal["fuel", "distance"], PLAN, "cost of a target"] = "fuel"
    objective: Annotated[
        Literal["fuel", "energy"], PLAN, "fuel, or energy Δt Σ ‖u‖², that paths and targets cost"
    ] = "fuel"
    solver: Annotated[
        str, PLAN, "solver of transfers and avoidance; clarabel: by simplex where linear"
    ] = "clarabel"
    tolerance: Annotated[
        float | None, PLAN, Positive, Lt(1), "relative, of its answers; 1e-6 if absent"
    ] = None
    printed: Annotated[
        bool, PLAN, "the printed methods: samples alone, no commitment, the defaults as printed"
    ] = False
    bidder_ids: Annotated[
        bool, PLAN, Key("ids"), "bids carry the bidder; if absent, true, printed false"
    ] = LATER
    reset: Annotated[
        Literal["change", "need"],
        PLAN,
        "clock starts again with new bidders, or where needed; if absent, need, printed change",
    ] = LATER
    freeze_steps: Annotated[Count, PLAN, "steps before the deadline in which plans are kept"] = 0
    margin: Annotated[
        Automatic,
        Unit("m"),
        PLAN,
        "beyond R_col; auto if absent, which is 0 without noise or errors of the model",
    ] = LATER
    passive_safety: Annotated[
        float | None,
        Unit("m"),
        PLAN,
        Positive,
        "in orbit: distance that drifts keep after a loss of thrust at any step; if absent, none",
    ] = None
    passive_safety_time: Annotated[
        float | None,
        Unit("s"),
        Key("passive_safety"),
        PLAN,
        Positive,
        "time for which they keep it; two orbits if absent",
    ] = None
    allow_undetectable: Annotated[bool, PLAN, "fly where agents could meet unseen"] = False
    position_tolerance: Annotated[
        Length, PLAN, Positive, "distance within which a target counts as reached"
    ] = LATER
    velocity_tolerance: Annotated[
        Speed, PLAN, Positive, "speed within which a target counts as reached"
    ] = LATER

    link: Annotated[Link, In(""), "messages between agents within hearing"] = Link()

    disturbance: Annotated[
        Acceleration, NOISE, Key("acceleration"), NotNegative, "standard deviation, held for a step"
    ] = 0.0
    position_noise: Annotated[Length, NOISE, Key("position"), NotNegative, "of measurement"] = 0.0
    velocity_noise: Annotated[Speed, NOISE, Key("velocity"), NotNegative, "of measurement"] = 0.0
    thrust_error: Annotated[float, NOISE, Key("thrust"), NotNegative, "relative thrust error"] = 0.0
    pointing_error: Annotated[Angle, NOISE, Key("pointing"), NotNegative, "pointing error"] = 0.0

    legs: Annotated[tuple[Leg, ...], In(""), Key("leg"), "legs in turn"]
