"""What there is to see of a swarm at an instant."""

from typing import Any, NamedTuple

from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array


class ReconfigurationFrame(NamedTuple):
    """One control instant."""

    time: float  # [s]
    position: Float[Array, "agents d"]  # [m]
    velocity: Float[Array, "agents d"]  # [m/s]
    alive: Bool[Array, " agents"]
    component: Int[Array, " agents"]  # −1 while not alive
    control: Float[Array, "agents d"]  # commanded, held from now on; NaN where there is none [m/s²]
    applied_control: Float[Array, "agents d"]  # what the plant integrates [m/s²]
    leg: int  # under way from this instant on; the last frame keeps the last leg
    target_index: Int[Array, " agents"]  # held; −1 none
    target_count: Int[Array, " agents"]  # how many targets each agent bids on
    measured_state: (
        Float[Array, "agents n"] | None
    )  # what the agents believe of their state, under noise
    events: tuple[dict[str, Any], ...]  # {"kind": …, "agents": […], …}; the record adds the time
