"""Numbers over time and over agents: least separation, and fuel against its lower bound."""

import numpy as np
from matplotlib.figure import Figure

from dynamics.path import sampled_separations
from sato.check import bound_of_each
from sato.check.evidence import Evidence
from sato.check.fuel import burnt, least
from sato.plots.look import BLUE, DARK, GREY, RED, shade_legs
from sato.plots.swarm import leg_names


def separation(evidence: Evidence) -> Figure:
    """Least distance between any two agents, along the continuous path."""
    figure = Figure(figsize=(6.8, 3.2), layout="constrained")
    ax = figure.add_subplot()
    found, _ = evidence.pieces
    s = evidence.refinement
    # One value a control step: the least of its pieces.
    between = found.distance.reshape(-1, s).min(axis=1)
    t, radius = evidence.time, evidence.mission.collision_radius
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
                label=f"least: {between[k]:.4g} m")  # fmt: skip
    for k, event in evidence.told("loss"):
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
    ax.set(xlabel="time [s]", ylabel="least separation [m]", xlim=(t[0], max(t[-1], 1e-9)))
    ax.set_ylim(0, None)
    names = leg_names(evidence)
    shade_legs(ax, [(t[g.first], t[g.last], names[g.leg]) for g in evidence.stretches])
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def fuel(evidence: Evidence) -> Figure:
    """Fuel of every agent against the least for the targets that it took."""
    figure = Figure(figsize=(4.6, 4.4), layout="constrained")
    ax = figure.add_subplot()
    spent = burnt(evidence).sum(axis=0)
    bounds = [least(evidence, s) for s in evidence.stretches]
    bound = bound_of_each(evidence, bounds)
    known = np.isfinite(bound)
    stays = known & evidence.alive[-1]
    top = 1.05 * float(max(spent.max(initial=0.0), np.max(bound, initial=0.0, where=known)))
    top = top or 1.0
    ax.plot([0, top], [0, top], color=RED, ls="--", lw=1, label="lower bound")
    ax.plot(bound[stays], spent[stays], "o", ms=4, mew=0, alpha=0.75, color=BLUE,
            label="there to the end")  # fmt: skip
    gone = known & ~stays
    if gone.any():
        ax.plot(bound[gone], spent[gone], "s", ms=3.5, mfc="none", mec=GREY, label="lost")
    total, all_bounds = float(spent.sum()), [b.total for b in bounds if b is not None]
    said = f"the swarm: {total:.4g} m/s"
    if len(all_bounds) == len(evidence.mission.legs):
        said += f"\nits lower bound: {sum(all_bounds):.4g} m/s"
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
