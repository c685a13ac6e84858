"""Colors and marks that all figures share, and their legends."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int
from matplotlib.lines import Line2D
from numpy import ndarray as Array

STYLE: Any = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.labelsize": 8.5,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "savefig.dpi": 180,
    "figure.facecolor": "white",
}

# Okabe and Ito's colors, distinct for color-blind readers; always combined with a mark.
BLUE, RED, GREEN, ORANGE, SKY, PURPLE, DARK_GRAY = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#E69F00",
    "#56B4E9",
    "#CC79A7",
    "#444444",
)
GRAY, LIGHT_GRAY = "#8c8c8c", "#c9c9c9"
_COLORS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY, DARK_GRAY)
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
_ORDINALS = ("largest component", "second largest", "third largest", "fourth largest")


class MarkerStyle(NamedTuple):
    """Color and mark of the members of a component."""

    color: str
    marker: str


ISOLATED = MarkerStyle(GRAY, "o")


def marker_style(rank: int) -> MarkerStyle:
    """Return the mark of a component by its rank in size; distinct for the first 56."""
    return MarkerStyle(_COLORS[rank % len(_COLORS)], _MARKERS[rank % len(_MARKERS)])


def style_components(
    component: Int[Array, " agents"],
) -> list[tuple[Int[Array, " members"], MarkerStyle]]:
    """Return the components with their marks, largest first; isolated agents last, together."""
    labels, counts = np.unique(component[component >= 0], return_counts=True)
    together = labels[np.argsort(-counts, kind="stable")][: int((counts > 1).sum())]
    found = [
        (np.flatnonzero(component == c), marker_style(rank)) for rank, c in enumerate(together)
    ]
    alone = np.flatnonzero(np.isin(component, labels[counts == 1]))
    return [*found, (alone, ISOLATED)] if len(alone) else found


def component_legend(ranks: int, alone: bool) -> list[Line2D]:
    """Return legend entries of this number of components."""
    said = [
        _legend_marker(marker_style(rank), name)
        for rank, name in zip(range(ranks), _ORDINALS, strict=False)
    ]
    if ranks > len(_ORDINALS):
        said.append(_legend_marker(marker_style(len(_ORDINALS)), "… and so on"))
    return [*said, _legend_marker(ISOLATED, "alone", 3.0)] if alone else said


def _legend_marker(look: MarkerStyle, label: str, size: float = 4.5) -> Line2D:
    return Line2D([], [], ls="", marker=look.marker, color=look.color, ms=size, mew=0, label=label)
