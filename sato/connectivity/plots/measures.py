"""Numbers over time: connectivity [Bernard2023, Fig. 6], edges, distances."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from numpy import ndarray as Array

from sato.connectivity.check import Evidence
from sato.connectivity.distance import to_obstacles
from sato.connectivity.plots.times import finish, stacked
from sato.plots.look import BLUE, DARK, GREEN, GREY, ORANGE, SKY
from sato.plots.view import limit

FAR_BELOW = 0.1  # of λ₂^max: a λ₂ below it is seen on a logarithmic scale only
SMALL = 1e-3  # error of λ₂, down from which the scale is linear


def connectivity(evidence: Evidence) -> Figure:
    """λ₂ as it is and as every robot has it, between its limits, and how far these are off."""
    figure, (value, error) = stacked(evidence, (2.2, 1.0))
    time, limits = evidence.time, evidence.mission.potential
    true = np.where(evidence.alive.sum(axis=1) > 1, evidence.lambda2, np.nan)
    third = np.where(np.isfinite(evidence.lambda3), evidence.lambda3, np.nan)
    estimate = np.where(evidence.alive, evidence.estimate, np.nan)
    if np.isfinite(third).any():
        value.plot(time, third, color=GREY, lw=0.6, label="λ$_3$, true")
    value.plot(time, true, color=BLUE, lw=2.2, label="λ$_2$, true")
    value.plot(time, estimate, color=ORANGE, lw=0.7)
    value.lines[-1].set_label("λ$_2$ as robots have it")
    highest = max(limits.most, *(float(np.nanmax(v, initial=0)) for v in (true, third, estimate)))
    if np.nanmin(true) < FAR_BELOW * limits.most:
        value.set_yscale("symlog", linthresh=limits.least or SMALL)
        highest *= 1.8
    value.set_ylim(0, 1.1 * highest)
    value.set_ylabel("eigenvalue")
    limit(value, limits.least, f"λ$_2^{{min}}$ = {limits.least:g}")
    limit(value, limits.most, f"λ$_2^{{max}}$ = {limits.most:g},\nno pull beyond", colour=DARK)
    _crowd(error, time, np.abs(estimate - true[:, None]))
    error.set_yscale("symlog", linthresh=SMALL)
    error.set(ylabel="error of what\nrobots have", ylim=(0, None))
    finish(figure, evidence)
    return figure


def counted(evidence: Evidence) -> Int[Array, "instants 3"]:
    """At every instant: edges, those of robots that see each other, and pairs of live robots."""
    edge = np.triu(evidence.weight > 0)
    mutual = edge & evidence.sees & evidence.sees.transpose(0, 2, 1)
    live = evidence.alive.sum(axis=1)
    return np.stack([edge.sum((1, 2)), mutual.sum((1, 2)), live * (live - 1) // 2], axis=1)


def edges(evidence: Evidence) -> Figure:
    """How many edges the graph has, and of how many both ends see each other."""
    figure, [ax] = stacked(evidence, (2.0,))
    looks = ((BLUE, "-", "edges"), (GREEN, "-", "where both see each other"),
             (GREY, "--", "pairs of robots"))  # fmt: skip
    numbers = counted(evidence)
    for number, (colour, style, name) in zip(numbers.T, looks, strict=True):
        ax.step(evidence.time, number, where="post", color=colour, ls=style, lw=1.1, label=name)
    ax.set(ylabel="number", ylim=(0, 1.06 * float(numbers.max(initial=1))))
    ax.yaxis.get_major_locator().set_params(integer=True)
    finish(figure, evidence)
    return figure


def distances(evidence: Evidence) -> Figure:
    """How near every robot is to another one, and to an obstacle."""
    there = np.where(evidence.alive[..., None], evidence.position, np.nan)
    obstacles, between = evidence.mission.obstacles, evidence.mission.repulsion
    found = {"another robot": nearest_robot(there)}
    if obstacles.total:
        found["an obstacle"] = to_obstacles(there, obstacles).min(axis=-1)
    figure, axes = stacked(evidence, (1.6,) * len(found))
    for ax, (name, away) in zip(axes, found.items(), strict=True):
        _crowd(ax, evidence.time, away)
        least = np.fmin.reduce(away, axis=1)
        ax.plot(evidence.time, least, color=BLUE, lw=1.1, label="the least")
        shown = np.clip(1.05 * np.nanmax(away), 1.2 * between.farthest, 3 * between.farthest)
        ax.set(ylabel=f"to {name} [m]", ylim=(0, shown))
        limit(ax, between.nearest, f"least,\n{between.nearest:g} m")
        limit(ax, between.farthest, f"push begins,\n{between.farthest:g} m", colour=DARK)
    finish(figure, evidence)
    return figure


def nearest_robot(there: Float[Array, "instants agents 3"]) -> Float[Array, "instants agents"]:
    """Distance of every robot to the nearest other one; NaN for who is not there [m]."""
    found = np.full(there.shape[:2], np.inf)
    for j in range(there.shape[1]):
        away = np.linalg.norm(there - there[:, j : j + 1], axis=2)
        away[:, j] = np.inf
        found = np.fmin(found, away)
    return np.where(np.isfinite(there[..., 0]) & np.isfinite(found), found, np.nan)


def _crowd(ax: Any, time: Float[Array, " k"], each: Float[Array, "k agents"]) -> None:
    known = np.isfinite(each).any(axis=1)
    middle = np.full(len(each), np.nan)
    middle[known] = np.nanmedian(each[known], axis=1)
    low, high = np.fmin.reduce(each, axis=1), np.fmax.reduce(each, axis=1)
    ax.fill_between(time, low, high, color=SKY, alpha=0.45, lw=0, label="all robots")
    ax.plot(time, middle, color=DARK, lw=0.7, label="their median")
