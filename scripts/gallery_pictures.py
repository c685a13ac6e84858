"""Pictures of docs/gallery.md that `sato plot` does not draw: of runs, or of their missions."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy import ndarray as Array

import sato
from problems.alignment import align
from sato.figures.axes import (
    AxisBounds,
    add_axes,
    add_legend,
    add_titles,
    draw_paths,
)
from sato.figures.style import (
    BLUE,
    DARK_GRAY,
    GRAY,
    GREEN,
    LIGHT_GRAY,
    ORANGE,
    RED,
    style_components,
)
from sato.formation.check.recorded import FormationRecord
from sato.formation.figures.trajectories import plot_paths
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.scene import Scene, interpolate_positions

DOT: dict[str, Any] = {"ls": "", "marker": "o", "mew": 0}


def read_reconfiguration(run: sato.Run) -> ReconfigurationRecord:
    """Read the record of a reconfiguration."""
    return ReconfigurationRecord.from_data(run.recorded, run.drawn_mission)


def read_formation(run: sato.Run) -> FormationRecord:
    """Read the record of a formation flight."""
    return FormationRecord.from_data(run.recorded, run.drawn_mission)


def draw_problem(run: sato.Run) -> Figure:
    """Draw starts, trajectories and targets, and the networks at the start [Morgan2016, Fig. 1]."""
    record = read_reconfiguration(run)
    scene, radius = Scene(record), record.mission.comm_radius
    space = scene.enclose(scene.path, *scene.targets)
    figure = Figure(figsize=(8.2, 4.7), layout="constrained")
    ways, networks = add_axes(figure, space, (1, 2, 1)), add_axes(figure, space, (1, 2, 2))
    draw_paths(ways, space, scene.path, LIGHT_GRAY, label="trajectory, as flown")
    ways.plot(*scene.path[0].T, **DOT, ms=6, color=GREEN, label="agent, at the start")
    ways.plot(*scene.targets[0].T, "X", ms=7, mew=0, color=RED, label="target")
    place, component = scene.path[0], record.frames.component[0]
    for members, look, _ in style_components(component):
        networks.plot(*place[members].T, **look, ls="", ms=8, mew=0, zorder=3)
        for i in members:
            for j in members[members > i]:
                if np.linalg.norm(place[i] - place[j]) <= radius:
                    arrow = {"arrowstyle": "<->", "ls": "--", "color": look["color"], "lw": 0.9}
                    networks.annotate("", place[j], place[i], arrowprops=arrow)
    for i, at in enumerate(place):
        networks.annotate(str(i), at, xytext=(5, 5), textcoords="offset points")
    link = Line2D([], [], color=DARK_GRAY, ls="--", lw=0.9, label=f"link, up to {radius:g} m")
    add_titles((ways, networks), ["from positions to a formation", "networks at the start"])
    add_legend(figure, link)
    return figure


def draw_conflicts(collision: sato.Run, conflict: sato.Run) -> Figure:
    """Draw an undetectable collision, and a resolved conflict [Morgan2016, Fig. 3]."""
    figure = Figure(figsize=(8.2, 6.6), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(1.7, 1))
    title = _draw_collision(above, read_reconfiguration(collision))
    _draw_conflict(below, read_reconfiguration(conflict))
    for ax in (above, below):
        ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", anchor="W")
        entries = dict(zip(*ax.get_legend_handles_labels()[::-1], strict=True))
        beside: dict[str, Any] = {"bbox_to_anchor": (1.01, 1.0)} if ax is above else {}
        ax.legend(entries.values(), entries, loc="upper left", **beside)
    resolved = "a conflict, resolved within hearing; dotted: to the target held"
    add_titles((above, below), [title, resolved], loc="left")
    return figure


def _draw_collision(ax: Any, record: ReconfigurationRecord) -> str:
    """Draw two at their last plan beyond hearing, and where they are closest; return a title."""
    mission, least = record.mission, record.separations[0].minimum
    closest = (least.piece + least.fraction) / record.pieces_per_step
    apart = np.linalg.norm(np.diff(record.frames.position, axis=1)[:, 0], axis=1)
    plans = np.arange(0, int(closest), mission.replan_steps)
    unheard = float(plans[apart[plans] > mission.comm_radius][-1])
    reach = mission.max_speed * mission.horizon_steps * mission.step
    circles: list[tuple[float, dict[str, Any]]] = [
        (mission.comm_radius, {"ec": BLUE, "ls": ":", "lw": 1.4, "label": "hearing, $R_{comm}$"}),
        (reach, {"ec": ORANGE, "ls": "--", "lw": 1.2, "label": "reach, $V_{max} T_H Δt$"}),
    ]
    ax.plot(*record.frames.position.transpose(2, 0, 1), color=GRAY, lw=0.8, label="as flown")
    plan, end = interpolate_positions(record, np.array([unheard, closest]))
    times = [f"{k * mission.step:.3g} s" for k in (unheard, closest)]
    ax.plot(*plan.T, **DOT, ms=6, color=BLUE, label=f"last plan beyond hearing, {times[0]}")
    for at in plan:
        for radius, style in circles:
            ax.add_patch(Circle(tuple(at), radius, fill=False, **style))
    ax.plot(*end.T, "X", ms=6, mew=0, color=RED, label=f"closest instant, {times[1]}")
    for at in end:
        style = {"fc": RED, "alpha": 0.2, "lw": 0, "label": "$R_{col}$ at that instant"}
        ax.add_patch(Circle(tuple(at), mission.largest_separation, **style))
    ax.autoscale_view()
    needed = 2 * reach + mission.largest_separation
    limits = f"$R_{{comm}}$ = {mission.comm_radius:g} m of the {needed:g} m needed"
    return f"undetectable: {limits}; the two come within {least.distance:.2g} m"


def _draw_conflict(ax: Any, record: ReconfigurationRecord) -> None:
    """Draw two that hold one target beyond hearing, and where they hear and resolve it."""
    held, position = record.frames.target_index, record.frames.position
    targets = record.targets[0, :, :2]
    resolved = int(np.flatnonzero(held[:, 0] != held[:, 1])[0])
    ax.plot(*position.transpose(2, 0, 1), color=GRAY, lw=0.8, label="as flown")
    ax.plot(*targets.T, "X", ms=8, mew=0, color=RED, label="target")
    looks: list[tuple[int, str, dict[str, Any]]] = [
        (0, "unheard, one target", {"color": BLUE}),
        (resolved, "heard, two targets", {"mfc": "white", "mec": GREEN, "mew": 1.4}),
    ]
    for k, name, look in looks:
        label = f"{name}, {record.time[k]:g} s"
        ax.plot(*position[k].T, **{**DOT, "ms": 7, **look}, label=label)
        for ends in np.stack([position[k], targets[held[k]]], axis=1):
            ax.plot(*ends.T, color=look.get("mec", BLUE), ls=":", lw=1.2, zorder=1)
    ax.margins(0.06, 0.25)


def draw_frames(*runs: sato.Run) -> Figure:
    """Draw coordinate frames by how far they are aligned [Lusk2020, Fig. 2]."""
    figure = Figure(figsize=(8.2, 3.3), layout="compressed")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for ax, run in zip(axes, runs, strict=True):
        mission = read_formation(run).mission
        frames, start = mission.coordinate_frames, mission.initial_positions
        ax.plot(*start[:, :2].T, **DOT, ms=6, color=DARK_GRAY, label="vehicle")
        origin = frames.origin[:, :2]
        for at, own in zip(origin, start, strict=True):
            ax.plot(*np.stack([at, own[:2]]).T, color=LIGHT_GRAY, lw=0.8, ls=":", zorder=1,
                    label="vehicle and its frame")  # fmt: skip
        for turn, color, name in ((1, BLUE, "x of a frame"), (1j, ORANGE, "y of a frame")):
            way = 1.8 * turn * frames.rotation
            tips = origin + np.stack([way.real, way.imag], axis=1)
            ax.plot(*np.stack([origin, tips]).transpose(2, 0, 1), color=color, lw=1.6, label=name)
        ax.set(aspect="equal", xlabel="x [m]")
    axes[0].set_ylabel("y [m]")
    add_titles(axes, ["one common frame", "aligned, own origins", "no alignment"])
    add_legend(figure)
    return figure


MODULES = {  # name, file, place
    "desired formation": ("desired_formation.py", (0, 2)),
    "gain design": ("gain_design.py", (1, 2)),
    "localization": ("sensing.py", (0, 1)),
    "alignment": ("alignment.py", (1, 1)),
    "auction of points": ("vsdaa.py, cbaa.py", (2, 1)),
    "control law": ("control_law.py", (2, 2)),
    "collision avoidance": ("avoidance.py", (3, 2)),
    "vehicles": ("control_step.py", (3, 1)),
}
FLOWS = [  # from, to, and how much the arrow is bent
    ("desired formation", "gain design", 0.0), ("gain design", "control law", 0.0),
    ("control law", "collision avoidance", 0.0), ("collision avoidance", "vehicles", 0.0),
    ("desired formation", "alignment", 0.0), ("localization", "alignment", 0.0),
    ("alignment", "auction of points", 0.0), ("auction of points", "control law", 0.0),
    ("localization", "control law", 0.0), ("vehicles", "localization", -0.3),
]  # fmt: skip


def draw_modules() -> Figure:
    """Draw the modules of a formation flight, and the files that carry them [Lusk2020, Fig. 3]."""
    figure = Figure(figsize=(8.2, 3.0), layout="constrained")
    ax = figure.subplots()
    look = {"boxstyle": "round,pad=0.5", "fc": "#eef4f9", "ec": BLUE, "lw": 0.8}
    boxes = {}
    for name, (file, place) in MODULES.items():
        text = f"{name}\n{file}"
        words = ax.text(*place, text, ha="center", va="center", bbox=look, fontsize=8.5)
        boxes[name] = words.get_bbox_patch()
    for start, end, bend in FLOWS:
        arrow = {"arrowstyle": "-|>", "color": DARK_GRAY, "shrinkA": 1, "shrinkB": 1}
        arrow |= {"patchA": boxes[start], "patchB": boxes[end]}
        arrow["connectionstyle"] = f"arc3,rad={bend}"
        ax.annotate("", MODULES[end][1], MODULES[start][1], arrowprops=arrow, zorder=0)
    ax.set(xlim=(-0.45, 3.45), ylim=(0.25, 2.35))
    ax.set_axis_off()
    return figure


def draw_alignment(run: sato.Run) -> Figure:
    """Draw how the first vehicle aligns a formation with its neighbors [Lusk2020, Fig. 4]."""
    record = read_formation(run)
    mission, [(first, _), *_] = record.mission, record.events.of_kind("auction")
    formation = mission.gains[0].formation
    points, graph = formation.points, formation.graph | np.eye(len(formation.points), dtype=bool)
    frames = mission.coordinate_frames
    away = record.frames.position[first] - frames.origin[0]
    flat = (away[:, 0] + 1j * away[:, 1]) * np.conj(frames.rotation[0])
    measured = np.stack([flat.real, flat.imag, away[:, 2]], axis=1)
    placed = align(points, measured, graph[0]).transform(points)
    figure = Figure(figsize=(8.2, 4.2), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    for ax, shape, is_aligned in zip(axes, (points, placed), (False, True), strict=True):
        for i, j in np.argwhere(np.triu(formation.graph)):
            ax.plot(*shape[[i, j], :2].T, color=BLUE, lw=1.0, zorder=1, label="formation graph")
        for i, at in enumerate(shape[:, :2]):
            alpha = 1.0 if graph[0, i] or not is_aligned else 0.3
            ax.plot(
                *at, "s", ms=7, mew=0, color=BLUE, alpha=alpha, label="formation point" * (not i)
            )
            ax.annotate(f"p$_{i + 1}$", at, xytext=(6, 4), textcoords="offset points", color=BLUE)
        for i in np.flatnonzero(graph[0]):
            at, name = measured[i, :2], "vehicle 1" if i == 0 else "neighbor"
            ax.plot(*at, **DOT, ms=12, color=RED if i == 0 else ORANGE, zorder=3, label=name)
            ax.annotate(str(i + 1), at, ha="center", va="center", color="white", zorder=4)
            if is_aligned:
                ax.plot(*np.stack([at, shape[i, :2]]).T, color=DARK_GRAY, ls=":", lw=1.0,
                        label="to its own point")  # fmt: skip
        ax.set(aspect="equal", xlabel="x in the frame of vehicle 1 [m]")
        ax.margins(0.12)
    axes[0].set_ylabel("y in the frame of vehicle 1 [m]")
    add_titles(axes, ["before", "aligned with what vehicle 1 knows"])
    add_legend(figure)
    return figure


def draw_reassignments(run: sato.Run) -> Figure:
    """Draw the last 50 s of a flight, in which points are reassigned [Lusk2020, Fig. 5]."""
    return plot_paths(read_formation(run), 50.0)


def draw_gridlock(run: sato.Run) -> Figure:
    """Draw a whole flight that ends in a gridlock [Lusk2020, Fig. 7]."""
    return plot_paths(read_formation(run), 100.0)


def draw_graphs(run: sato.Run) -> Figure:
    """Draw the graph of each formation in space [Lusk2020, Fig. 6]."""
    shapes = {g.formation.name: g.formation for g in read_formation(run).mission.gains}
    figure = Figure(figsize=(8.2, 3.4), layout="constrained")
    for number, formation in enumerate(shapes.values(), 1):
        space = _space_about(formation.points)
        ax = add_axes(figure, space, (1, len(shapes), number))
        ax.view_init(elev=22, azim=-62)
        ax.zaxis.labelpad = -4
        ax.patch.set_alpha(0.0)  # or it hides labels of the axes beside it
        edges = formation.points[np.argwhere(np.triu(formation.graph)).T]
        draw_paths(ax, space, edges, GRAY, lw=1.2, label="edge")
        ax.plot(*formation.points.T, **DOT, ms=6, color=BLUE, label="point of the formation")
        floor = formation.points * [1, 1, 0] + [0, 0, space.low[2]]
        draw_paths(ax, space, np.stack([formation.points, floor]), LIGHT_GRAY, lw=0.6, ls=":")
    named = ((name.rpartition("/")[2], f.edge_count) for name, f in shapes.items())
    add_titles(figure.axes, [f"{name}\n{edges} edges" for name, edges in named], y=0.97)
    add_legend(figure)
    return figure


def _space_about(points: Float[Array, "n 3"]) -> AxisBounds:
    space = AxisBounds.enclosing(("x", "y", "z"), points, margin=0.4)
    size = space.size.max()
    middle = (space.low + space.high) / 2
    half = np.array([size, size, max(space.size[2], 0.6 * size)]) / 2
    return space._replace(low=middle - half, high=middle + half)
