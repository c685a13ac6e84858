"""Least separation over time, and fuel of the agents against their lower bounds."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from numpy import ndarray as Array

from dynamics.trajectory_geometry import sampled_separations
from sato.figures.axes import panel_letter, shade_legs
from sato.figures.style import BLUE, DARK_GRAY, GRAY, RED, SKY
from sato.reconfiguration.check.fuel import (
    compute_agent_bounds,
    compute_fuel_bound,
    compute_step_fuel,
)
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.snapshots import read_leg_names, select_view


class FuelUse(NamedTuple):
    """Fuel of every agent, and its lower bound to the targets that it reached."""

    fuel: Float[Array, " agents"]  # [m/s]
    lower_bound: Float[
        Array, " agents"
    ]  # without the others, in the same time; NaN where unknown [m/s]
    is_survivor: Bool[Array, " agents"]  # alive at the end
    total_lower_bound: float | None  # with the optimal assignment [m/s]


@lru_cache(maxsize=1)
def compute_fuel_use(record: ReconfigurationRecord) -> FuelUse:
    """Compute the fuel of every agent and its lower bound."""
    bounds = [compute_fuel_bound(record, s) for s in record.leg_records]
    known = [b.total for b in bounds if b is not None]
    return FuelUse(
        compute_step_fuel(record).sum(axis=0),
        compute_agent_bounds(record, bounds),
        record.alive[-1],
        sum(known) if len(known) == len(record.mission.legs) else None,
    )


def plot_separation(record: ReconfigurationRecord) -> Figure:
    """Plot the least separation of any two agents along their continuous trajectories."""
    figure = Figure(figsize=(6.8, 3.2), layout="constrained")
    ax = figure.add_subplot()
    found, _ = record.separations
    s = record.pieces_per_step
    # One value a control step: the least of its pieces.
    between = found.distance.reshape(-1, s).min(axis=1)
    view = select_view(record)
    t, radius = record.time * view.time_scale, record.mission.collision_radius
    samples = sampled_separations(record.position, record.alive)
    shown = np.isfinite(samples)
    between = np.where(np.isfinite(between), between, np.nan)
    ax.stairs(between, t, baseline=None, color=BLUE, lw=1.1, label="least within each step")
    ax.plot(t[shown], samples[shown], color=GRAY, lw=0.7, label="at control instants")
    ax.axhline(radius, color=RED, ls="--", lw=1, label=f"collision radius, {radius:g} m")
    if np.isfinite(between).any():
        k = int(np.nanargmin(between))
        ax.plot((t[k] + t[k + 1]) / 2, between[k], "v", ms=5, color=DARK_GRAY, mew=0, zorder=5,
                label=f"least: {between[k]:.6g} m")  # fmt: skip
    for k, event in record.events.of_kind("loss"):
        ax.axvline(t[k], color=GRAY, ls=":", lw=0.8)
        ax.annotate(
            f"{len(event['agents'])} lost",
            (t[k], 0.03),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            color=DARK_GRAY,
            fontsize=7.5,
        )
    ax.set(xlabel=f"time [{view.time_unit}]", ylabel="least separation [m]")
    ax.set_xlim(t[0], max(t[-1], 1e-9))
    ax.set_ylim(0, None)
    names = read_leg_names(record)
    legs = record.leg_records
    shade_legs(ax, [(t[g.start_index], t[g.end_index], names[g.leg_index]) for g in legs])
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def plot_fuel(record: ReconfigurationRecord) -> Figure:
    """Plot the fuel of every agent against its lower bound."""
    figure = Figure(figsize=(4.6, 4.4), layout="constrained")
    ax = figure.add_subplot()
    use = compute_fuel_use(record)
    known = np.isfinite(use.lower_bound)
    stays, gone = known & use.is_survivor, known & ~use.is_survivor
    top = 1.05 * float(max(use.fuel.max(initial=0.0), use.lower_bound[known].max(initial=0.0)))
    top = top or 1.0
    ax.plot([0, top], [0, top], color=RED, ls="--", lw=1, label="lower bound")
    ax.plot(use.lower_bound[stays], use.fuel[stays], "o", ms=4, mew=0, alpha=0.75, color=BLUE,
            label="alive at the end")  # fmt: skip
    if gone.any():
        ax.plot(use.lower_bound[gone], use.fuel[gone], "s", ms=3.5, mfc="none", mec=GRAY,
                label="lost")  # fmt: skip
    text = f"swarm: {float(use.fuel.sum()):.4g} m/s"
    if use.total_lower_bound is not None:
        text += f"\nlower bound: {use.total_lower_bound:.4g} m/s"
    ax.set_title(text, loc="left", fontsize=8.5)
    ax.set(
        xlim=(0, top),
        ylim=(0, top),
        aspect="equal",
        ylabel="fuel of each agent [m/s]",
        xlabel="lower bound: least fuel without other agents [m/s]",
    )
    ax.legend(loc="lower right")
    return figure


def plot_delta_v(record: ReconfigurationRecord) -> Figure:
    """Plot the Δv of every spacecraft, and its Lorenz curve."""
    figure = Figure(figsize=(8.2, 3.6), layout="constrained")
    bars, shares = figure.subplots(1, 2, width_ratios=(1.7, 1))
    use = compute_fuel_use(record)
    order = np.argsort(-use.fuel, kind="stable")
    _plot_bars(bars, use, order)
    _plot_lorenz_curve(shares, np.sort(use.fuel[use.is_survivor]))
    bars.set_title(f"{panel_letter(0)} Δv of each spacecraft", loc="left")
    shares.set_title(f"{panel_letter(1)} Lorenz curve", loc="left")
    handles, labels = bars.get_legend_handles_labels()
    more, names = shares.get_legend_handles_labels()
    figure.legend(handles + more, labels + names, loc="outside lower center", ncols=6)
    return figure


def _plot_bars(ax: Any, use: FuelUse, order: Array) -> None:
    place, fuel = np.arange(len(order)), use.fuel[order]
    stays = use.is_survivor[order]
    ax.bar(place[stays], fuel[stays], width=0.8, color=SKY, label="Δv")
    if not stays.all():
        ax.bar(place[~stays], fuel[~stays], width=0.8, color="#dddddd", label="Δv until lost")
    if np.isfinite(use.lower_bound).any():
        ax.hlines(use.lower_bound[order], place - 0.45, place + 0.45, color=DARK_GRAY, lw=1.0,
                  label="lower bound")  # fmt: skip
    ax.set(xlim=(-1, len(order)), xlabel="spacecraft, by Δv", ylabel="Δv [m/s]")
    ax.tick_params(labelbottom=False, bottom=False)


def _plot_lorenz_curve(ax: Any, fuel: Float[Array, " stay"]) -> None:
    # Share of the total Δv over the share of the swarm that burns it, lowest Δv first.
    share = np.concatenate([[0.0], np.cumsum(fuel) / (fuel.sum() or 1.0)])
    swarm = np.linspace(0, 1, len(share))
    ax.plot([0, 100], [0, 100], color=RED, ls="--", lw=1, label="equal Δv")
    ax.fill_between(100 * swarm, 100 * share, 100 * swarm, color=BLUE, alpha=0.1, lw=0)
    ax.plot(100 * swarm, 100 * share, color=BLUE, lw=1.3, label="this swarm")
    if len(fuel):
        words = {"mean": fuel.mean(), "min": fuel.min(), "max": fuel.max()}
        words["standard deviation"] = fuel.std()
        text = "\n".join(f"{name} {value:.3g} m/s" for name, value in words.items())
        ax.text(0.04, 0.96, text, transform=ax.transAxes, va="top", fontsize=8)
    ax.set(
        xlim=(0, 100),
        ylim=(0, 100),
        anchor="N",
        box_aspect=1,
        xlabel="spacecraft alive at the end, lowest Δv first [%]",
        ylabel="share of their Δv [%]",
    )
