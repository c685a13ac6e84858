"""Coordinate frames of the agents, and the drift of their odometry [Lusk2020, Fig. 2]."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sato.figures.axes import panel_letter
from sato.figures.style import BLUE, DARK_GRAY, GRAY, ORANGE, SKY
from sato.formation.check import FormationRecord

AXIS_LENGTH = 0.3  # of a drawn axis, relative to the mean spacing


def plot_coordinate_frames(record: FormationRecord) -> Figure:
    """Plot the pose of each agent's frame, and its odometry drift over time."""
    figure = Figure(figsize=(8.6, 3.9), layout="constrained")
    poses, drift = figure.subplots(1, 2, width_ratios=(1, 1.35))
    _plot_poses(poses, record)
    _plot_drift(drift, record)
    noise = record.mission.frames.noise
    drift.set_title(
        f"{panel_letter(1)} odometry drift; noise {100 * noise:g} cm on top", loc="left"
    )
    poses.set_title(f"{panel_letter(0)} frames and starts", loc="left")
    key = [
        Line2D([], [], color=BLUE, lw=1.4, label="x of a frame"),
        Line2D([], [], color=ORANGE, lw=1.4, label="y of a frame"),
        Line2D([], [], ls="", marker="o", ms=4, color=GRAY, label="vehicle at the start"),
        Line2D([], [], color=SKY, lw=1, label="a vehicle"),
        Line2D([], [], color=BLUE, lw=1.8, label="median"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=5)
    return figure


def _plot_poses(ax: Any, record: FormationRecord) -> None:
    frames, start = record.mission.coordinate_frames, record.mission.initial_positions[:, :2]
    origin = frames.origin[:, :2]
    every = np.concatenate([origin, start])
    length = AXIS_LENGTH * max(float(np.ptp(every, axis=0).max()), 1.0) / len(start) ** 0.5
    ax.plot(*start.T, "o", ms=3, color=GRAY, mew=0, alpha=0.6, zorder=1)
    for turn, color in ((1, BLUE), (1j, ORANGE)):
        way = length * turn * frames.rotation
        tips = origin + np.stack([way.real, way.imag], axis=1)
        ax.plot(*np.stack([origin, tips], axis=2).transpose(1, 2, 0), color=color, lw=1.2)
    ax.plot(*origin.T, ".", ms=2.5, color=DARK_GRAY, zorder=3)
    ax.margins(0.06)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]")


def _plot_drift(ax: Any, record: FormationRecord) -> None:
    far = 100 * np.linalg.norm(record.frames.frame_drift, axis=2)
    ax.plot(record.time, far, color=SKY, lw=0.6, alpha=0.8)
    ax.plot(record.time, np.median(far, axis=1), color=BLUE, lw=1.8)
    start, end = float(record.time[0]), float(record.time[-1])
    ax.set(xlabel="time [s]", ylabel="drift [cm]", xlim=(start, max(end, start + 1e-9)))
    ax.set_ylim(0, max(1.05 * float(far.max()), 1.0))
