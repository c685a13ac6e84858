"""What a run of this system leaves behind, beyond what every run does."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix
from sato.formation.loop import FormationFrame
from sato.formation.mission import Formation
from sato.interfaces import Variable

GAIN_PARTS = ("xy_real", "xy_imaginary", "z")  # of gains, in the order of the file

_VECTOR, _PER_AGENT, _EDGES = ("time", "agent", "axis"), ("time", "agent"), ("vertex", "neighbour")
VARIABLES = {
    "velocity_command": Variable(
        _VECTOR, "m/s", "velocity that the law commands, in the agent's own frame, before limits"
    ),
    "avoiding": Variable(_PER_AGENT, "1", "whether the agent departs from that to avoid others"),
    "point": Variable(_PER_AGENT, "1", "point of the formation that the agent holds"),
    "leg": Variable(("time",), "1", "leg under way"),
    "frame_drift": Variable(_VECTOR, "m", "error of the agent's reckoning, in its own frame"),
    "frame_yaw": Variable(("agent",), "rad", "heading of the agent's frame"),
    "frame_offset": Variable(("agent", "axis"), "m", "origin of the agent's frame"),
    "formation": Variable(("leg", "vertex", "axis"), "m", "points of the formation"),
    "graph": Variable(("leg", *_EDGES), "1", "whether two points measure each other"),
    "part": Variable(("part",), "1", "name of a part of the gains"),
    "gains": Variable(
        ("leg", "part", *_EDGES),
        "1/s",
        "a + jb turns and scales what is seen of a neighbour in the plane, z scales its height",
    ),
}


def run_attributes(mission: Formation) -> dict[str, float]:
    """The radii and limits that a run file says in its attributes."""
    limits = mission.limits
    return {
        "keep_out_m": mission.avoidance.keep_out,
        "max_speed_m_s": limits.speed,
        "max_climb_m_s": limits.climb,
        "max_acceleration_m_s2": limits.acceleration,
        "max_climb_acceleration_m_s2": limits.climb_acceleration,
        "shape_m": mission.supervision.shape_tolerance,
    }


def stack_variables(frames: Sequence[FormationFrame], mission: Formation) -> dict[str, Array]:
    """The values of the variables that have a `MEANING`."""
    names = ("velocity_command", "avoiding", "leg")
    shapes = [gains.formation for gains in mission.gains]
    return {name: np.array([getattr(f, name) for f in frames]) for name in names} | {
        "point": np.array([f.assignment for f in frames]),
        "frame_drift": np.array([f.drift for f in frames]),
        "frame_yaw": np.angle(mission.coordinate_frames.rotation),
        "frame_offset": mission.coordinate_frames.origin,
        "formation": np.array([shape.points for shape in shapes]),
        "graph": np.array([shape.graph for shape in shapes]),
        "part": np.array(GAIN_PARTS),
        "gains": np.array([_stack_gains(gains) for gains in mission.gains]),
    }


def _stack_gains(gains: GainMatrix) -> Float[Array, "3 n n"]:
    return np.stack([gains.xy.real, gains.xy.imag, gains.z])
