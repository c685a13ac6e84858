"""Connectivity, edges, distances and yaw errors over time [Bernard2023, Fig. 6 and 7]."""

from itertools import combinations

import numpy as np
from jaxtyping import Int
from matplotlib.figure import Figure
from numpy import ndarray as Array

from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.obstacles import obstacle_distances
from sato.figures import panels
from sato.figures.axes import add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GRAY, GREEN, ORANGE, RED
from sato.scene import nearest_distances

LOG_SCALE_BELOW = 0.1  # of λ₂^max: a smaller λ₂ needs a logarithmic scale
LINEAR_BELOW = 1e-3  # error of λ₂ below which the scale is linear
STICK_COLOR = "#d9f0e6"  # background while the stick is held
MAX_PAIRS = 6  # of yaw errors
# By visibility: 1 where i sees j, plus 2 where j sees i; 4 where one is lost.
VISIBILITY_COLORS = ("white", "#d3e6f5", "#fbe9b4", "#cfead9", "#dddddd")
VISIBILITY_LABELS = ("neither sees", "only i sees j", "only j sees i", "both see", "one is lost")
LOST = 4


def plot_connectivity(record: ConnectivityRecord) -> Figure:
    """Plot λ₂ with its estimates and limits, and the errors of the estimates."""
    frames, limits = record.frames, record.mission.potential
    figure, (value, error) = panels.stack(frames.time, 2.2, 1.0)
    true = np.where(frames.alive.sum(axis=1) > 1, frames.lambda2, np.nan)
    third = np.where(np.isfinite(frames.lambda3), frames.lambda3, np.nan)
    estimate = np.where(frames.alive, frames.lambda2_estimate, np.nan)
    if np.isfinite(third).any():
        value.plot(frames.time, third, color=GRAY, lw=0.6, label="λ$_3$, true")
    value.plot(frames.time, true, color=BLUE, lw=2.2, label="λ$_2$, true")
    value.plot(frames.time, estimate, color=ORANGE, lw=0.7, label="estimates of λ$_2$")
    shown = np.column_stack([true, third, estimate])
    highest = max(limits.lambda2_max, float(np.nanmax(shown, initial=0)))
    if np.nanmin(true) < LOG_SCALE_BELOW * limits.lambda2_max:
        value.set_yscale("symlog", linthresh=limits.lambda2_min or LINEAR_BELOW)
        highest *= 1.8
    value.set(ylabel="eigenvalue", ylim=(0, 1.1 * highest))
    panels.draw_limit(value, limits.lambda2_min, f"λ$_2^{{min}}$ = {limits.lambda2_min:g}")
    most = f"λ$_2^{{max}}$ = {limits.lambda2_max:g},\nno action beyond"
    panels.draw_limit(value, limits.lambda2_max, most, color=DARK_GRAY)
    panels.plot_spread(error, frames.time, np.abs(estimate - true[:, None]))
    error.set_yscale("symlog", linthresh=LINEAR_BELOW)
    error.set(ylabel="error of the\nestimates", ylim=(0, None))
    return _finish(figure, record)


def count_edges(record: ConnectivityRecord) -> Int[Array, "instants 3"]:
    """Count edges, edges of robots that see each other, and pairs of live robots."""
    edge = np.triu(record.frames.edge_weight > 0)
    mutual = edge & record.frames.visibility & record.frames.visibility.transpose(0, 2, 1)
    live = record.frames.alive.sum(axis=1)
    return np.stack([edge.sum((1, 2)), mutual.sum((1, 2)), live * (live - 1) // 2], axis=1)


def plot_edges(record: ConnectivityRecord) -> Figure:
    """Plot the number of edges, and of those whose ends see each other."""
    time, numbers = record.frames.time, count_edges(record)
    edges, mutual, pairs = numbers.T
    figure, [ax] = panels.stack(time, 2.0)
    ax.step(time, edges, where="post", color=BLUE, label="edges")
    ax.step(time, mutual, where="post", color=GREEN, label="where both see each other")
    ax.step(time, pairs, where="post", color=GRAY, ls="--", label="pairs of robots")
    ax.set(ylabel="number", ylim=(0, 1.06 * float(numbers.max(initial=1))))
    ax.locator_params(axis="y", integer=True)
    return _finish(figure, record)


def plot_distances(record: ConnectivityRecord) -> Figure:
    """Plot the distances of robots to each other and to obstacles."""
    alive, position = record.frames.alive, record.frames.position
    there = np.where(alive[..., None], position, np.nan)
    obstacles, between = record.mission.obstacle_arrays, record.mission.repulsion
    found = {"another robot": nearest_distances(position, alive)}
    if obstacles.total:
        found["an obstacle"] = obstacle_distances(there, obstacles).min(axis=-1)
    figure, axes = panels.stack(record.frames.time, *[1.6] * len(found))
    low, high = between.min_distance, between.max_distance
    for ax, (name, away) in zip(axes, found.items(), strict=True):
        panels.plot_spread(ax, record.frames.time, away)
        least = np.fmin.reduce(away, axis=1)
        ax.plot(record.frames.time, least, color=DARK_GRAY, lw=1.1, label="the least")
        most = np.clip(1.05 * np.nanmax(away), 1.2 * high, 3 * high)
        ax.set(ylabel=f"to {name} [m]", ylim=(0, most))
        panels.draw_limit(ax, low, f"least,\n{low:g} m")
        panels.draw_limit(ax, high, f"repulsion begins,\n{high:g} m", color=DARK_GRAY)
    return _finish(figure, record)


def plot_following(record: ConnectivityRecord) -> Figure:
    """Plot the paths of the leader and of the followers' centroid, and commanded speeds."""
    frames = record.frames
    figure, (path, speed) = panels.stack(frames.time, 1.6, 1.6)
    labels = ("leader", ORANGE), ("centroid of the followers", BLUE)
    for (name, color), steps in zip(labels, record.paths, strict=True):
        path.plot(frames.time, np.append(0, np.cumsum(steps)), color=color, label=name)
    path.set(ylabel="path [m]", ylim=(0, None))
    command = np.linalg.norm(frames.velocity_command[:, 1:], axis=2)
    panels.plot_spread(speed, frames.time, np.where(frames.alive[:, 1:], command, np.nan))
    stick = np.linalg.norm(frames.stick, axis=1)
    speed.plot(frames.time, stick, color=ORANGE, lw=1.0, label="stick, to the leader")
    speed.set(ylabel="speed commanded to\nfollowers [m/s]", ylim=(0, None))
    return _finish(figure, record)


def _finish(figure: Figure, record: ConnectivityRecord) -> Figure:
    """Shade while the stick is held, mark losses and splits, and add a legend."""
    frames = record.frames
    for span in panels.find_intervals(frames.time, frames.stick.any(axis=1)):
        if span.value:
            panels.shade(figure.axes, span, STICK_COLOR, "stick held")
    for span in panels.find_intervals(frames.time, (frames.component > 0).any(axis=1)):
        if span.value:
            panels.shade(figure.axes, span, RED, "disconnected", ymin=0.97)
    losses = [event["time"] for _, event in record.events.of_kind("loss")]
    panels.mark_instants(figure.axes, losses, "loss of a robot")
    add_legend(figure)
    return figure


def classify_visibility(record: ConnectivityRecord, i: int, j: int) -> Int[Array, " instants"]:
    """Classify how two robots see each other, as an index of `VISIBILITY_LABELS`."""
    sees = record.frames.visibility
    both = record.frames.alive[:, [i, j]].all(axis=1)
    return np.where(both, sees[:, i, j] + 2 * sees[:, j, i], LOST)


def select_pairs(record: ConnectivityRecord) -> list[tuple[int, int]]:
    """Select the pairs with most kinds of visibility, then with most changes."""

    def variety(pair: tuple[int, int]) -> tuple[int, int]:
        phase = classify_visibility(record, *pair)
        return len(set(phase.tolist()) - {LOST}), int((phase[1:] != phase[:-1]).sum())

    pairs = list(combinations(range(record.mission.agents), 2))
    return sorted(sorted(pairs, key=variety, reverse=True)[:MAX_PAIRS])


def plot_yaw_error(record: ConnectivityRecord) -> Figure:
    """Plot |sin(Δψ/2)| of some pairs over time, on a background of their visibility."""
    time, pairs = record.frames.time, select_pairs(record)
    figure, axes = panels.stack(time, *[0.9] * len(pairs))
    for ax, (i, j) in zip(axes, pairs, strict=True):
        phase = classify_visibility(record, i, j)
        for a, b, name, color, width in ((i, j, "i", BLUE, 2.0), (j, i, "j", ORANGE, 0.8)):
            off = np.abs(np.sin(record.frames.yaw_estimate_error[:, a, b] / 2))
            off = np.where(phase == LOST, np.nan, off)
            ax.plot(time, off, color=color, lw=width, label=f"error of {name}")
        for span in panels.find_intervals(time, phase):
            panels.shade([ax], span, VISIBILITY_COLORS[span.value], VISIBILITY_LABELS[span.value])
    add_titles(axes, [f"i = {i}, j = {j}" for i, j in pairs], loc="left")
    figure.supylabel("|sin(Δψ/2)|", fontsize=8.5)
    add_legend(figure)
    return figure
