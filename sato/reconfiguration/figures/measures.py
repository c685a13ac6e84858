"""Least separation over time, and fuel of the agents against their lower bounds."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dynamics.trajectory_geometry import sampled_separations
from sato.figures import panels
from sato.figures.axes import add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GRAY, RED, SKY
from sato.reconfiguration.check.fuel import (
    compute_agent_bounds,
    compute_asked_bound,
    compute_step_fuel,
)
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.scene import Scene


def plot_separation(record: ReconfigurationRecord) -> Figure:
    """Plot the least separation of any two agents along their continuous trajectories."""
    scene = Scene(record)
    t, radius = record.time * scene.view.time_scale, record.mission.largest_separation
    figure, [ax] = panels.stack(t, 1.6, unit=scene.view.time_unit)
    # One value a control step: the least of its pieces.
    between = record.separations[0].distance.reshape(-1, record.pieces_per_step).min(axis=1)
    between = np.where(np.isfinite(between), between, np.nan)
    samples = sampled_separations(record.frames.position, record.frames.alive)
    samples = np.where(np.isfinite(samples), samples, np.nan)
    ax.stairs(between, t, baseline=None, color=BLUE, lw=1.1, label="least within each step")
    ax.plot(t, samples, color=GRAY, lw=0.7, label="at control instants")
    if np.isfinite(between).any():
        k = int(np.nanargmin(between))
        mark = {"marker": "v", "ms": 5, "color": DARK_GRAY, "ls": "", "zorder": 5}
        ax.plot((t[k] + t[k + 1]) / 2, between[k], **mark, label=f"least: {between[k]:.6g} m")
    ax.set(ylabel="least separation [m]", ylim=(0, None))
    panels.draw_limit(ax, radius, f"collision\nradius, {radius:g} m")
    panels.mark_instants([ax], [t[k] for k, _ in record.events.of_kind("loss")], "loss of agents")
    legs = []
    for leg in record.leg_records:
        name = scene.leg_names[leg.leg_index]
        legs.append(panels.Interval(name, t[leg.start_index], t[leg.end_index]))
    panels.mark_legs([ax], legs)
    add_legend(figure)
    return figure


def plot_fuel(record: ReconfigurationRecord) -> Figure:
    """Plot the fuel of agents against bounds by the shared model; the swarm's are in the title."""
    fuel, bound = compute_step_fuel(record).sum(axis=0), compute_agent_bounds(record)
    stays = record.frames.alive[-1]
    top = 1.05 * float(np.nanmax([fuel, bound], initial=0.0)) or 1.0
    figure = Figure(figsize=(5.4, 4.9), layout="constrained")
    ax = figure.add_subplot()
    ax.plot([0, top], [0, top], color=RED, ls="--", lw=1, label="bound of each agent")
    mark: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4, "mew": 0, "alpha": 0.75}
    ax.plot(bound[stays], fuel[stays], color=BLUE, **mark, label="alive at the end")
    if not stays.all():
        ax.plot(bound[~stays], fuel[~stays], color=GRAY, **mark, label="lost")
    title = [f"fuel of the swarm: {float(fuel.sum()):.4g} m/s", *_bounds_of_swarm(record)]
    ax.set_title("\n".join(title), loc="left", fontsize=8.5)
    ax.set(xlim=(0, top), ylim=(0, top), aspect="equal", ylabel="fuel of each agent [m/s]")
    ax.set_xlabel("bound of each agent: least fuel to its own targets, by the shared model [m/s]")
    ax.legend(loc="lower right")
    return figure


def _bounds_of_swarm(record: ReconfigurationRecord) -> list[str]:
    """State the least fuel of any assignment, over the times taken and asked for."""
    legs, bounds = record.leg_records, [each for each in record.fuel_bounds if each is not None]
    if not len(bounds) == len(legs) == len(record.mission.legs):
        return []
    taken = sum(each.total for each in bounds)
    asked = sum(compute_asked_bound(record, *each) for each in zip(legs, bounds, strict=True))
    least = "least by any assignment, in the time"
    found = [f"{least} taken: {taken:.4g} m/s", f"{least} asked for: {asked:.4g} m/s"]
    return found[: 1 + int(np.isfinite(asked))]


def plot_delta_v(record: ReconfigurationRecord) -> Figure:
    """Plot the Δv of every spacecraft, and its Lorenz curve."""
    fuel, bound = compute_step_fuel(record).sum(axis=0), compute_agent_bounds(record)
    figure = Figure(figsize=(8.2, 3.6), layout="constrained")
    bars, shares = figure.subplots(1, 2, width_ratios=(1.7, 1))
    order = np.argsort(-fuel, kind="stable")
    place, stays = np.arange(len(order)), record.frames.alive[-1, order]
    bars.bar(place[stays], fuel[order][stays], color=SKY, label="Δv")
    if not stays.all():
        bars.bar(place[~stays], fuel[order][~stays], color="#dddddd", label="Δv until lost")
    style = {"color": DARK_GRAY, "lw": 1.0, "label": "bound by the shared model"}
    bars.hlines(bound[order], place - 0.45, place + 0.45, **style)
    bars.set(xlim=(-1, len(order)), xlabel="spacecraft, by Δv", ylabel="Δv [m/s]", xticks=[])
    # Share of the total Δv over the share of the swarm that burns it, lowest Δv first.
    fuel = np.sort(fuel[record.frames.alive[-1]])
    share = 100 * np.append(0, np.cumsum(fuel) / (fuel.sum() or 1.0))
    swarm = np.linspace(0, 100, len(share))
    shares.plot([0, 100], [0, 100], color=RED, ls="--", lw=1, label="equal Δv")
    shares.plot(swarm, share, color=BLUE, lw=1.3, label="this swarm")
    if len(fuel):
        text = (
            f"mean {fuel.mean():.3g} m/s\nmin {fuel.min():.3g} m/s\nmax {fuel.max():.3g} m/s\n"
            f"standard deviation {fuel.std():.3g} m/s"
        )
        shares.text(0.04, 0.96, text, transform=shares.transAxes, va="top", fontsize=8)
    shares.set(xlim=(0, 100), ylim=(0, 100), box_aspect=1, ylabel="share of their Δv [%]")
    shares.set_xlabel("spacecraft alive at the end, lowest Δv first [%]")
    add_titles((bars, shares), ["Δv of each spacecraft", "Lorenz curve"], loc="left")
    add_legend(figure)
    return figure
