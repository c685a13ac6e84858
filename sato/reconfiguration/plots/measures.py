"""Numbers over time and over agents: least separation, and fuel against the least there is."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from numpy import ndarray as Array

from dynamics.path import sampled_separations
from sato.plots.look import BLUE, DARK, GREY, RED, SKY
from sato.plots.view import letter, shade_legs
from sato.reconfiguration.check.evidence import Evidence
from sato.reconfiguration.check.fuel import bound_of_each, burnt, least
from sato.reconfiguration.plots.perspective import view_of
from sato.reconfiguration.plots.stages import leg_names


class Spent(NamedTuple):
    """Fuel of every agent, beside the least for the targets that it took."""

    fuel: Float[Array, " agents"]  # [m/s]
    least: Float[Array, " agents"]  # alone, in the same time; NaN where unknown [m/s]
    stays: Bool[Array, " agents"]  # who is there to the end
    total_least: float | None  # of the swarm, were it assigned at best [m/s]


@lru_cache(maxsize=1)
def spent(evidence: Evidence) -> Spent:
    """What every agent burnt, and what it could have."""
    bounds = [least(evidence, s) for s in evidence.stretches]
    known = [b.total for b in bounds if b is not None]
    return Spent(
        burnt(evidence).sum(axis=0),
        bound_of_each(evidence, bounds),
        evidence.alive[-1],
        sum(known) if len(known) == len(evidence.mission.legs) else None,
    )


def separation(evidence: Evidence) -> Figure:
    """Least distance between any two agents, along the continuous path."""
    figure = Figure(figsize=(6.8, 3.2), layout="constrained")
    ax = figure.add_subplot()
    found, _ = evidence.pieces
    s = evidence.refinement
    # One value a control step: the least of its pieces.
    between = found.distance.reshape(-1, s).min(axis=1)
    view = view_of(evidence)
    t, radius = evidence.time * view.second, evidence.mission.collision_radius
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
    ax.plot(t[shown], samples[shown], color=GREY, lw=0.7, label="at the control instants")
    ax.axhline(radius, color=RED, ls="--", lw=1, label=f"collision radius, {radius:g} m")
    if np.isfinite(between).any():
        k = int(np.nanargmin(np.where(np.isfinite(between), between, np.nan)))
        ax.plot((t[k] + t[k + 1]) / 2, between[k], "v", ms=5, color=DARK, mew=0, zorder=5,
                label=f"least: {between[k]:.6g} m")  # fmt: skip
    for k, event in evidence.happened.told("loss"):
        ax.axvline(t[k], color=GREY, ls=":", lw=0.8)
        ax.annotate(
            f"{len(event['agents'])} lost",
            (t[k], 0.03),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            color=DARK,
            fontsize=7.5,
        )
    ax.set(
        xlabel=f"time [{view.time}]", ylabel="least separation [m]", xlim=(t[0], max(t[-1], 1e-9))
    )
    ax.set_ylim(0, None)
    names = leg_names(evidence)
    shade_legs(ax, [(t[g.first], t[g.last], names[g.leg]) for g in evidence.stretches])
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def fuel(evidence: Evidence) -> Figure:
    """Fuel of every agent against the least for the targets that it took."""
    figure = Figure(figsize=(4.6, 4.4), layout="constrained")
    ax = figure.add_subplot()
    found = spent(evidence)
    known = np.isfinite(found.least)
    stays, gone = known & found.stays, known & ~found.stays
    top = 1.05 * float(max(found.fuel.max(initial=0.0), found.least[known].max(initial=0.0)))
    top = top or 1.0
    ax.plot([0, top], [0, top], color=RED, ls="--", lw=1, label="lower bound")
    ax.plot(found.least[stays], found.fuel[stays], "o", ms=4, mew=0, alpha=0.75, color=BLUE,
            label="there to the end")  # fmt: skip
    if gone.any():
        ax.plot(found.least[gone], found.fuel[gone], "s", ms=3.5, mfc="none", mec=GREY,
                label="lost")  # fmt: skip
    said = f"the swarm: {float(found.fuel.sum()):.4g} m/s"
    if found.total_least is not None:
        said += f"\nits lower bound: {found.total_least:.4g} m/s"
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


def delta_v(evidence: Evidence) -> Figure:
    """Δv of every spacecraft, and how evenly the swarm shares it."""
    figure = Figure(figsize=(8.2, 3.6), layout="constrained")
    bars, shares = figure.subplots(1, 2, width_ratios=(1.7, 1))
    found = spent(evidence)
    order = np.argsort(-found.fuel, kind="stable")
    _bars(bars, found, order)
    _shares(shares, np.sort(found.fuel[found.stays]))
    for i, (ax, title) in enumerate(
        ((bars, "Δv of each spacecraft"), (shares, "how evenly it is shared"))
    ):
        ax.set_title(f"{letter(i)} {title}", loc="left")
    handles, labels = bars.get_legend_handles_labels()
    more, said = shares.get_legend_handles_labels()
    figure.legend(handles + more, labels + said, loc="outside lower center", ncols=6)
    return figure


def _bars(ax: Any, found: Spent, order: Array) -> None:
    place, fuel = np.arange(len(order)), found.fuel[order]
    stays = found.stays[order]
    ax.bar(place[stays], fuel[stays], width=0.8, color=SKY, label="burnt")
    if not stays.all():
        ax.bar(place[~stays], fuel[~stays], width=0.8, color="#dddddd", label="burnt, then lost")
    if np.isfinite(found.least).any():
        ax.hlines(found.least[order], place - 0.45, place + 0.45, color=DARK, lw=1.0,
                  label="least for the target it took")  # fmt: skip
    ax.set(xlim=(-1, len(order)), xlabel="spacecraft, by what it burnt", ylabel="Δv [m/s]")
    ax.tick_params(labelbottom=False, bottom=False)


def _shares(ax: Any, fuel: Float[Array, " stay"]) -> None:
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
