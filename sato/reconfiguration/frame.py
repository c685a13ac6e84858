"""Frame of a reconfiguration: the swarm at a control instant."""

from typing import Annotated, NamedTuple

from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.interfaces import (
    FrameAlive,
    FrameComponent,
    FrameEvents,
    FramePosition,
    FrameTime,
    FrameVelocity,
    Recorded,
)

_PER_AXIS = ("agent", "axis")


class ReconfigurationFrame(NamedTuple):
    """One control instant; controls are NaN where there is none."""

    time: FrameTime
    position: FramePosition
    velocity: FrameVelocity
    alive: FrameAlive
    component: FrameComponent
    control: Annotated[
        Float[Array, "agents d"],
        Recorded(_PER_AXIS, "m/s2", "commanded control, held to the next instant", until_next=True),
    ]
    applied_control: Annotated[
        Float[Array, "agents d"],
        Recorded(_PER_AXIS, "m/s2", "control with thrust errors", until_next=True),
    ]
    leg_index: Annotated[int, Recorded((), "1", "leg under way; at the end, the last one")]
    target_index: Annotated[
        Int[Array, " agents"],
        Recorded(("agent",), "1", "index of the target that the agent holds, -1 none"),
    ]
    target_count: Annotated[
        Int[Array, " agents"],
        Recorded(("agent",), "1", "number of targets that the agent bids on"),
    ]
    measured_position: Annotated[
        Float[Array, "agents d"] | None,
        Recorded(_PER_AXIS, "m", "position as the agent measures it", optional=True),
    ]
    measured_velocity: Annotated[
        Float[Array, "agents d"] | None,
        Recorded(_PER_AXIS, "m/s", "velocity as the agent measures it", optional=True),
    ]
    events: FrameEvents
