"""Time series: shape error, speeds, separation and auctions."""

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

MAX_LEGS_ON_ONE_LINE = 3  # up to which their names have room on one line
MAX_NAMED_LEGS = 7  # up to which their names have room at all
MAX_SAMPLES = 1500  # of the shape error, each of which takes an alignment
PHASE_STYLES = {
    "waiting": ("#ededed", ""),
    "flying": ("none", ""),
    "gridlock": ("#fdeed6", "//"),
    "converged": ("#d9f0e6", ""),
}
HATCH_COLOR = "#f3cd94"


def plot_convergence(record: FormationRecord) -> Figure:
    """Plot the shape error, and the share of vehicles that avoid others."""
    figure, (error, avoid) = _stack_panels(record, (2.0, 1.0))
    k = subsample(len(record.time), MAX_SAMPLES)
    shapes = [gains.formation.points for gains in record.mission.gains]
    position, held = record.frames.position, record.frames.point_index
    fits = [compute_shape_error(position[i], shapes[record.leg_index[i]][held[i]]) for i in k]
    off = np.array([fit.error for fit in fits])
    error.plot(record.time[k], off, color=BLUE, lw=1.2, label="shape error")
    upside_down = np.array([fit.inverted for fit in fits]) & is_leg_active(record)[k]
    if upside_down.any():
        shown = np.where(upside_down, off, np.nan)
        error.plot(record.time[k], shown, color=PURPLE, lw=2.2, label="upside down fits better")
    assigned = [float(e["time"]) for _, e in record.events.of_kind("assignment")]
    if assigned:
        error.plot(assigned, np.full(len(assigned), 0.98), "v", ms=3.5, mew=0, color=DARK_GRAY,
                   clip_on=False, transform=error.get_xaxis_transform(),
                   label="points are assigned")  # fmt: skip
    error.set(yscale="log", ylabel="root mean square\ndistance [m]")
    tolerance = record.mission.supervision.shape_tolerance
    draw_limit(error, tolerance, f"taken up,\n{tolerance:g} m")
    avoid.plot(record.time, 100 * record.frames.avoiding.mean(axis=1), color=BLUE, lw=0.9)
    avoid.set(ylabel="avoid\nothers [%]", ylim=(0, 100))
    _add_leg_names_and_legend(figure, record)
    return figure


def plot_speeds(record: FormationRecord) -> Figure:
    """Plot commanded and flown speeds."""
    mission, arrived = record.mission, record.mission.supervision.convergence_speed
    figure, (commanded, plane, climb) = _stack_panels(record, (1.2, 1.0, 1.0))
    command = np.linalg.norm(record.frames.velocity_command, axis=2)
    _plot_range(commanded, record.time, np.where(command > 0, command, np.nan))
    commanded.set(yscale="log", ylabel="commanded\n[m/s]")
    draw_limit(commanded, arrived, f"arrived,\n{arrived:g} m/s")
    _plot_range(plane, record.time, np.linalg.norm(record.frames.velocity[..., :2], axis=2))
    plane.set(ylim=(0, 1.1 * mission.max_speed), ylabel="flown in the\nplane [m/s]")
    draw_limit(plane, mission.max_speed, f"limit,\n{mission.max_speed:g} m/s")
    _plot_range(climb, record.time, np.abs(record.frames.velocity[..., 2]))
    climb.set(ylim=(0, 1.1 * mission.max_climb), ylabel="flown up or\ndown [m/s]")
    draw_limit(climb, mission.max_climb, f"limit,\n{mission.max_climb:g} m/s")
    _add_leg_names_and_legend(figure, record)
    return figure


def plot_separation(record: FormationRecord) -> Figure:
    """Plot the least distance of two vehicles in the plane."""
    figure, [ax] = _stack_panels(record, (2.0,))
    least = np.array([pdist(p[:, :2]).min() for p in record.frames.position])
    ax.plot(record.time, least, color=BLUE, lw=1.0, label="least distance in the plane")
    found = record.closest_approach
    ax.plot(record.time[found.piece], found.distance, "v", ms=5, color=DARK_GRAY, mew=0, zorder=5,
            clip_on=False, label=f"least of all: {found.distance:.3f} m")  # fmt: skip
    keep_out = record.mission.keep_out
    ax.set(ylabel="distance [m]", ylim=(0, 1.05 * max(float(least.max()), keep_out)))
    draw_limit(ax, keep_out, f"keep-out,\n{keep_out:g} m")
    draw_limit(ax, VEHICLE_DIAMETER, f"contact,\n{VEHICLE_DIAMETER:g} m", color=GRAY)
    _add_leg_names_and_legend(figure, record)
    return figure


def plot_assignments(record: FormationRecord) -> Figure:
    """Plot the number of changed points over time, and the rounds and bits of every auction."""
    figure, (changes, rounds) = _stack_panels(record, (1.0, 1.0))
    changed = [(e["time"], len(e["agents"])) for _, e in record.events.of_kind("assignment")]
    played = [(e["time"], e["rounds"]) for _, e in record.events.of_kind("auction")]
    for ax, values in ((changes, changed), (rounds, played)):
        time, height = np.array(values, dtype=float).reshape(-1, 2).T
        ax.vlines(time, 0, height, color=BLUE, lw=1.2)
        ax.plot(time, height, "o", ms=3.5, mew=0, color=BLUE)
        ax.set_ylim(0, 1.12 * max(float(height.max(initial=0)), 1))
    changes.set_ylabel("agents with\nnew points")
    rounds.set_ylabel("rounds of\nmessages")
    each = record.mission.radio.count_auction_bits(record.mission.agents, 1) / 1000  # kbit
    bits = rounds.secondary_yaxis("right", functions=(lambda r: r * each, lambda b: b / each))
    bits.set_ylabel("kbit a neighbor")
    bits.spines["right"].set_visible(True)
    _add_leg_names_and_legend(figure, record)
    return figure


def _stack_panels(record: FormationRecord, heights: tuple[float, ...]) -> tuple[Figure, list[Any]]:
    """Make panels over time, one above the other, shaded by phase."""
    figure = Figure(figsize=(7.2, 1.35 * sum(heights) + 1.3), layout="constrained")
    rows = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    for ax in rows[:, 0]:
        for span in phase_spans(record):
            color, hatch = PHASE_STYLES[span.label]
            ax.axvspan(span.start, span.end, fc=color, ec=HATCH_COLOR, hatch=hatch, lw=0, zorder=0)
        for leg in record.replay.legs:
            ax.axvline(record.time[leg.first_instant], color=DARK_GRAY, lw=0.5, zorder=0.5)
    start, end = float(record.time[0]), float(record.time[-1])
    rows[-1, 0].set(xlabel="time [s]", xlim=(start, max(end, start + 1e-9)))
    return figure, list(rows[:, 0])


def _add_leg_names_and_legend(figure: Figure, record: FormationRecord) -> None:
    """Name the legs above the first panel, and add a legend below the last."""
    top, legs = figure.axes[0], len(record.replay.legs)
    for leg in record.replay.legs:
        middle = (record.time[leg.first_instant] + record.time[leg.last_instant]) / 2
        shape = formation_name(record, leg.leg)
        shape = shape.replace(" ", "\n") if legs > MAX_LEGS_ON_ONE_LINE else shape
        name = f"leg {leg.leg + 1}\n{shape}".strip() if legs <= MAX_NAMED_LEGS else f"{leg.leg + 1}"
        top.annotate(name, (middle, 1.03), xycoords=("data", "axes fraction"), ha="center",
                     va="bottom", color=DARK_GRAY, fontsize=8, annotation_clip=False)  # fmt: skip
    handles: dict[str, Any] = {}
    for ax in figure.axes:
        drawn, labels = ax.get_legend_handles_labels()
        handles |= dict(zip(labels, drawn, strict=True))
    labels = [span.label for span in phase_spans(record) if span.label != "flying"]
    for label in dict.fromkeys(labels):
        color, hatch = PHASE_STYLES[label]
        handles[label] = Patch(fc=color, ec=HATCH_COLOR, hatch=hatch, lw=0)
    columns = len(handles) if len(handles) <= 5 else ceil(len(handles) / 2)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)


def _plot_range(ax: Any, time: Float[Array, " k"], each: Float[Array, "k agents"]) -> None:
    known = np.isfinite(each).all(axis=1)
    low, high, middle = np.full((3, len(each)), np.nan)
    low[known], high[known] = each[known].min(axis=1), each[known].max(axis=1)
    middle[known] = np.median(each[known], axis=1)
    ax.fill_between(time, low, high, color=SKY, alpha=0.45, lw=0, label="all vehicles")
    ax.plot(time, middle, color=BLUE, lw=1.0, label="median")
