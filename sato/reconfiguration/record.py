"""Variables and attributes of a reconfiguration's run file, beside those of its frames."""

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray as Array

from dynamics.bodies import EARTH, find_body
from sato.network.load import PURPOSES
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import ReconfigurationFrame

# Of the chief's orbit, as `dynamics.orbit.Orbit` has them.
CHIEF_ELEMENTS = ("r", "v_x", "h", "node", "inclination", "latitude")

Targets = Float[Array, "leg target axis"]


class ReconfigurationVariables(NamedTuple):
    """Variables of a run that are not those of its frames.

    Targets are NaN where a leg has fewer. The osculating orbit of the chief is its radius, radial
    speed, angular momentum, right ascension of the ascending node, inclination and argument of
    latitude.
    """

    target_position: Annotated[Targets, "m", "position of each target, NaN where none"]
    target_velocity: Annotated[Targets, "m/s", "velocity of each target, NaN where none"]
    targets_believed: Annotated[
        Int[Array, "leg agent"], "1", "targets that the agent bids on at the end, -1 none"
    ]
    purpose: Annotated[Shaped[Array, " purpose"] | None, "1", "purpose of messages"]
    received_messages: Annotated[
        Int[Array, "agent purpose"] | None, "1", "messages that the agent received"
    ]
    received_bytes: Annotated[
        Int[Array, "agent purpose"] | None, "byte", "size of these messages with headers"
    ]
    element: Annotated[Shaped[Array, " element"] | None, "1", "orbital element of the chief"]
    chief: Annotated[
        Float[Array, "time element"] | None, "m, m/s, m2/s, rad, rad, rad", "orbit of the chief"
    ]


def collect_attributes(mission: Reconfiguration) -> dict[str, Any]:
    """Collect radii, limits and constants for the attributes of the run file."""
    orbit, chief = mission.flown_plant.chief_orbit, mission.chief
    body = EARTH if orbit is None else find_body(orbit.mu)
    found = {
        "comm_radius_m": mission.comm_radius,
        "collision_radius_m": mission.collision_radius,
        "max_control_m_s2": mission.max_control,
        "max_speed_m_s": mission.max_speed,
        "max_control_axes_m_s2": mission.max_control_axes,
        "max_speed_axes_m_s": mission.max_speed_axes,
        "epoch": chief and chief.epoch,
        "mu_m3_s2": orbit and orbit.mu,
        "k_j2_m5_s2": orbit and orbit.k_J2,
    }
    if body is not EARTH:
        found["center"] = body.name.removeprefix("the ").upper().replace(" ", "_")
    known = {name: value for name, value in found.items() if value is not None}
    # An array of one entry is read back as a number.
    return {k: v[0] if isinstance(v, tuple) and len(v) == 1 else v for k, v in known.items()}


def collect_variables(
    frames: Sequence[ReconfigurationFrame], mission: Reconfiguration
) -> ReconfigurationVariables:
    """Collect targets, final target counts and the chief's orbit."""
    position, velocity = stack_targets(mission)
    counts = np.full((len(mission.legs), len(mission.initial_states)), -1)
    for event in (e for f in frames for e in f.events if e["kind"] == "leg_end"):
        live = np.asarray(event["agents"], dtype=int)
        counts[event["leg"], live] = np.asarray(event["believed"])[live]
    elements = [mission.flown_plant.chief_elements(frame.time) for frame in frames]
    known = [chief for chief in elements if chief is not None]
    received = frames[-1].received
    messages, size = (None, None) if received is None else received
    return ReconfigurationVariables(
        target_position=position,
        target_velocity=velocity,
        targets_believed=counts,
        purpose=None if received is None else np.array(PURPOSES),
        received_messages=messages,
        received_bytes=size,
        element=np.array(CHIEF_ELEMENTS) if known else None,
        chief=np.array(known) if known else None,
    )


def stack_targets(mission: Reconfiguration) -> tuple[Targets, Targets]:
    """Stack positions and velocities of the targets of all legs; NaN where a leg has fewer."""
    most = max(len(leg.targets) for leg in mission.legs)
    targets = np.full((len(mission.legs), most, 2 * mission.axes), np.nan)
    for states, leg in zip(targets, mission.legs, strict=True):
        states[: len(leg.targets)] = leg.targets
    return targets[..., : mission.axes], targets[..., mission.axes :]
