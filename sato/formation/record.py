"""Variables and attributes of a formation flight's run file, beside those of its frames."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray as Array

from sato.formation.loop import FormationFrame
from sato.formation.mission import Formation
from sato.interfaces import Reals, Vectors

GAIN_PARTS = ("xy_real", "xy_imaginary", "z")


class FormationVariables(NamedTuple):
    """Variables of a run that are not those of its frames.

    Gains are a + jb on the relative position in the plane, and z on the relative height.
    """

    frame_yaw: Annotated[Reals, "rad", "heading of the own frame"]
    frame_offset: Annotated[Vectors, "m", "origin of the own frame"]
    formation: Annotated[Float[Array, "leg point axis"], "m", "points of the formation"]
    graph: Annotated[Bool[Array, "leg point neighbor"], "1", "true where two measure each other"]
    part: Annotated[Shaped[Array, " part"], "1", "part of the gains"]
    gains: Annotated[Float[Array, "leg part point neighbor"], "1/s", "gains: a, b and z"]


def collect_attributes(mission: Formation) -> dict[str, float]:
    """Collect radii and limits for the attributes of the run file."""
    return {
        "keep_out_m": mission.keep_out,
        "max_speed_m_s": mission.max_speed,
        "max_climb_m_s": mission.max_climb,
        "max_acceleration_m_s2": mission.max_acceleration,
        "max_climb_acceleration_m_s2": mission.max_climb_acceleration,
        "shape_m": mission.supervision.shape_tolerance,
    }


def collect_variables(frames: Sequence[FormationFrame], mission: Formation) -> FormationVariables:
    """Collect coordinate frames, formations, graphs and gains."""
    return FormationVariables(
        frame_yaw=np.angle(mission.coordinate_frames.rotation),
        frame_offset=mission.coordinate_frames.origin,
        formation=np.array([leg.formation.points for leg in mission.gains]),
        graph=np.array([leg.formation.graph for leg in mission.gains]),
        part=np.array(GAIN_PARTS),
        gains=np.array([[leg.xy.real, leg.xy.imag, leg.z] for leg in mission.gains]),
    )
