"""Recorded frames and attributes of a connectivity run."""

from typing import Annotated, NamedTuple

from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato import interfaces
from sato.connectivity.mission import Connectivity


class ConnectivityFrame(NamedTuple):
    """One control step; components are those of agents that see each other."""

    time: interfaces.Time
    position: interfaces.Position
    velocity: interfaces.Velocity
    alive: interfaces.Alive
    component: interfaces.Component
    velocity_command: Annotated[
        interfaces.Vectors, "m/s", "commanded velocity, body frame, without stick"
    ]
    yaw_rate: Annotated[interfaces.Reals, "rad/s", "commanded yaw rate"]
    yaw: Annotated[interfaces.Reals, "rad", "yaw, not wrapped"]
    lambda2: Annotated[float, "1", "algebraic connectivity of the live agents"]
    lambda3: Annotated[float, "1", "eigenvalue after lambda2, infinite for two agents"]
    lambda2_estimate: Annotated[interfaces.Reals, "1", "estimate of lambda2, NaN unknown"]
    edge_weight: Annotated[interfaces.Pairs, "1", "true weight of the edge"]
    yaw_estimate_error: Annotated[interfaces.Pairs, "rad", "error of the estimated relative yaw"]
    visibility: Annotated[Bool[Array, "agent other"], "1", "true where the agent sees the other"]
    stick: Annotated[Float[Array, " axis"], "m/s", "velocity commanded to agent 0, world frame"]
    known_agents: Bool[Array, "agent other"]  # true where agent i still counts on agent j
    events: interfaces.Events


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
