"""Variables and attributes of a formation flight's run file, beside those of its frames."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray as Array

from sato.formation.loop import FormationFrame
from sato.formation.mission import Formation
from sato.interfaces import Recorded

GAIN_PARTS = ("xy_real", "xy_imaginary", "z")

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
        formation=np.array([gains.formation.points for gains in mission.gains]),
        graph=np.array([gains.formation.graph for gains in mission.gains]),
        part=np.array(GAIN_PARTS),
        gains=np.array([[gains.xy.real, gains.xy.imag, gains.z] for gains in mission.gains]),
    )
