"""Time series: shape error, speeds, separation and auctions."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Int
from matplotlib.figure import Figure
from numpy import ndarray as Array
from scipy.spatial.distance import pdist

from problems.alignment import compute_shape_error
from sato.figures import panels
from sato.figures.axes import add_legend, as_label
from sato.figures.style import BLUE, DARK_GRAY, GRAY, PURPLE
from sato.formation.check.recorded import FormationRecord
from sato.formation.supervisor import Phase

VEHICLE_DIAMETER = 0.5  # of a vehicle [Lusk2020, sec. V] [m]
MAX_NAMED_LEGS = 7  # up to which their names have room
MAX_SAMPLES = 1500  # of the shape error, each of which takes an alignment
WAITING: dict[str, Any] = {"color": "#ededed", "label": "waiting"}
CONVERGED: dict[str, Any] = {"color": "#d9f0e6", "label": "converged"}
GRIDLOCK: dict[str, Any] = {"color": "#fdeed6", "hatch": "//", "ec": "#f3cd94", "label": "gridlock"}
LEGACY_GRIDLOCK = GRIDLOCK | {"label": "gridlock as printed: some avoid others all the time"}
PHASE_STYLES = {Phase.WAITING: WAITING, Phase.CONVERGED: CONVERGED, Phase.COMPLETED: CONVERGED}


def phase_spans(record: FormationRecord) -> list[panels.Interval]:
    """Divide a flight into phases, from start to end without gaps."""
    phases = np.array(record.replay.phase)
    return panels.find_intervals(record.time[: len(phases)], phases)


def is_leg_active(record: FormationRecord) -> Bool[Array, " instants"]:
    """Tell at which instants a formation is flown to, or held."""
    active = [phase is not Phase.WAITING for phase in record.replay.phase]
    return np.pad(np.array(active), (0, len(record.time) - len(active)))


def formation_name(record: FormationRecord, leg: int) -> str:
    """Return the name of a leg's formation without that of its group; it may be empty."""
    return as_label(record.mission.gains[leg].formation.name.rpartition("/")[2])


def subsample(count: int, most: int) -> Int[Array, " kept"]:
    """Return at most so many of the first numbers, evenly spaced, with first and last."""
    return np.round(np.linspace(0, count - 1, min(count, most))).astype(int)


def plot_convergence(record: FormationRecord) -> Figure:
    """Plot the shape error, and the share of vehicles that avoid others."""
    figure, (error, avoid) = panels.stack(record.time, 2.0, 1.0)
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
        mark = {"ms": 3.5, "color": DARK_GRAY, "transform": error.get_xaxis_transform()}
        error.plot(assigned, [0.98] * len(assigned), "v", **mark, label="points are assigned")
    error.set(yscale="log", ylabel="root mean square\ndistance [m]")
    tolerance = record.mission.supervision.shape_tolerance
    panels.draw_limit(error, tolerance, f"taken up,\n{tolerance:g} m")
    avoid.plot(record.time, 100 * record.frames.avoiding.mean(axis=1), color=BLUE, lw=0.9)
    avoid.set(ylabel="avoid\nothers [%]", ylim=(0, 100))
    return _finish(figure, record)


def plot_speeds(record: FormationRecord) -> Figure:
    """Plot commanded and flown speeds."""
    mission, arrived = record.mission, record.mission.supervision.convergence_speed
    figure, (commanded, plane, climb) = panels.stack(record.time, 1.2, 1.0, 1.0)
    command = np.linalg.norm(record.frames.velocity_command, axis=2)
    is_commanded = (command > 0).all(axis=1, keepdims=True)
    panels.plot_spread(commanded, record.time, np.where(is_commanded, command, np.nan))
    commanded.set(yscale="log", ylabel="commanded\n[m/s]")
    panels.draw_limit(commanded, arrived, f"arrived,\n{arrived:g} m/s")
    planar = np.linalg.norm(record.frames.velocity[..., :2], axis=2)
    vertical = np.abs(record.frames.velocity[..., 2])
    for ax, speed, limit, way in (
        (plane, planar, mission.max_speed, "in the\nplane"),
        (climb, vertical, mission.max_climb, "up or\ndown"),
    ):
        panels.plot_spread(ax, record.time, speed)
        ax.set(ylim=(0, 1.1 * limit), ylabel=f"flown {way} [m/s]")
        panels.draw_limit(ax, limit, f"limit,\n{limit:g} m/s")
    return _finish(figure, record)


def plot_separation(record: FormationRecord) -> Figure:
    """Plot the least distance of two vehicles in the plane."""
    figure, [ax] = panels.stack(record.time, 2.0)
    least = np.array([pdist(p[:, :2]).min() for p in record.frames.position])
    ax.plot(record.time, least, color=BLUE, lw=1.0, label="least distance in the plane")
    found = record.closest_approach
    mark = {"ms": 5, "color": DARK_GRAY, "mew": 0, "label": f"least of all: {found.distance:.3f} m"}
    ax.plot(record.time[found.instant], found.distance, "v", **mark)
    keep_out = record.mission.keep_out
    ax.set(ylabel="distance [m]", ylim=(0, 1.05 * max(float(least.max()), keep_out)))
    panels.draw_limit(ax, keep_out, f"keep-out,\n{keep_out:g} m")
    panels.draw_limit(ax, VEHICLE_DIAMETER, f"contact,\n{VEHICLE_DIAMETER:g} m", color=GRAY)
    return _finish(figure, record)


def plot_assignments(record: FormationRecord) -> Figure:
    """Plot the number of changed points over time, and the rounds and bits of every auction."""
    figure, (changes, rounds) = panels.stack(record.time, 1.0, 1.0)
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
    return _finish(figure, record)


def _finish(figure: Figure, record: FormationRecord) -> Figure:
    """Shade phases, name legs above the first panel, and add a legend below the last."""
    gridlock = LEGACY_GRIDLOCK if record.mission.avoidance.legacy else GRIDLOCK
    styles = PHASE_STYLES | dict.fromkeys((Phase.GRIDLOCKED, Phase.ABORTED), gridlock)
    for span in phase_spans(record):
        if span.value in styles:
            panels.shade(figure.axes, span, **styles[span.value])
    spans = []
    for leg in record.replay.legs:
        shape = formation_name(record, leg.leg).replace(" ", "\n")
        name = f"leg {leg.leg + 1}\n{shape}".strip()
        name = name if len(record.replay.legs) <= MAX_NAMED_LEGS else f"{leg.leg + 1}"
        start, end = record.time[[leg.first_instant, leg.last_instant]]
        spans.append(panels.Interval(name, start, end))
    panels.mark_legs(figure.axes, spans)
    add_legend(figure)
    return figure
