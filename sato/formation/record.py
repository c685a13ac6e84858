"""What a run of this system leaves behind, beyond what every run does."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix
from sato.formation.loop import FormationFrame
from sato.formation.mission import Formation
from sato.interfaces import Recorded

GAIN_PARTS = ("xy_real", "xy_imaginary", "z")  # of gains, in the order of the file

_POINTS = ("leg", "point", "axis")
_EDGES = ("leg", "point", "neighbor")


class FormationVariables(NamedTuple):
    """Variables of a run that are not those of its frames."""

    frame_yaw: Annotated[
        Float[Array, " agents"], Recorded(("agent",), "rad", "heading of the agent's frame")
    ]
    frame_offset: Annotated[
        Float[Array, "agents 3"], Recorded(("agent", "axis"), "m", "origin of the agent's frame")
    ]
    formation: Annotated[
        Float[Array, "legs points 3"], Recorded(_POINTS, "m", "points of the formation")
    ]
    graph: Annotated[
        Bool[Array, "legs points points"],
        Recorded(_EDGES, "1", "true where two points measure each other"),
    ]
    part: Annotated[
        Shaped[Array, " parts"], Recorded(("part",), "1", "name of a part of the gains")
    ]
    gains: Annotated[
        Float[Array, "legs parts points points"],
        Recorded(
            ("leg", "part", "point", "neighbor"),
            "1/s",
            "gain a + jb on the relative position in the plane; z on the relative height",
        ),
    ]


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


def collect_variables(frames: Sequence[FormationFrame], mission: Formation) -> FormationVariables:
    """Collect coordinate frames, formations, graphs and gains."""
    shapes = [gains.formation for gains in mission.gains]
    return FormationVariables(
        frame_yaw=np.angle(mission.coordinate_frames.rotation),
        frame_offset=mission.coordinate_frames.origin,
        formation=np.array([shape.points for shape in shapes]),
        graph=np.array([shape.graph for shape in shapes]),
        part=np.array(GAIN_PARTS),
        gains=np.array([_stack_gains(gains) for gains in mission.gains]),
    )


def _stack_gains(gains: GainMatrix) -> Float[Array, "3 n n"]:
    return np.stack([gains.xy.real, gains.xy.imag, gains.z])
