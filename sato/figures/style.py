"""Colors and marks that all figures share."""

from typing import Any

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

STYLE: Any = {
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    **dict.fromkeys([f"axes3d.{axis}axis.panecolor" for axis in "xyz"], "white"),
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.4,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "savefig.dpi": 180,
}

# Okabe and Ito's colors, distinct for color-blind readers; always combined with a mark.
BLUE, RED, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PURPLE = "#E69F00", "#56B4E9", "#CC79A7"
VIVID = "#E6007E"  # of broken promises
DARK_GRAY, GRAY, LIGHT_GRAY = "#444444", "#8c8c8c", "#c9c9c9"
_COLORS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY, DARK_GRAY)
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "p")
_COMPONENTS = ("largest component", "second largest", "third largest", "fourth largest", "others")


ISOLATED: dict[str, Any] = {"color": GRAY, "marker": "o"}


def marker_style(rank: int) -> dict[str, Any]:
    """Return color and mark of a component by its rank in size; distinct for the first 56."""
    return {"color": _COLORS[rank % len(_COLORS)], "marker": _MARKERS[rank % len(_MARKERS)]}


def style_components(
    component: Int[Array, " agents"],
) -> list[tuple[Int[Array, " members"], dict[str, Any], str]]:
    """Return components with marks and names, largest first; isolated agents last, together."""
    labels, counts = np.unique(component[component >= 0], return_counts=True)
    found = []
    for rank, k in enumerate(np.argsort(-counts, kind="stable")[: int((counts > 1).sum())]):
        name = _COMPONENTS[min(rank, len(_COMPONENTS) - 1)]
        found.append((np.flatnonzero(component == labels[k]), marker_style(rank), name))
    alone = np.flatnonzero(np.isin(component, labels[counts == 1]))
    return [*found, (alone, ISOLATED, "alone")] if len(alone) else found
