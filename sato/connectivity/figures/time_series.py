"""Connectivity [Bernard2023, Fig. 6], edges and distances over time."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure
from numpy import ndarray as Array

from sato.connectivity.check import ConnectivityRecord
from sato.connectivity.distance import nearest_agent_distance, obstacle_distances
from sato.connectivity.figures.time_panels import add_legend, stack_panels
from sato.figures.axes import draw_limit
from sato.figures.style import BLUE, DARK_GRAY, GRAY, GREEN, ORANGE, SKY

LOG_SCALE_BELOW = 0.1  # of λ₂^max: a smaller λ₂ needs a logarithmic scale
LINEAR_BELOW = 1e-3  # error of λ₂ below which the scale is linear


def plot_connectivity(record: ConnectivityRecord) -> Figure:
    """Plot λ₂ with its estimates and limits, and the errors of the estimates."""
    figure, (value, error) = stack_panels(record, (2.2, 1.0))
    time, limits = record.frames.time, record.mission.potential
    true = np.where(record.frames.alive.sum(axis=1) > 1, record.frames.lambda2, np.nan)
    third = np.where(np.isfinite(record.frames.lambda3), record.frames.lambda3, np.nan)
    estimate = np.where(record.frames.alive, record.frames.lambda2_estimate, np.nan)
    if np.isfinite(third).any():
        value.plot(time, third, color=GRAY, lw=0.6, label="λ$_3$, true")
    value.plot(time, true, color=BLUE, lw=2.2, label="λ$_2$, true")
    value.plot(time, estimate, color=ORANGE, lw=0.7)
    value.lines[-1].set_label("estimates of λ$_2$")
    highest = max(
        limits.lambda2_max, *(float(np.nanmax(v, initial=0)) for v in (true, third, estimate))
    )
    if np.nanmin(true) < LOG_SCALE_BELOW * limits.lambda2_max:
        value.set_yscale("symlog", linthresh=limits.lambda2_min or LINEAR_BELOW)
        highest *= 1.8
    value.set_ylim(0, 1.1 * highest)
    value.set_ylabel("eigenvalue")
    draw_limit(value, limits.lambda2_min, f"λ$_2^{{min}}$ = {limits.lambda2_min:g}")
    draw_limit(
        value,
        limits.lambda2_max,
        f"λ$_2^{{max}}$ = {limits.lambda2_max:g},\nno action beyond",
        color=DARK_GRAY,
    )
    _plot_spread(error, time, np.abs(estimate - true[:, None]))
    error.set_yscale("symlog", linthresh=LINEAR_BELOW)
    error.set(ylabel="error of the\nestimates", ylim=(0, None))
    add_legend(figure, record)
    return figure


def count_edges(record: ConnectivityRecord) -> Int[Array, "instants 3"]:
    """Count edges, edges of robots that see each other, and pairs of live robots."""
    edge = np.triu(record.frames.edge_weight > 0)
    mutual = edge & record.frames.visibility & record.frames.visibility.transpose(0, 2, 1)
    live = record.frames.alive.sum(axis=1)
    return np.stack([edge.sum((1, 2)), mutual.sum((1, 2)), live * (live - 1) // 2], axis=1)


def plot_edges(record: ConnectivityRecord) -> Figure:
    """Plot the number of edges, and of those whose ends see each other."""
    figure, [ax] = stack_panels(record, (2.0,))
    looks = ((BLUE, "-", "edges"), (GREEN, "-", "where both see each other"),
             (GRAY, "--", "pairs of robots"))  # fmt: skip
    numbers = count_edges(record)
    for number, (color, style, name) in zip(numbers.T, looks, strict=True):
        ax.step(record.frames.time, number, where="post", color=color, ls=style, lw=1.1, label=name)
    ax.set(ylabel="number", ylim=(0, 1.06 * float(numbers.max(initial=1))))
    ax.yaxis.get_major_locator().set_params(integer=True)
    add_legend(figure, record)
    return figure


def plot_distances(record: ConnectivityRecord) -> Figure:
    """Plot the distances of robots to each other and to obstacles."""
    there = np.where(record.frames.alive[..., None], record.frames.position, np.nan)
    obstacles, between = record.mission.obstacle_arrays, record.mission.repulsion
    found = {"another robot": nearest_agent_distance(there)}
    if obstacles.total:
        found["an obstacle"] = obstacle_distances(there, obstacles).min(axis=-1)
    figure, axes = stack_panels(record, (1.6,) * len(found))
    for ax, (name, away) in zip(axes, found.items(), strict=True):
        _plot_spread(ax, record.frames.time, away)
        least = np.fmin.reduce(away, axis=1)
        ax.plot(record.frames.time, least, color=BLUE, lw=1.1, label="the least")
        shown = np.clip(
            1.05 * np.nanmax(away), 1.2 * between.max_distance, 3 * between.max_distance
        )
        ax.set(ylabel=f"to {name} [m]", ylim=(0, shown))
        draw_limit(ax, between.min_distance, f"least,\n{between.min_distance:g} m")
        draw_limit(
            ax,
            between.max_distance,
            f"repulsion begins,\n{between.max_distance:g} m",
            color=DARK_GRAY,
        )
    add_legend(figure, record)
    return figure


def _plot_spread(ax: Any, time: Float[Array, " k"], each: Float[Array, "k agents"]) -> None:
    known = np.isfinite(each).any(axis=1)
    middle = np.full(len(each), np.nan)
    middle[known] = np.nanmedian(each[known], axis=1)
    low, high = np.fmin.reduce(each, axis=1), np.fmax.reduce(each, axis=1)
    ax.fill_between(time, low, high, color=SKY, alpha=0.45, lw=0, label="all robots")
    ax.plot(time, middle, color=DARK_GRAY, lw=0.7, label="their median")
