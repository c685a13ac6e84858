"""Drifts after a loss of thrust: where they lead, and how near they come to others."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy import ndarray as Array

from dynamics.trajectory_geometry import evaluate_bezier
from sato.figures import panels
from sato.figures.axes import ORBITAL_PLANE, add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GRAY, LIGHT_GRAY
from sato.reconfiguration.check.drifts import (
    FlownDrifts,
    approach_others,
    find_first_losses,
    follow_leg,
)
from sato.reconfiguration.check.recorded import ReconfigurationRecord

POINTS = 6  # of a piece
COLORS = "viridis"  # of the time at which the thrust is lost
KILOMETER = 1000.0  # [m]


def plot_drifts(record: ReconfigurationRecord) -> Figure:
    """Plot the drifts of the vehicle that comes nearest to another, and the distances of all."""
    approaches, leg = record.drift_approaches, record.leg_records[0]
    nearest = None if approaches is None else approaches.nearest
    if nearest is not None:
        leg = next(each for each in record.leg_records if nearest.step <= each.end_index)
    flown, agents = follow_leg(record, leg), np.flatnonzero(leg.alive)
    row = 0 if nearest is None else int(np.flatnonzero(agents == nearest.agent)[0])
    figure = Figure(figsize=(8.2, 5.6), layout="constrained")
    plane, distances = figure.subplots(2, 1, height_ratios=(1.4, 1))
    _draw_plane(plane, flown, row)
    step = record.mission.step * ORBITAL_PLANE.time_scale
    shades = ScalarMappable(Normalize(0.0, step * leg.step_count), COLORS)
    beside = plane.inset_axes([1.03, 0.0, 0.02, 1.0])
    figure.colorbar(shades, cax=beside, label=f"loss of thrust [{ORBITAL_PLANE.time_unit}]")
    _draw_distances(distances, record, flown)
    titles = [f"drifts of agent {agents[row]}", "least distance from all others, of each agent"]
    add_titles((plane, distances), titles, loc="left")
    add_legend(figure)
    return figure


def _draw_plane(ax: Any, flown: FlownDrifts, row: int) -> None:
    _, horizon, drifts = flown
    T = horizon.steps.steps
    for path in drifts.path[np.delete(np.arange(len(drifts.path)), row)]:
        ax.plot(*_trace(path), color=LIGHT_GRAY, lw=0.7, label="others, as planned")
    lines = [_trace(drifts.drifts[row, horizon.step == k]).T for k in range(1, T)]
    style: dict[str, Any] = {"cmap": COLORS, "norm": Normalize(0, T), "array": np.arange(1, T)}
    ax.add_collection(LineCollection(lines, lw=0.6, **style))
    ax.plot(*_trace(drifts.path[row, :T]), color=BLUE, lw=1.6, label="with thrust")
    ax.plot(0, 0, marker="+", ms=7, color=DARK_GRAY, ls="", label="chief")
    ax.autoscale_view()
    ax.set(xlabel=f"{ORBITAL_PLANE.labels[0]} [km]", ylabel=f"{ORBITAL_PLANE.labels[1]} [km]")


def _trace(pieces: Float[Array, "pieces 4 d"]) -> Float[Array, "2 points"]:
    """Return points of pieces in the orbital plane [km]."""
    shares = np.linspace(0.0, 1.0, POINTS)[:, None]
    points = evaluate_bezier(pieces[None], np.broadcast_to(shares, (POINTS, len(pieces))))
    return ORBITAL_PLANE.project(points.swapaxes(0, 1).reshape(-1, pieces.shape[-1])).T / KILOMETER


def _draw_distances(ax: Any, record: ReconfigurationRecord, flown: FlownDrifts) -> None:
    times = np.arange(flown.leg.step_count) * record.mission.step * ORBITAL_PLANE.time_scale
    for row, first in enumerate(find_first_losses(record, flown.leg)):
        losses = (flown.horizon.step == k for k in range(1, len(times)))
        found = [approach_others(flown, row, loss) for loss in losses]
        least = np.array([np.nan, *(np.nan if one is None else one.distance for one in found)])
        counts = np.arange(len(times)) > first
        before, after = np.where(counts, np.nan, least), np.where(counts, least, np.nan)
        ax.plot(times, after, color=BLUE, lw=0.8, alpha=0.6, label="after its first thrust")
        ax.plot(times, before, color=GRAY, lw=0.8, ls=":", label="before it")
    asked = record.mission.passive_safety
    assert asked is not None
    ax.set(ylim=(0, None), ylabel="least distance [m]")
    ax.set_xlabel(f"loss of thrust [{ORBITAL_PLANE.time_unit}]")
    panels.draw_limit(ax, asked, f"passive safety,\n{asked:g} m")
