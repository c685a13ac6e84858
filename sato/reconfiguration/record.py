"""What a run of this system leaves behind, beyond what every run does."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.inertial import InertialPlant
from dynamics.plant import LinearPlant, Plant
from sato.interfaces import Variable
from sato.reconfiguration.frame import ReconfigurationFrame
from sato.reconfiguration.mission import Reconfiguration

# Of the chief's orbit, as `dynamics.orbit.Orbit` has them.
CHIEF_ELEMENTS = ("r", "v_x", "h", "node", "inclination", "latitude")

_PER_AXIS, _PER_AGENT = ("time", "agent", "axis"), ("time", "agent")
VARIABLES = {
    "control": Variable(_PER_AXIS, "m/s2", "commanded control, held to the next instant"),
    "applied_control": Variable(_PER_AXIS, "m/s2", "control with thrust errors"),
    "measured_position": Variable(_PER_AXIS, "m", "position as the agent believes it", True),
    "measured_velocity": Variable(_PER_AXIS, "m/s", "velocity as the agent believes it", True),
    "leg": Variable(("time",), "1", "leg under way"),
    "target": Variable(_PER_AGENT, "1", "index of the target that the agent holds, -1 none"),
    "believed": Variable(_PER_AGENT, "1", "number of targets that the agent bids on", True),
    "target_position": Variable(("leg", "target", "axis"), "m", "position of each target"),
    "target_velocity": Variable(("leg", "target", "axis"), "m/s", "velocity of each target"),
    "targets_believed": Variable(("leg", "agent"), "1", "believed at the end of the leg, -1 none"),
    "element": Variable(("element",), "1", "name of the chief's element", True),
    "chief": Variable(
        ("time", "element"),
        "m, m/s, m2/s, rad, rad, rad",
        "osculating orbit of the chief: radius, radial speed, angular momentum, right ascension "
        "of the ascending node, inclination, argument of latitude",
        True,
    ),
}


def collect_attributes(mission: Reconfiguration) -> dict[str, float]:
    """The radii, limits and constants that a run file says in its attributes."""
    return {
        "comm_radius_m": mission.comm_radius,
        "collision_radius_m": mission.collision_radius,
        "max_control_m_s2": mission.max_control,
        "max_speed_m_s": mission.max_speed,
        **_gravity_constants(mission.flown_plant),
    }


def stack_variables(
    frames: Sequence[ReconfigurationFrame], mission: Reconfiguration
) -> dict[str, Array]:
    """The values of the variables that have a `MEANING`."""
    return _stack_frames(frames) | _stack_legs(frames, mission) | _stack_chief(frames, mission)


def _gravity_constants(plant: Plant) -> dict[str, float]:
    orbit = plant.chief_orbit if isinstance(plant, InertialPlant | LinearPlant) else None
    return {} if orbit is None else {"mu_m3_s2": orbit.mu, "k_j2_m5_s2": orbit.k_J2}


def _stack_frames(frames: Sequence[ReconfigurationFrame]) -> dict[str, Array]:
    names = ("control", "applied_control", "leg")
    stacked = {name: np.array([getattr(f, name) for f in frames]) for name in names}
    stacked["target"] = np.array([f.target_index for f in frames])
    stacked["believed"] = np.array([f.target_count for f in frames])
    # An interrupted flight commands nothing from its last instant on.
    for name in ("control", "applied_control"):
        stacked[name][-1] = np.nan
    if any(f.measured_state is not None for f in frames):
        d = frames[0].position.shape[1]
        seen = np.array([_measured_state(f) for f in frames])
        stacked["measured_position"], stacked["measured_velocity"] = seen[..., :d], seen[..., d:]
    return stacked


def _measured_state(frame: ReconfigurationFrame) -> Float[Array, "agents n"]:
    if frame.measured_state is not None:
        return frame.measured_state
    return np.full((len(frame.position), 2 * frame.position.shape[1]), np.nan)


def _stack_legs(
    frames: Sequence[ReconfigurationFrame], mission: Reconfiguration
) -> dict[str, Array]:
    d, legs = mission.linear_model.axes, mission.legs
    most = max(len(leg.targets) for leg in legs)
    targets = np.full((len(legs), most, 2 * d), np.nan)
    for states, leg in zip(targets, legs, strict=True):
        states[: len(leg.targets)] = leg.targets
    believed = np.full((len(legs), len(mission.initial_states)), -1)
    for event in (e for f in frames for e in f.events if e["kind"] == "leg_end"):
        live = np.asarray(event["agents"], dtype=int)
        believed[event["leg"], live] = np.asarray(event["believed"])[live]
    return {
        "target_position": targets[..., :d],
        "target_velocity": targets[..., d:],
        "targets_believed": believed,
    }


def _stack_chief(
    frames: Sequence[ReconfigurationFrame], mission: Reconfiguration
) -> dict[str, Array]:
    flown = [mission.flown_plant.chief_elements(frame.time) for frame in frames]
    known = [chief for chief in flown if chief is not None]
    return {"element": np.array(CHIEF_ELEMENTS), "chief": np.array(known)} if known else {}
