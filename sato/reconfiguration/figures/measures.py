"""Numbers over time and over agents: least separation, and fuel against the least there is."""

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
from sato.reconfiguration.figures.perspective import select_view
from sato.reconfiguration.figures.snapshots import read_leg_names


class FuelUse(NamedTuple):
    """Fuel of every agent, beside the least for the targets that it took."""

    fuel: Float[Array, " agents"]  # [m/s]
    lower_bound: Float[Array, " agents"]  # alone, in the same time; NaN where unknown [m/s]
    is_survivor: Bool[Array, " agents"]  # who is there to the end
    total_lower_bound: float | None  # of the swarm, were it assigned at best [m/s]


@lru_cache(maxsize=1)
def compute_fuel_use(evidence: ReconfigurationRecord) -> FuelUse:
    """What every agent burnt, and what it could have."""
    bounds = [compute_fuel_bound(evidence, s) for s in evidence.leg_records]
    known = [b.total for b in bounds if b is not None]
    return FuelUse(
        compute_step_fuel(evidence).sum(axis=0),
        compute_agent_bounds(evidence, bounds),
        evidence.alive[-1],
        sum(known) if len(known) == len(evidence.mission.legs) else None,
    )


def plot_separation(evidence: ReconfigurationRecord) -> Figure:
    """Least distance between any two agents, along the continuous path."""
    figure = Figure(figsize=(6.8, 3.2), layout="constrained")
    ax = figure.add_subplot()
    found, _ = evidence.separations
    s = evidence.pieces_per_step
    # One value a control step: the least of its pieces.
    between = found.distance.reshape(-1, s).min(axis=1)
    view = select_view(evidence)
    t, radius = evidence.time * view.time_scale, evidence.mission.collision_radius
    samples = sampled_separations(evidence.position, evidence.alive)
    shown = np.isfinite(samples)
    ax.stairs(
        np.where(np.isfinite(between), between, np.nan),
        t,
        baseline=None,
        color=BLUE,
        lw=1.1,
        label="least over each step, between samples too",
    )
    ax.plot(t[shown], samples[shown], color=GRAY, lw=0.7, label="at the control instants")
    ax.axhline(radius, color=RED, ls="--", lw=1, label=f"collision radius, {radius:g} m")
    if np.isfinite(between).any():
        k = int(np.nanargmin(np.where(np.isfinite(between), between, np.nan)))
        ax.plot((t[k] + t[k + 1]) / 2, between[k], "v", ms=5, color=DARK_GRAY, mew=0, zorder=5,
                label=f"least: {between[k]:.6g} m")  # fmt: skip
    for k, event in evidence.events.of_kind("loss"):
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
    ax.set(
        xlabel=f"time [{view.time_unit}]",
        ylabel="least separation [m]",
        xlim=(t[0], max(t[-1], 1e-9)),
    )
    ax.set_ylim(0, None)
    names = read_leg_names(evidence)
    shade_legs(
        ax, [(t[g.start_index], t[g.end_index], names[g.leg_index]) for g in evidence.leg_records]
    )
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def plot_fuel(evidence: ReconfigurationRecord) -> Figure:
    """Fuel of every agent against the least for the targets that it took."""
    figure = Figure(figsize=(4.6, 4.4), layout="constrained")
    ax = figure.add_subplot()
    found = compute_fuel_use(evidence)
    known = np.isfinite(found.lower_bound)
    stays, gone = known & found.is_survivor, known & ~found.is_survivor
    top = 1.05 * float(max(found.fuel.max(initial=0.0), found.lower_bound[known].max(initial=0.0)))
    top = top or 1.0
    ax.plot([0, top], [0, top], color=RED, ls="--", lw=1, label="lower bound")
    ax.plot(found.lower_bound[stays], found.fuel[stays], "o", ms=4, mew=0, alpha=0.75, color=BLUE,
            label="there to the end")  # fmt: skip
    if gone.any():
        ax.plot(found.lower_bound[gone], found.fuel[gone], "s", ms=3.5, mfc="none", mec=GRAY,
                label="lost")  # fmt: skip
    said = f"the swarm: {float(found.fuel.sum()):.4g} m/s"
    if found.total_lower_bound is not None:
        said += f"\nits lower bound: {found.total_lower_bound:.4g} m/s"
    ax.set_title(said, loc="left", fontsize=8.5)
    ax.set(
        xlim=(0, top),
        ylim=(0, top),
        aspect="equal",
        ylabel="fuel burnt by each agent [m/s]",
        xlabel="least fuel to the targets it took, alone, in the same time [m/s]",
    )
    ax.legend(loc="lower right")
    return figure


def plot_delta_v(evidence: ReconfigurationRecord) -> Figure:
    """Δv of every spacecraft, and how evenly the swarm shares it."""
    figure = Figure(figsize=(8.2, 3.6), layout="constrained")
    bars, shares = figure.subplots(1, 2, width_ratios=(1.7, 1))
    found = compute_fuel_use(evidence)
    order = np.argsort(-found.fuel, kind="stable")
    _plot_bars(bars, found, order)
    _plot_lorenz_curve(shares, np.sort(found.fuel[found.is_survivor]))
    for i, (ax, title) in enumerate(
        ((bars, "Δv of each spacecraft"), (shares, "how evenly it is shared"))
    ):
        ax.set_title(f"{panel_letter(i)} {title}", loc="left")
    handles, labels = bars.get_legend_handles_labels()
    more, said = shares.get_legend_handles_labels()
    figure.legend(handles + more, labels + said, loc="outside lower center", ncols=6)
    return figure


def _plot_bars(ax: Any, found: FuelUse, order: Array) -> None:
    place, fuel = np.arange(len(order)), found.fuel[order]
    stays = found.is_survivor[order]
    ax.bar(place[stays], fuel[stays], width=0.8, color=SKY, label="burnt")
    if not stays.all():
        ax.bar(place[~stays], fuel[~stays], width=0.8, color="#dddddd", label="burnt, then lost")
    if np.isfinite(found.lower_bound).any():
        ax.hlines(found.lower_bound[order], place - 0.45, place + 0.45, color=DARK_GRAY, lw=1.0,
                  label="least for the target it took")  # fmt: skip
    ax.set(xlim=(-1, len(order)), xlabel="spacecraft, by what it burnt", ylabel="Δv [m/s]")
    ax.tick_params(labelbottom=False, bottom=False)


def _plot_lorenz_curve(ax: Any, fuel: Float[Array, " stay"]) -> None:
    # Lorenz's curve: what share of the fuel the most frugal share of the swarm burns.
    share = np.concatenate([[0.0], np.cumsum(fuel) / (fuel.sum() or 1.0)])
    swarm = np.linspace(0, 1, len(share))
    ax.plot([0, 100], [0, 100], color=RED, ls="--", lw=1, label="all burn alike")
    ax.fill_between(100 * swarm, 100 * share, 100 * swarm, color=BLUE, alpha=0.1, lw=0)
    ax.plot(100 * swarm, 100 * share, color=BLUE, lw=1.3, label="this swarm")
    if len(fuel):
        words = {"mean": fuel.mean(), "min": fuel.min(), "max": fuel.max()}
        words["standard deviation"] = fuel.std()
        said = "\n".join(f"{name} {value:.3g} m/s" for name, value in words.items())
        ax.text(0.04, 0.96, said, transform=ax.transAxes, va="top", fontsize=8)
    ax.set(
        xlim=(0, 100),
        ylim=(0, 100),
        anchor="N",
        box_aspect=1,
        xlabel="of those there to the end, most frugal first [%]",
        ylabel="of their Δv [%]",
    )
