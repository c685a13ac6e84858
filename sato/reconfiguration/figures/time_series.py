"""Thrust, velocity, position and distance to the target over time."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy import ndarray as Array

from sato.figures import panels
from sato.figures.axes import add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GREEN, ORANGE, PURPLE, RED, SKY
from sato.reconfiguration.check.fuel import compute_step_fuel
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.figures.scene import Scene

MAX_EACH = 5  # agents up to which all are drawn; of more, bands of quantiles and three
BANDS = ((0, 100, 0.18), (5, 95, 0.3), (25, 75, 0.4))  # percentiles, and how dark they are
AGENT_COLORS = (BLUE, ORANGE, GREEN, PURPLE, DARK_GRAY)
MILLIMETER = 1e-3  # [m]
KILOMETER = 1e3  # [m]


def plot_time_series(record: ReconfigurationRecord) -> Figure:
    """Plot thrust, velocity and position along each axis, and the distance to the target held.

    Of many agents, bands are quantiles over those that are alive, and three have lines: those
    with the least, the median and the most fuel.
    """
    scene, mission, frames = Scene(record), record.mission, record.frames
    t, d = record.time * scene.view.time_scale, mission.axes
    in_orbit = record.variables.chief is not None
    near, far = (MILLIMETER, "mm"), (KILOMETER, "km")
    small, large = (near, far) if in_orbit else ((1.0, "m"), (1.0, "m"))
    there = frames.alive[..., None]
    control = np.where(there, frames.applied_control, np.nan)
    control[-1] = np.nan
    speed = np.max([one.most * one.shares for one in mission.speed_limits], axis=0)
    limits = mission.largest_control / small[0], speed, np.full(d, np.nan)
    rows = (
        (f"thrust [{small[1]}/s²]", control / small[0]),
        ("velocity [m/s]", np.where(there, frames.velocity, np.nan)),
        (f"position [{large[1]}]", np.where(there, frames.position, np.nan) / large[0]),
    )
    agents = select_agents(record)
    figure = Figure(figsize=(3.1 * d + 1.2, 7.6), layout="constrained")
    grid = figure.add_gridspec(4, d)
    names = ("x, radial", "y, along-track", "z, normal") if in_orbit else ("x", "y", "z")
    for row, ((label, values), most) in enumerate(zip(rows, limits, strict=True)):
        for axis in range(d):
            ax = figure.add_subplot(grid[row, axis])
            _plot_agents(ax, t, values[..., axis], agents, is_step=row == 0)
            panels.set_time_axis(ax, t, scene.view.time_unit)
            ax.set(xlabel="", ylabel=label if axis == 0 else "")
            ax.tick_params(labelbottom=False)
            for level in (-most[axis], most[axis]):
                if np.isfinite(level):
                    ax.axhline(level, color=RED, ls="--", lw=0.9, zorder=1, label="limit")
    add_titles(figure.axes[:d], names)
    error = figure.add_subplot(grid[3, :])
    for leg in record.leg_records:
        own = t[leg.start_index : leg.end_index + 1]
        _plot_agents(error, own, np.maximum(_target_distance(record, leg), 1e-12), agents)
    panels.set_time_axis(error, t, scene.view.time_unit)
    error.set(yscale="log", ylabel="distance to the\ntarget held [m]")
    error.set_ylim(bottom=0.1 * mission.position_tolerance)
    panels.draw_limit(error, mission.position_tolerance, "arrived")
    for ax in figure.axes:
        for leg in record.leg_records[1:]:
            ax.axvline(t[leg.start_index], color=DARK_GRAY, lw=0.5, zorder=0.5)
    band: list[Any] = []
    if frames.alive.shape[1] > MAX_EACH:
        shades = zip(BANDS, ("all agents", "5–95 %", "25–75 %"), strict=True)
        band = [Patch(fc=SKY, alpha=alpha + 0.1, label=name) for (*_, alpha), name in shades]
    add_legend(figure, *band)
    return figure


def select_agents(record: ReconfigurationRecord) -> Int[Array, " agents"]:
    """Select the agents that are drawn: all if few, else by their fuel among the survivors."""
    fuel = compute_step_fuel(record).sum(axis=0)
    if len(fuel) <= MAX_EACH:
        return np.arange(len(fuel))
    stays = np.flatnonzero(record.frames.alive[-1])
    order = stays[np.argsort(fuel[stays], kind="stable")]
    return np.unique(order[[0, len(order) // 2, -1]]) if len(order) else order


def _target_distance(
    record: ReconfigurationRecord, leg: LegRecord
) -> Float[Array, "instants agents"]:
    """Compute the distance of each agent from the target that it holds in a leg, if any [m]."""
    k, d = slice(leg.start_index, leg.end_index + 1), record.mission.axes
    held = np.where(record.frames.alive[k], record.frames.target_index[k], -1)
    held[-1] = np.where(leg.alive, leg.target_index, -1)  # the frame is of the next leg
    target = record.targets[leg.leg_index][np.maximum(held, 0), :d]
    return np.where(held >= 0, np.linalg.norm(record.frames.position[k] - target, axis=2), np.nan)


def _plot_agents(
    ax: Any,
    time: Float[Array, " k"],
    values: Float[Array, "k agents"],
    chosen: Int[Array, " chosen"],
    is_step: bool = False,
) -> None:
    known = np.isfinite(values).any(axis=1)
    if values.shape[1] > MAX_EACH and known.any():
        step = {"step": "post"} if is_step else {}
        for low, high, alpha in BANDS:
            edges = np.nanpercentile(values[known], [low, high], axis=1)
            ax.fill_between(time[known], *edges, fc=SKY, lw=0, alpha=alpha, **step)
    style = {"drawstyle": "steps-post"} if is_step else {}
    for color, agent in zip(AGENT_COLORS, chosen, strict=False):
        ax.plot(time, values[:, agent], color=color, lw=0.9, label=f"agent {agent}", **style)
