"""What all figures share: colours, marks, axes and limits."""

from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure
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

# Okabe and Ito's colours, told apart by the colour-blind; never alone, always with a mark.
BLUE, RED, GREEN, ORANGE, SKY, PURPLE, DARK = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#E69F00",
    "#56B4E9",
    "#CC79A7",
    "#444444",
)
GREY, PALE = "#8c8c8c", "#c9c9c9"
_COLOURS = (BLUE, RED, GREEN, ORANGE, PURPLE, SKY, DARK)
_MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
_ORDINALS = ("largest component", "second largest", "third largest", "fourth largest")


class Mark(NamedTuple):
    """How the members of a component are drawn."""

    colour: str
    shape: str


ALONE = Mark(GREY, "o")


def mark(rank: int) -> Mark:
    """The mark of the component of a rank by size; distinct for the first 56."""
    return Mark(_COLOURS[rank % len(_COLOURS)], _MARKS[rank % len(_MARKS)])


def marked(component: Int[Array, " agents"]) -> list[tuple[Int[Array, " members"], Mark]]:
    """The components, largest first, each with its mark; those alone come last, together."""
    labels, counts = np.unique(component[component >= 0], return_counts=True)
    together = labels[np.argsort(-counts, kind="stable")][: int((counts > 1).sum())]
    found = [(np.flatnonzero(component == c), mark(rank)) for rank, c in enumerate(together)]
    alone = np.flatnonzero(np.isin(component, labels[counts == 1]))
    return [*found, (alone, ALONE)] if len(alone) else found


class Space(NamedTuple):
    """The part of space that the panels of a figure share."""

    low: Float[Array, " d"]  # [m]
    high: Float[Array, " d"]  # [m]

    @classmethod
    def around(cls, *points: Float[Array, "... d"], margin: float) -> "Space":
        """All of the points, and a margin [m]."""
        flat = np.concatenate([p.reshape(-1, p.shape[-1]) for p in points])
        flat = flat[np.isfinite(flat).all(axis=1)]
        return cls(flat.min(axis=0) - margin, flat.max(axis=0) + margin)

    @property
    def axes(self) -> int:
        """Axes of space."""
        return len(self.low)

    @property
    def unit(self) -> tuple[float, str]:
        """Metres in the unit of the axes, and its name."""
        return (1000.0, "km") if (self.high - self.low).max() > 3000 else (1.0, "m")

    @property
    def aspect(self) -> float:
        """Height over width of a panel."""
        size = self.high - self.low
        return float(np.clip(size[1] / size[0], 0.3, 2.5)) if self.axes == 2 else 0.95


def panels(
    count: int, space: Space, columns: int = 3, width: float = 3.0
) -> tuple[Figure, list[Any]]:
    """A figure of equal panels that share their limits, labelled only at its edges."""
    columns = min(columns, count) if count != 4 else 2
    rows = ceil(count / columns)
    figure = Figure(
        figsize=(width * columns + 0.5, rows * (width * space.aspect + 0.35) + 0.75),
    )
    flat = space.axes == 2
    if flat:
        figure.set_layout_engine("compressed", h_pad=0.09)
    else:  # the room that the labels of a view of space take is not all seen by the layout
        figure.set_layout_engine("constrained", rect=(0, 0, 0.96, 1))
    axes = [
        figure.add_subplot(rows, columns, i + 1, **({} if flat else {"projection": "3d"}))
        for i in range(count)
    ]
    for i, ax in enumerate(axes):
        set_space(ax, space)
        if flat:
            ax.tick_params(labelbottom=i + columns >= count, labelleft=i % columns == 0)
            if i + columns < count:
                ax.set_xlabel("")
            if i % columns:
                ax.set_ylabel("")
    return figure, axes


def set_space(ax: Any, space: Space) -> None:
    """Give axes their limits, labels and equal scales."""
    scale, unit = space.unit
    low, high = space.low / scale, space.high / scale
    for name, a, b in zip("xyz", low, high, strict=False):
        ax.set(**{f"{name}lim": (a, b), f"{name}label": f"{name} [{unit}]"})
        getattr(ax, f"{name}axis").set_major_locator(_ticks())
    if space.axes == 2:
        ax.set_aspect("equal")
        return
    ax.set_box_aspect(high - low, zoom=0.88)
    ax.tick_params(labelsize=7, pad=0)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.labelpad = 0
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(PALE)
        axis._axinfo["grid"].update(color="#e6e6e6", linewidth=0.4)


def _ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(5, steps=[1, 2, 5, 10])


def key_of(ranks: int, alone: bool) -> list[Line2D]:
    """Legend entries of so many components."""
    said = [_dot(mark(rank), name) for rank, name in zip(range(ranks), _ORDINALS, strict=False)]
    if ranks > len(_ORDINALS):
        said.append(_dot(mark(len(_ORDINALS)), "… and so on"))
    return [*said, _dot(ALONE, "alone", 3.0)] if alone else said


def _dot(look: Mark, label: str, size: float = 4.5) -> Line2D:
    return Line2D([], [], ls="", marker=look.shape, color=look.colour, ms=size, mew=0, label=label)


def entitle(ax: Any, title: str) -> None:
    """Give a panel its title; above a view of space there is room to spare."""
    ax.set_title(title, y=0.96 if hasattr(ax, "get_zlim") else None)


def letter(i: int) -> str:
    """Name of a panel: (a), (b) and so on."""
    return f"({chr(ord('a') + i % 26)})"


def shade_legs(ax: Axes, edges: list[tuple[float, float, str]]) -> None:
    """Every other leg on a pale ground, each with its name above."""
    for i, (start, end, name) in enumerate(edges):
        if i % 2:
            ax.axvspan(start, end, color="#f3f3f3", lw=0, zorder=0)
        ax.text(
            (start + end) / 2,
            1.01,
            name,
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="bottom",
            color=DARK,
            fontsize=8,
        )
