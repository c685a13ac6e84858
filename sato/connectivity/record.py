"""Recorded frames and attributes of a connectivity run."""

from typing import Annotated, NamedTuple

from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.connectivity.mission import Connectivity
from sato.interfaces import (
    FrameAlive,
    FrameComponent,
    FrameEvents,
    FramePosition,
    FrameTime,
    FrameVelocity,
    Recorded,
)

_PAIR = ("agent", "other")


class ConnectivityFrame(NamedTuple):
    """One control step; components are those of agents that see each other."""

    time: FrameTime
    position: FramePosition
    velocity: FrameVelocity
    alive: FrameAlive
    component: FrameComponent
    velocity_command: Annotated[
        Float[Array, "agents 3"],
        Recorded(("agent", "axis"), "m/s", "commanded velocity, body frame, without the stick"),
    ]
    yaw_rate: Annotated[
        Float[Array, " agents"], Recorded(("agent",), "rad/s", "commanded yaw rate")
    ]
    yaw: Annotated[Float[Array, " agents"], Recorded(("agent",), "rad", "yaw, not wrapped")]
    lambda2: Annotated[float, Recorded((), "1", "algebraic connectivity of the live agents")]
    lambda3: Annotated[
        float, Recorded((), "1", "eigenvalue after lambda2, infinite for two agents")
    ]
    lambda2_estimate: Annotated[
        Float[Array, " agents"], Recorded(("agent",), "1", "estimate of lambda2, NaN unknown")
    ]
    edge_weight: Annotated[
        Float[Array, "agents agents"], Recorded(_PAIR, "1", "true weight of the edge")
    ]
    yaw_estimate_error: Annotated[
        Float[Array, "agents agents"],
        Recorded(_PAIR, "rad", "error of the estimated relative yaw"),
    ]
    visibility: Annotated[
        Bool[Array, "agents agents"], Recorded(_PAIR, "1", "true where the agent sees the other")
    ]
    stick: Annotated[
        Float[Array, " 3"],
        Recorded(("axis",), "m/s", "velocity that the operator commands to agent 0, world frame"),
    ]
    known_agents: Bool[Array, "agents agents"]  # true where agent i still counts on agent j
    events: FrameEvents


def run_attributes(mission: Connectivity) -> dict[str, float]:
    """Collect limits for the attributes of the run file."""
    return {
        "lambda2_min": mission.potential.lambda2_min,
        "lambda2_max": mission.potential.lambda2_max,
        "range_m": mission.camera.d_max,
        "nearest_m": mission.repulsion.min_distance,
        "max_speed_m_s": mission.limits.speed,
        "max_turn_rad_s": mission.limits.yaw_rate,
    }
