"""Figures of connectivity runs: agreement with the data, and legibility."""

from dataclasses import replace
from functools import cache
from itertools import combinations, product

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Wedge
from pictures import check_layout, draw, line
from recorded_run import record_run

from problems.interaction_graph import interaction_graph
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.controller import evaluate_potential, negative_slope, repulsion_gain
from sato.connectivity.figures import FIGURES
from sato.connectivity.figures.time_series import (
    LOST,
    MAX_PAIRS,
    STICK_COLOR,
    VISIBILITY_COLORS,
    classify_visibility,
    count_edges,
    select_pairs,
)
from sato.connectivity.figures.trajectories import (
    draw_obstacles_3d,
    draw_obstacles_above,
    enclose_obstacles,
)
from sato.connectivity.loop import simulate
from sato.connectivity.obstacles import Obstacles
from sato.connectivity.system import SYSTEM
from sato.figures.axes import AxisBounds
from sato.figures.panels import find_intervals
from sato.figures.style import ORANGE, RED, SKY
from sato.scenario.file import read

STICK = (
    'stick={kind="recorded", times_s=[0, 0.5, 1.5, 2], '
    "velocities_m_s=[[0, 0, 0], [1, 0, 0], [0, 0, 0], [0, -2, 0]]}"
)
AROUND = (
    'obstacle=[{kind="plane", normal=[0, 0, 1], through_m=[0, 0, 0]}, '
    '{kind="plane", normal=[1, 0.2, 0.3], through_m=[-3, 0, 0]}, '
    '{kind="box", low_m=[11, -5, 0], high_m=[30, 5, 4]}]'
)
LOSSES = (
    "death=[{robot=0, time_s=1.0}, {robot=3, time_s=1.6}, {robot=4, time_s=2.0}, "
    "{robot=5, time_s=0}]"
)
VARIANTS = {
    "six": ("duration_s=3",),
    "thirty": ("agents=30", "duration_s=1"),
    "lost": ("duration_s=2.5", "camera.occlusion=true", LOSSES),
    "recorded": ("duration_s=3", STICK, AROUND),
    "two": ("agents=2", "obstacles.count=0", "duration_s=1", "estimator.kind=exact"),
    "blind": ("camera.blind=true", "potential.strength=0", "duration_s=0.1"),
}


@cache
def flown(variant):
    rng = np.random.default_rng(1)
    mission = read("connectivity", list(VARIANTS[variant])).draw(rng)
    data = record_run(SYSTEM, list(simulate(mission, rng)), mission).recorded
    assert list(SYSTEM.figures(data, mission)) == list(FIGURES)
    return ConnectivityRecord.from_data(data, mission)


@cache
def shown(name, variant):
    return draw(FIGURES[name], flown(variant))


def shades(ax, color):
    """Find the intervals in which a panel has a background of a color."""
    grounds = [p for p in ax.patches if to_hex(p.get_facecolor()) == color.lower()]
    ends = [p.get_extents().transformed(ax.transData.inverted()) for p in grounds]
    return [(end.x0, end.x1) for end in ends]


OF_THE_MISSION = ("weights", "potential")  # and of nothing else
EVERY = [
    (name, variant)
    for name, variant in product(FIGURES, VARIANTS)
    if variant == "six" or (name in OF_THE_MISSION) == (variant == "blind")
]


@pytest.mark.parametrize(("name", "variant"), EVERY)
def test_text_stays_inside_figures_and_legends_off_panels(name, variant):
    check_layout(shown(name, variant))


def test_intervals_are_adjacent_and_have_the_values():
    time = np.array([0.0, 1.0, 2.5, 3.0, 4.0])
    found = find_intervals(time, np.array([2, 2, 0, 0, 1]))
    assert [tuple(s) for s in found] == [(2, 0.0, 2.5), (0, 2.5, 4.0), (1, 4.0, 4.0)]
    assert [tuple(s) for s in find_intervals(time[:1], np.array([True]))] == [(1, 0.0, 0.0)]


@pytest.mark.parametrize("name", ["connectivity", "edges", "distances", "following"])
def test_background_is_shaded_exactly_while_the_stick_is_held(name):
    held = pytest.approx(np.array([[0.5, 1.5], [2.0, 3.0]]))
    for ax in shown(name, "recorded").axes:
        assert np.array(shades(ax, STICK_COLOR)) == held


@pytest.mark.parametrize("variant", ["six", "thirty", "lost"])
def test_eigenvalue_figure_shows_recorded_and_estimated_values(variant):
    record = flown(variant)
    frames, limits = record.frames, record.mission.potential
    ax, error = shown("connectivity", variant).axes
    np.testing.assert_array_equal(line(ax, "λ$_2$, true"), [frames.time, frames.lambda2])
    third = np.where(frames.alive.sum(axis=1) > 2, frames.lambda3, np.nan)
    np.testing.assert_array_equal(line(ax, "λ$_3$, true")[1], third)
    own = np.array([one.get_ydata() for one in ax.lines if one.get_color() == ORANGE]).T
    np.testing.assert_array_equal(own, np.where(frames.alive, frames.lambda2_estimate, np.nan))
    off = np.abs(own - frames.lambda2[:, None])
    known = np.isfinite(off).any(axis=1)  # before anything is told, nobody knows
    median = line(error, "median")[1]
    np.testing.assert_array_equal(median[known], np.nanmedian(off[known], axis=1))
    assert known[1:].all() and np.isnan(median[~known]).all()
    for level, name in ((limits.lambda2_min, "min"), (limits.lambda2_max, "max")):
        assert [t.xy[1] for t in ax.texts if f"{{{name}}}" in t.get_text()] == [level]
        assert any(np.all(np.array(one.get_ydata()) == level) for one in ax.lines)
    low, high = ax.get_ylim()
    assert low == 0 and high >= max(frames.lambda2.max(), limits.lambda2_max)


def test_two_robots_alone_have_neither_third_eigenvalue_nor_obstacles():
    labels = [one.get_label() for one in shown("connectivity", "two").axes[0].lines]
    assert "λ$_2$, true" in labels and "λ$_3$, true" not in labels
    [ax] = shown("distances", "two").axes
    assert ax.get_ylabel() == "to another robot [m]"


def test_splits_and_losses_are_marked_in_every_panel():
    record = flown("lost")
    lost = [e["time"] for _, e in record.events.of_kind("loss")]
    (_, split), *_ = record.events.of_kind("split")
    for ax in shown("connectivity", "lost").axes:
        dots = [one.get_xdata()[0] for one in ax.lines if one.get_linestyle() == ":"]
        assert set(lost) <= set(dots)
        assert shades(ax, RED)[0][0] == pytest.approx(split["time"])


@pytest.mark.parametrize("variant", ["six", "lost", "thirty"])
def test_edge_counts_are_those_of_the_graph(variant):
    record = flown(variant)
    frames = record.frames
    [ax] = shown("edges", variant).axes
    numbers = count_edges(record)
    for number, label in zip(
        numbers.T, ("edges", "where both see each other", "pairs of robots"), strict=True
    ):
        np.testing.assert_array_equal(line(ax, label)[1], number)
    for k in range(0, len(frames.time), 20):
        sees = frames.visibility[k]
        pairs = list(combinations(np.flatnonzero(frames.alive[k]).tolist(), 2))
        edges = [(i, j) for i, j in pairs if frames.edge_weight[k, i, j] > 0]
        mutual = [(i, j) for i, j in edges if sees[i, j] and sees[j, i]]
        assert numbers[k].tolist() == [len(edges), len(mutual), len(pairs)]


@pytest.mark.parametrize("variant", ["six", "lost", "thirty", "two"])
def test_yaw_errors_are_drawn_on_the_visibility_of_their_pair(variant):
    record = flown(variant)
    frames, axes, pairs = record.frames, shown("yaw", variant).axes, select_pairs(record)
    n = record.mission.agents
    assert len(axes) == len(pairs) == min(MAX_PAIRS, n * (n - 1) // 2)
    for ax, (i, j) in zip(axes, pairs, strict=True):
        assert ax.get_title(loc="left").endswith(f"i = {i}, j = {j}")
        both = frames.alive[:, i] & frames.alive[:, j]
        for one, (a, b) in zip(ax.lines, ((i, j), (j, i)), strict=True):
            off = np.abs(np.sin(frames.yaw_estimate_error[:, a, b] / 2))
            np.testing.assert_array_equal(one.get_ydata(), np.where(both, off, np.nan))
        sees, seen = frames.visibility[:, i, j], frames.visibility[:, j, i]
        cases = (both & sees & ~seen, both & ~sees & seen, both & sees & seen, ~both)
        for number, case in enumerate(cases, 1):
            inside = np.zeros(len(frames.time), dtype=bool)
            for start, end in shades(ax, VISIBILITY_COLORS[number]):
                inside |= (frames.time >= start - 1e-9) & (frames.time < end - 1e-9)
            np.testing.assert_array_equal(inside[:-1], case[:-1])


def test_selected_pairs_have_most_kinds_of_visibility():
    record = flown("thirty")
    ways = {
        pair: len(set(classify_visibility(record, *pair).tolist()) - {LOST})
        for pair in combinations(range(30), 2)
    }
    shown_ways = [ways.pop(pair) for pair in select_pairs(record)]
    assert min(shown_ways) >= max(ways.values()) > 0


def test_following_figure_ends_with_the_paths_flown():
    record = flown("recorded")
    path, speed = shown("following", "recorded").axes
    places = record.frames.position[:, 0], record.frames.position[:, 1:].mean(axis=1)
    for name, place in zip(("leader", "centroid of the followers"), places, strict=True):
        flown_path = np.linalg.norm(np.diff(place, axis=0), axis=1).sum()
        assert line(path, name)[1][-1] == pytest.approx(flown_path)
    stick = line(speed, "stick, to the leader")[1]
    assert set(stick.round(9)) == {0, 1, 2}


def test_distances_are_the_least_by_brute_force():
    record = flown("lost")
    between, balls = record.mission.repulsion, record.mission.obstacle_arrays.spheres
    axes = shown("distances", "lost").axes
    least, near = (line(ax, "the least")[1] for ax in axes)
    for k in range(0, len(record.frames.time), 25):
        there = record.frames.position[k, record.frames.alive[k]]
        gaps = [np.linalg.norm(p - q) for p, q in combinations(there, 2)]
        assert least[k] == pytest.approx(min(gaps))
        away = [np.linalg.norm(p - ball[:3]) - ball[3] for p in there for ball in balls]
        assert near[k] == pytest.approx(min(away))
    limits = {"least,\n1 m": between.min_distance, "repulsion begins,\n3.5 m": between.max_distance}
    for ax in axes:
        assert {t.get_text(): t.xy[1] for t in ax.texts} == limits


@pytest.mark.parametrize("variant", ["six", "lost", "recorded", "thirty"])
def test_trajectories_end_where_robots_are_or_are_lost(variant):
    frames = flown(variant).frames
    deep, above = shown("paths", variant).axes
    for i, live in enumerate(frames.alive.T):
        place = frames.position[-1, i]
        mark = "o" if live[-1] else "X"
        ends = [np.array(one.get_data_3d()).T for one in deep.lines if one.get_marker() == mark]
        assert np.isclose(np.vstack(ends), place).all(axis=1).any()
        ends = [one.get_xydata() for one in above.lines if one.get_marker() == mark]
        assert np.isclose(np.vstack(ends), place[:2]).all(axis=1).any()
    live = frames.alive[:, 0]
    [leader] = [c for c in above.collections if c.get_label() == "leader"]
    [path] = leader.get_segments()
    np.testing.assert_array_equal(path, frames.position[live, 0, :2])


def test_edges_are_drawn_wider_with_weight():
    frames, camera = flown("six").frames, flown("six").mission.camera
    weight = interaction_graph(frames.position[-1], frames.yaw[-1], camera).weights
    weights = weight[np.triu(weight) > 0]
    for ax in shown("paths", "six").axes:
        [edges] = [c for c in ax.collections if c.get_label().startswith("edge at the end")]
        assert len(edges.get_linewidth()) == len(weights)
        order = np.argsort(edges.get_linewidth(), kind="stable")
        assert (np.diff(weights[order]) >= -1e-9).all()


def test_fields_of_view_open_about_the_optical_axis():
    frames = flown("six").frames
    wedges = [p for p in shown("paths", "six").axes[1].patches if isinstance(p, Wedge)]
    half = np.degrees(np.arccos(0.4))
    for i, wedge in enumerate(wedges):
        assert wedge.center == pytest.approx(frames.position[-1, i, :2])
        middle = np.degrees(frames.yaw[-1, i]) + 45  # the axis is between x and y
        assert (wedge.theta1, wedge.theta2) == pytest.approx((middle - half, middle + half))
    assert len(wedges) == 6


def test_camera_that_looks_down_has_no_sector():
    record = flown("blind")
    down = record.mission.camera._replace(optical_axis=(0.0, 0.0, -1.0), a_min=-0.5)
    record = replace(record, mission=replace(record.mission, camera=down))
    above = draw(FIGURES["paths"], record).axes[1]
    assert not [p for p in above.patches if isinstance(p, Wedge)]


class Recorder:
    """Axes that record the calls of their methods."""

    def __init__(self):
        self.drawn = []

    def __getattr__(self, name):
        return lambda *args, **kw: self.drawn.append((name, args, kw))


SPACE = AxisBounds(np.array([0.0, 0.0, 0.0]), np.array([4.0, 4.0, 4.0]), ("x", "y", "z"))


def test_obstacles_are_clipped_to_the_axes():
    spheres = np.array([[0.0, 2.0, 2.0, 1.0], [9.0, 9.0, 9.0, 1.0]])
    boxes = np.array([[3.0, -2.0, 1.0, 9.0, 3.0, 2.0], [5.0, 0.0, 0.0, 6.0, 1.0, 1.0]])
    planes = np.array([[0.0, 0.0, 1.0, 1.0], [0.6, 0.8, 0.0, 2.0], [0.0, 0.0, 1.0, -7.0]])
    ax = Recorder()
    draw_obstacles_3d(ax, Obstacles(spheres, boxes, planes), SPACE)
    assert [name for name, *_ in ax.drawn] == ["plot_surface", "bar3d", *["plot_trisurf"] * 2]
    ball, bar, floor, wall = (np.array(args) for _, args, _ in ax.drawn)
    assert (ball.min(), ball.max()) == pytest.approx((0, 3))
    assert bar.tolist() == [3, 0, 1, 1, 3, 1]
    assert (floor[2] == 1).all()
    assert sorted(map(tuple, floor[:2].T)) == [(0, 0), (0, 4), (4, 0), (4, 4)]
    np.testing.assert_allclose(0.6 * wall[0] + 0.8 * wall[1], 2)
    assert {round(z, 9) for z in wall[2]} == {0, 4}
    turns = np.diff([*map(tuple, floor[:2].T), tuple(floor[:2, 0])], axis=0)
    assert (np.abs(turns).sum(axis=1) == 4).all()  # along the sides, in order


def test_bounds_show_spheres_that_they_cut_whole_from_above():
    spheres = np.array([[-0.5, 2.0, 2.0, 1.0], [2.0, 2.0, 4.5, 1.0], [9.0, 2.0, 2.0, 1.0]])
    shown = enclose_obstacles(SPACE, Obstacles(spheres, np.zeros((0, 6)), np.zeros((0, 4))))
    assert [*shown.low, *shown.high] == [-1.5, 0, 0, 4, 4, 4]


def test_from_above_a_wall_is_filled_and_a_floor_is_not():
    ax = Figure().add_subplot()
    planes = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]])
    ball = np.array([[2.0, 3.0, 1.0, 0.5]])
    draw_obstacles_above(ax, Obstacles(ball, np.zeros((0, 6)), planes), SPACE, 2.0)
    [wall] = ax.collections
    ground = wall.get_paths()[0].get_extents()
    assert [*ground.min, *ground.max] == pytest.approx([0, 0, 1, 4])
    [circle] = [p for p in ax.patches if isinstance(p, Circle)]
    assert (*circle.center, circle.radius) == (2, 3, 0.5)


def test_weight_figure_agrees_with_the_graph():
    reach, view, either, plane = shown("weights", "six").axes[:4]
    sight, toward = flown("six").mission.camera, np.pi / 4  # of the optical axis

    def graph_of(x, y, yaw=0.0):
        pair = np.array([[0.0, 0.0, 0.0], [x, y, 0.0]])
        return interaction_graph(pair, np.array([0.0, yaw]), sight)

    for d, gamma in reach.lines[0].get_xydata()[1::20]:
        found = graph_of(d * np.cos(toward), d * np.sin(toward))
        assert found.weights[0, 1] == pytest.approx(gamma)
    for degrees, f in view.lines[0].get_xydata()[::20]:
        way = toward + np.radians(degrees)
        found = graph_of(5 * np.cos(way), 5 * np.sin(way))
        assert found.fov_weights[0, 1] == pytest.approx(f, abs=1e-12)
    f = either.images[0].get_array()
    assert (f[0, 0], f[0, -1], f[-1, 0], f[-1, -1]) == (0, 1, 1, 1)
    image = plane.images[0]
    left, right, low, high = image.get_extent()
    weight = image.get_array()
    x, y = np.linspace(left, right, 201), np.linspace(low, high, 201)
    for row, column in ((140, 130), (100, 150), (60, 60), (150, 101)):
        away = toward + np.arctan2(y[row], x[column]) - np.pi / 2  # so j looks away from i
        found = graph_of(x[column], y[row], away)
        assert found.fov_weights[1, 0] == 0
        assert found.weights[0, 1] == pytest.approx(weight[row, column])
    assert weight.max() == 1 and weight.min() == 0


def test_weights_by_range_alone_are_constant_over_the_angle():
    view = shown("weights", "blind").axes[1]
    assert (view.lines[0].get_ydata() == 1).all() and not view.texts


def test_potential_and_repulsion_are_drawn_with_the_mission_values():
    mission, lambda2 = flown("six").mission, flown("six").frames.lambda2
    v, slope, away = shown("potential", "six").axes
    laws = (
        (v, lambda x: evaluate_potential(x, mission.potential)),
        (slope, lambda x: negative_slope(x, mission.potential)),
        (away, lambda d: d * repulsion_gain(d, mission.repulsion)),
    )
    for ax, law in laws:
        x, y = line(ax, "of this mission")
        np.testing.assert_allclose(y, [law(one) for one in x])
        assert y[-1] == 0
    marks = [one.get_xdata()[0] for one in away.lines if one.get_linestyle() == ":"]
    assert marks == [mission.repulsion.min_distance, mission.repulsion.max_distance]
    assert shades(v, SKY) == [pytest.approx((lambda2.min(), lambda2.max()))]
