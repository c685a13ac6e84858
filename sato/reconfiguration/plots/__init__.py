"""The figures of this system, in the manner of the paper's [Morgan2016, Figs. 2, 4, 5 and 6]."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from sato.reconfiguration.check import Evidence
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.plots.half_space import half_space
from sato.reconfiguration.plots.measures import delta_v, fuel, separation
from sato.reconfiguration.plots.orbital import instants, space
from sato.reconfiguration.plots.perspective import in_orbit
from sato.reconfiguration.plots.stages import first_leg, stages, trajectories
from sato.system import Figures

if TYPE_CHECKING:
    import xarray

__all__ = ["FIGURES", "IN_ORBIT", "figures"]

FIGURES: dict[str, Callable[[Evidence], Figure]] = {
    "stages": stages,
    "first-leg": first_leg,
    "trajectories": trajectories,
    "half-space": half_space,
    "separation": separation,
    "fuel": fuel,
}
IN_ORBIT: dict[str, Callable[[Evidence], Figure]] = {
    "instants": instants,
    "space": space,
    "delta-v": delta_v,
}


def figures(data: "xarray.Dataset", mission: Reconfiguration) -> Figures:
    """The figures of a run; those of `IN_ORBIT` only of a run about a chief."""
    evidence = Evidence.of(data, mission)
    drawn = FIGURES | IN_ORBIT if in_orbit(evidence) else FIGURES
    return {name: partial(draw, evidence) for name, draw in drawn.items()}
