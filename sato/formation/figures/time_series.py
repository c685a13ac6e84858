"""Numbers over time: how well the shape is taken up, how fast vehicles are, how far apart."""

from math import ceil
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy import ndarray as Array
from scipy.spatial.distance import pdist

from sato.figures.axes import draw_limit
from sato.figures.style import BLUE, DARK_GRAY, GRAY, PURPLE, SKY
from sato.formation.check import FormationRecord
from sato.formation.figures.phases import formation_name, is_leg_active, phase_spans, subsample
from sato.formation.figures.trajectories import VEHICLE_DIAMETER
from sato.formation.shape_error import compute_shape_error

MAX_LEGS_ON_ONE_LINE, MAX_NAMED_LEGS = (
    3,
    7,
)  # legs, up to which there is room for their names, and for them in a column
MAX_SAMPLES = 1500  # at the shape, at most: each takes a while
PHASE_STYLES = {
    "waiting": ("#ededed", ""),
    "flying": ("none", ""),
    "gridlock": ("#fdeed6", "//"),
    "settled": ("#d9f0e6", ""),
}
HATCH_COLOR = "#f3cd94"


def plot_convergence(record: FormationRecord) -> Figure:
    """How far the swarm is from its shape, and how many do something else to avoid others."""
    figure, (error, avoid) = stack_panels(record, (2.0, 1.0))
    k = subsample(len(record.frames.time), MAX_SAMPLES)
    shapes = [gains.formation.points for gains in record.mission.gains]
    fits = [
        compute_shape_error(record.frames.position[i], shapes[record.frames.leg_index[i]][record.frames.point_index[i]])
        for i in k
    ]
    off = np.array([fit.error for fit in fits])
    error.plot(record.frames.time[k], off, color=BLUE, lw=1.2, label="error of shape")
    upside_down = np.array([fit.inverted for fit in fits]) & is_leg_active(record)[k]
    if upside_down.any():
        shown = np.where(upside_down, off, np.nan)
        error.plot(record.frames.time[k], shown, color=PURPLE, lw=2.2, label="upside down fits better")
    told = [float(e["time"]) for _, e in record.events.of_kind("assignment")]
    if told:
        error.plot(told, np.full(len(told), 0.98), "v", ms=3.5, mew=0, color=DARK_GRAY, clip_on=False,
                   transform=error.get_xaxis_transform(), label="points are taken")  # fmt: skip
    error.set(yscale="log", ylabel="root mean square\ndistance [m]")
    taken = record.mission.supervision.shape_tolerance
    draw_limit(error, taken, f"taken up,\n{taken:g} m")
    avoid.plot(record.frames.time, 100 * record.frames.avoiding.mean(axis=1), color=BLUE, lw=0.9)
    avoid.set(ylabel="avoid\nothers [%]", ylim=(0, 100))
    add_leg_names_and_legend(figure, record)
    return figure


def plot_speeds(record: FormationRecord) -> Figure:
    """What the law asks for, and what is flown."""
    limits, arrived = record.mission.limits, record.mission.supervision.convergence_speed
    figure, (wanted, plane, climb) = stack_panels(record, (1.2, 1.0, 1.0))
    asked = np.linalg.norm(record.frames.velocity_command, axis=2)
    _plot_range(wanted, record.frames.time, np.where(asked > 0, asked, np.nan))
    wanted.set(yscale="log", ylabel="asked by the\nlaw [m/s]")
    draw_limit(wanted, arrived, f"arrived,\n{arrived:g} m/s")
    _plot_range(plane, record.frames.time, np.linalg.norm(record.frames.velocity[..., :2], axis=2))
    plane.set(ylim=(0, 1.1 * limits.speed), ylabel="flown in the\nplane [m/s]")
    draw_limit(plane, limits.speed, f"limit,\n{limits.speed:g} m/s")
    _plot_range(climb, record.frames.time, np.abs(record.frames.velocity[..., 2]))
    climb.set(ylim=(0, 1.1 * limits.climb), ylabel="flown up or\ndown [m/s]")
    draw_limit(climb, limits.climb, f"limit,\n{limits.climb:g} m/s")
    add_leg_names_and_legend(figure, record)
    return figure


def plot_separation(record: FormationRecord) -> Figure:
    """Least distance between any two vehicles, seen from above."""
    figure, [ax] = stack_panels(record, (2.0,))
    least = np.array([pdist(p[:, :2]).min() for p in record.frames.position])
    ax.plot(record.frames.time, least, color=BLUE, lw=1.0, label="least distance in the plane")
    found = record.closest_approach
    ax.plot(record.frames.time[found.piece], found.distance, "v", ms=5, color=DARK_GRAY, mew=0, zorder=5,
            clip_on=False, label=f"least of all: {found.distance:.3f} m")  # fmt: skip
    keep_out = record.mission.keep_out
    ax.set(ylabel="distance [m]", ylim=(0, 1.05 * max(float(least.max()), keep_out)))
    draw_limit(ax, keep_out, f"keep-out,\n{keep_out:g} m")
    draw_limit(ax, VEHICLE_DIAMETER, f"contact,\n{VEHICLE_DIAMETER:g} m", color=GRAY)
    add_leg_names_and_legend(figure, record)
    return figure


def stack_panels(record: FormationRecord, heights: tuple[float, ...]) -> tuple[Figure, list[Any]]:
    """Panels over time, one above the other, shaded by what the swarm is about."""
    figure = Figure(figsize=(7.2, 1.35 * sum(heights) + 1.3), layout="constrained")
    rows = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    for ax in rows[:, 0]:
        for span in phase_spans(record):
            color, hatch = PHASE_STYLES[span.label]
            ax.axvspan(span.start, span.end, fc=color, ec=HATCH_COLOR, hatch=hatch, lw=0, zorder=0)
        for leg in record.replay.legs:
            ax.axvline(record.frames.time[leg.first_instant], color=DARK_GRAY, lw=0.5, zorder=0.5)
    start, end = float(record.frames.time[0]), float(record.frames.time[-1])
    rows[-1, 0].set(xlabel="time [s]", xlim=(start, max(end, start + 1e-9)))
    return figure, list(rows[:, 0])


def add_leg_names_and_legend(figure: Figure, record: FormationRecord) -> None:
    """Name the legs above the first panel, and below the last all that is drawn."""
    top, legs = figure.axes[0], len(record.replay.legs)
    for leg in record.replay.legs:
        middle = (record.frames.time[leg.first_instant] + record.frames.time[leg.last_instant]) / 2
        shape = formation_name(record, leg.leg)
        shape = shape.replace(" ", "\n") if legs > MAX_LEGS_ON_ONE_LINE else shape
        name = (
            f"leg {leg.leg + 1}\n{shape}".strip()
            if legs <= MAX_NAMED_LEGS
            else f"{leg.leg + 1}"
        )
        top.annotate(name, (middle, 1.03), xycoords=("data", "axes fraction"), ha="center",
                     va="bottom", color=DARK_GRAY, fontsize=8, annotation_clip=False)  # fmt: skip
    handles: dict[str, Any] = {}
    for ax in figure.axes:
        drawn, said = ax.get_legend_handles_labels()
        handles |= dict(zip(said, drawn, strict=True))
    for doing in dict.fromkeys(
        span.label for span in phase_spans(record) if span.label != "flying"
    ):
        color, hatch = PHASE_STYLES[doing]
        handles[doing] = Patch(fc=color, ec=HATCH_COLOR, hatch=hatch, lw=0)
    columns = len(handles) if len(handles) <= 5 else ceil(len(handles) / 2)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)


def _plot_range(ax: Any, time: Float[Array, " k"], each: Float[Array, "k agents"]) -> None:
    known = np.isfinite(each).all(axis=1)
    low, high, middle = np.full((3, len(each)), np.nan)
    low[known], high[known] = each[known].min(axis=1), each[known].max(axis=1)
    middle[known] = np.median(each[known], axis=1)
    ax.fill_between(time, low, high, color=SKY, alpha=0.45, lw=0, label="all vehicles")
    ax.plot(time, middle, color=BLUE, lw=1.0, label="median")
