"""Numbers over time: how well the shape is taken up, how fast vehicles are, how far apart."""

from math import ceil
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy import ndarray as Array
from scipy.spatial.distance import pdist

from sato.formation.plots.flown import Doing, Flown, thinned
from sato.formation.plots.traces import DIAMETER
from sato.formation.shape import likeness
from sato.plots.look import BLUE, DARK, GREY, PURPLE, RED, SKY

NAMED = 7  # legs, up to which there is room for their names
LOOKS = 1500  # at the shape, at most: each takes a while
GROUND: dict[Doing, tuple[str, str]] = {
    "hovering": ("#ededed", ""),
    "flying": ("none", ""),
    "gridlock": ("#fdeed6", "//"),
    "settled": ("#d9f0e6", ""),
}

HATCH = "#f3cd94"


def convergence(flown: Flown) -> Figure:
    """How far the swarm is from its shape, and how many do something else to avoid others."""
    figure, (error, avoid) = stacked(flown, (2.0, 1.0))
    k = thinned(len(flown.time), LOOKS)
    shapes = [gains.formation.points for gains in flown.mission.shapes]
    fits = [likeness(flown.position[i], shapes[flown.leg[i]][flown.point[i]]) for i in k]
    off = np.array([fit.error for fit in fits])
    error.plot(flown.time[k], off, color=BLUE, lw=1.2, label="error of shape")
    upside_down = np.array([fit.inverted for fit in fits]) & flown.under_way[k]
    if upside_down.any():
        shown = np.where(upside_down, off, np.nan)
        error.plot(flown.time[k], shown, color=PURPLE, lw=2.2, label="upside down fits better")
    told = [float(e["time"]) for _, e in flown.happened.told("assignment")]
    if told:
        error.plot(told, np.full(len(told), 0.98), "v", ms=3.5, mew=0, color=DARK, clip_on=False,
                   transform=error.get_xaxis_transform(), label="points are taken")  # fmt: skip
    error.set(yscale="log", ylabel="root mean square\ndistance [m]")
    limit(error, flown.mission.protocol.shape, "taken up", "m")
    avoid.plot(flown.time, 100 * flown.avoiding.mean(axis=1), color=BLUE, lw=0.9)
    avoid.set(ylabel="avoid\nothers [%]", ylim=(0, 100))
    finish(figure, flown)
    return figure


def speeds(flown: Flown) -> Figure:
    """What the law asks for, and what is flown."""
    limits, arrived = flown.mission.limits, flown.mission.protocol.settled
    figure, (wanted, plane, climb) = stacked(flown, (1.2, 1.0, 1.0))
    asked = np.linalg.norm(flown.command, axis=2)
    _crowd(wanted, flown.time, np.where(asked > 0, asked, np.nan))
    wanted.set(yscale="log", ylabel="asked by the\nlaw [m/s]")
    limit(wanted, arrived, "arrived", "m/s")
    _crowd(plane, flown.time, np.linalg.norm(flown.velocity[..., :2], axis=2))
    plane.set(ylim=(0, 1.1 * limits.speed), ylabel="flown in the\nplane [m/s]")
    limit(plane, limits.speed, "limit", "m/s")
    _crowd(climb, flown.time, np.abs(flown.velocity[..., 2]))
    climb.set(ylim=(0, 1.1 * limits.climb), ylabel="flown up or\ndown [m/s]")
    limit(climb, limits.climb, "limit", "m/s")
    finish(figure, flown)
    return figure


def separation(flown: Flown) -> Figure:
    """Least distance between any two vehicles, seen from above."""
    figure, [ax] = stacked(flown, (2.0,))
    least = np.array([pdist(p[:, :2]).min() for p in flown.position])
    ax.plot(flown.time, least, color=BLUE, lw=1.0, label="least distance in the plane")
    k = int(least.argmin())
    ax.plot(flown.time[k], least[k], "v", ms=5, color=DARK, mew=0, zorder=5, clip_on=False,
            label=f"least of all: {least[k]:.3f} m")  # fmt: skip
    keep_out = flown.mission.avoidance.keep_out
    ax.set(ylabel="distance [m]", ylim=(0, 1.05 * max(float(least.max()), keep_out)))
    limit(ax, keep_out, "keep-out", "m")
    limit(ax, DIAMETER, "contact", "m", colour=GREY)
    finish(figure, flown)
    return figure


def stacked(flown: Flown, heights: tuple[float, ...]) -> tuple[Figure, list[Any]]:
    """Panels over time, one above the other, shaded by what the swarm is about."""
    figure = Figure(figsize=(7.2, 1.35 * sum(heights) + 1.3), layout="constrained")
    rows = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    for ax in rows[:, 0]:
        for span in flown.spans:
            colour, hatch = GROUND[span.doing]
            ax.axvspan(span.start, span.end, fc=colour, ec=HATCH, hatch=hatch, lw=0, zorder=0)
        for stretch in flown.stretches:
            ax.axvline(flown.time[stretch.first], color=DARK, lw=0.5, zorder=0.5)
    start, end = float(flown.time[0]), float(flown.time[-1])
    rows[-1, 0].set(xlabel="time [s]", xlim=(start, max(end, start + 1e-9)))
    return figure, list(rows[:, 0])


def limit(ax: Any, level: float, name: str, unit: str, colour: str = RED) -> None:
    """A level that means something, named on the right."""
    ax.axhline(level, color=colour, ls="--" if colour == RED else ":", lw=0.9)
    ax.annotate(f"{name},\n{level:g} {unit}", (1.008, level), xycoords=("axes fraction", "data"),
                va="center", color=colour, fontsize=7.5, annotation_clip=False)  # fmt: skip


def finish(figure: Figure, flown: Flown) -> None:
    """Name the legs above the first panel, and below the last all that is drawn."""
    top, few = figure.axes[0], len(flown.stretches) <= NAMED
    for stretch in flown.stretches:
        middle = (flown.time[stretch.first] + flown.time[stretch.last]) / 2
        words = [f"leg {stretch.leg + 1}", *flown.called(stretch.leg).split()]
        name = "\n".join(words) if few else f"{stretch.leg + 1}"
        top.annotate(name, (middle, 1.03), xycoords=("data", "axes fraction"), ha="center",
                     va="bottom", color=DARK, fontsize=8, annotation_clip=False)  # fmt: skip
    handles: dict[str, Any] = {}
    for ax in figure.axes:
        drawn, said = ax.get_legend_handles_labels()
        handles |= dict(zip(said, drawn, strict=True))
    for doing in dict.fromkeys(span.doing for span in flown.spans if span.doing != "flying"):
        colour, hatch = GROUND[doing]
        handles[doing] = Patch(fc=colour, ec=HATCH, hatch=hatch, lw=0)
    columns = len(handles) if len(handles) <= 5 else ceil(len(handles) / 2)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)


def _crowd(ax: Any, time: Float[Array, " k"], each: Float[Array, "k agents"]) -> None:
    known = np.isfinite(each).all(axis=1)
    low, high, middle = np.full((3, len(each)), np.nan)
    low[known], high[known] = each[known].min(axis=1), each[known].max(axis=1)
    middle[known] = np.median(each[known], axis=1)
    ax.fill_between(time, low, high, color=SKY, alpha=0.45, lw=0, label="all vehicles")
    ax.plot(time, middle, color=BLUE, lw=1.0, label="median")
