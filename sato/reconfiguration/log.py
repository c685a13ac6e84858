"""What a run of this system leaves behind, beyond what every run does."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.inertial import Inertial
from dynamics.plant import Modelled, Plant
from sato.reconfiguration.frame import Frame
from sato.reconfiguration.mission import Reconfiguration
from sato.system import Variable

# Of the chief's orbit, as `dynamics.orbit.Orbit` has them.
ELEMENTS = ("r", "v_x", "h", "node", "inclination", "latitude")

_VECTOR, _EACH = ("time", "agent", "axis"), ("time", "agent")
MEANING = {
    "control": Variable(_VECTOR, "m/s2", "commanded control, held to the next instant"),
    "applied_control": Variable(_VECTOR, "m/s2", "control with thrust errors"),
    "measured_position": Variable(_VECTOR, "m", "position as the agent believes it", True),
    "measured_velocity": Variable(_VECTOR, "m/s", "velocity as the agent believes it", True),
    "leg": Variable(("time",), "1", "leg under way"),
    "target": Variable(_EACH, "1", "index of the target that the agent holds, -1 none"),
    "believed": Variable(_EACH, "1", "number of targets that the agent bids on", True),
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


def attributes(mission: Reconfiguration) -> dict[str, float]:
    """The radii, limits and constants that a run file says in its attributes."""
    return {
        "comm_radius_m": mission.comm_radius,
        "collision_radius_m": mission.collision_radius,
        "max_control_m_s2": mission.max_control,
        "max_speed_m_s": mission.max_speed,
        **_gravity(mission.truth),
    }


def variables(frames: Sequence[Frame], mission: Reconfiguration) -> dict[str, Array]:
    """The values of the variables that have a `MEANING`."""
    return _over_time(frames) | _over_legs(frames, mission) | _chief(frames, mission)


def _gravity(plant: Plant) -> dict[str, float]:
    orbit = plant.orbit if isinstance(plant, Inertial | Modelled) else None
    return {} if orbit is None else {"mu_m3_s2": orbit.mu, "k_j2_m5_s2": orbit.k_J2}


def _over_time(frames: Sequence[Frame]) -> dict[str, Array]:
    names = ("control", "applied_control", "leg", "target", "believed")
    stacked = {name: np.array([getattr(f, name) for f in frames]) for name in names}
    # An interrupted flight commands nothing from its last instant on.
    for name in ("control", "applied_control"):
        stacked[name][-1] = np.nan
    if any(f.measured is not None for f in frames):
        d = frames[0].position.shape[1]
        seen = np.array([_belief(f) for f in frames])
        stacked["measured_position"], stacked["measured_velocity"] = seen[..., :d], seen[..., d:]
    return stacked


def _belief(frame: Frame) -> Float[Array, "agents n"]:
    if frame.measured is not None:
        return frame.measured
    return np.full((len(frame.position), 2 * frame.position.shape[1]), np.nan)


def _over_legs(frames: Sequence[Frame], mission: Reconfiguration) -> dict[str, Array]:
    d, legs = mission.model.axes, mission.legs
    most = max(len(leg.targets) for leg in legs)
    targets = np.full((len(legs), most, 2 * d), np.nan)
    for states, leg in zip(targets, legs, strict=True):
        states[: len(leg.targets)] = leg.targets
    believed = np.full((len(legs), len(mission.start)), -1)
    for event in (e for f in frames for e in f.events if e["kind"] == "leg_end"):
        live = np.asarray(event["agents"], dtype=int)
        believed[event["leg"], live] = np.asarray(event["believed"])[live]
    return {
        "target_position": targets[..., :d],
        "target_velocity": targets[..., d:],
        "targets_believed": believed,
    }


def _chief(frames: Sequence[Frame], mission: Reconfiguration) -> dict[str, Array]:
    flown = [mission.truth.chief(frame.time) for frame in frames]
    known = [chief for chief in flown if chief is not None]
    return {"element": np.array(ELEMENTS), "chief": np.array(known)} if known else {}
