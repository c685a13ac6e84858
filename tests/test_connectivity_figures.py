"""Figures of connectivity runs: agreement with the data, and legibility."""

from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise, product

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.patches import Circle, Wedge
from pictures import words_inside
from recorded_run import record_run

from problems.interaction_graph import interaction_graph
from sato.connectivity.check import ConnectivityRecord
from sato.connectivity.distance import nearest_agent_distance
from sato.connectivity.figures import FIGURES, make_figures
from sato.connectivity.figures.time_series import (
    LOST,
    MAX_PAIRS,
    STICK_COLOR,
    VISIBILITY_COLORS,
    classify_visibility,
    count_edges,
    find_stick_intervals,
    select_pairs,
)
from sato.connectivity.figures.trajectories import (
    MAX_POINTS,
    draw_obstacles_3d,
    draw_obstacles_from_above,
)
from sato.connectivity.loop import simulate
from sato.connectivity.obstacles import Obstacles
from sato.connectivity.potential import evaluate_potential, negative_slope, repulsion_gain
from sato.connectivity.system import SYSTEM
from sato.figures.axes import AxisBounds
from sato.figures.panels import find_intervals
from sato.figures.style import BLUE, GREEN, ORANGE, RED, STYLE
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
    return recorded(mission, list(simulate(mission, rng)))


def recorded(mission, frames):
    return ConnectivityRecord.from_dataset(data_of(mission, frames), mission)


def data_of(mission, frames):
    return record_run(SYSTEM, frames, mission).data


def drawn(name, record):
    with matplotlib.rc_context(STYLE):
        figure = FIGURES[name](record)
        FigureCanvasAgg(figure).draw()
    return figure


@cache
def shown(name, variant):
    return drawn(name, flown(variant))


def line(ax, label):
    """Find the line with a label."""
    [found] = [one for one in ax.lines if one.get_label() == label]
    return found.get_xydata().T


def shades(ax, color):
    """Find the intervals in which a panel has a background of a color."""
    grounds = [p for p in ax.patches if to_hex(p.get_facecolor()) == color]
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
    figure = shown(name, variant)
    words_inside(figure)
    renderer = figure.canvas.get_renderer()
    for legend in figure.legends:
        key = legend.get_window_extent(renderer)
        for ax in figure.axes:
            assert not key.overlaps(ax.get_window_extent(renderer).shrunk(0.95, 0.95))
            assert not key.overlaps(ax.xaxis.label.get_window_extent(renderer))


@pytest.mark.parametrize("variant", ["six", "lost", "two"])
def test_all_figures_are_offered_for_every_mission(variant):
    record = flown(variant)
    mission = record.mission
    frames = list(simulate(mission, np.random.default_rng(0)))[:1]
    assert list(make_figures(data_of(mission, frames), mission)) == list(FIGURES)
    assert SYSTEM.figures(data_of(mission, frames), mission).keys() == FIGURES.keys()


def test_intervals_are_adjacent_and_have_the_values():
    time = np.array([0.0, 1.0, 2.5, 3.0, 4.0])
    found = find_intervals(time, np.array([2, 2, 0, 0, 1]))
    assert [tuple(s) for s in found] == [(2, 0.0, 2.5), (0, 2.5, 4.0), (1, 4.0, 4.0)]
    assert [tuple(s) for s in find_intervals(time[:1], np.array([True]))] == [(1, 0.0, 0.0)]
    for before, after in pairwise(found):
        assert before.end == after.start


@pytest.mark.parametrize("name", ["connectivity", "edges", "distances"])
def test_background_is_shaded_exactly_while_the_stick_is_held(name):
    for ax in shown(name, "recorded").axes:
        assert np.array(shades(ax, STICK_COLOR)) == pytest.approx(
            np.array([[0.5, 1.5], [2.0, 3.0]])
        )


def test_stick_is_held_where_it_commands_a_velocity():
    record = flown("six")
    inside = np.zeros(len(record.frames.time), dtype=bool)
    for span in find_stick_intervals(record):
        inside |= (record.frames.time >= span.start) & (record.frames.time < span.end)
    asked = np.linalg.norm(record.frames.stick, axis=1) > 0
    np.testing.assert_array_equal(inside[:-1], asked[:-1])


@pytest.mark.parametrize("variant", ["six", "thirty", "lost"])
def test_eigenvalue_figure_shows_recorded_and_estimated_values(variant):
    record = flown(variant)
    ax, error = shown("connectivity", variant).axes
    np.testing.assert_array_equal(
        line(ax, "λ$_2$, true"), [record.frames.time, record.frames.lambda2]
    )
    third = np.where(record.frames.alive.sum(axis=1) > 2, record.frames.lambda3, np.nan)
    np.testing.assert_array_equal(line(ax, "λ$_3$, true")[1], third)
    own = np.array([one.get_ydata() for one in ax.lines if one.get_color() == ORANGE]).T
    np.testing.assert_array_equal(
        own, np.where(record.frames.alive, record.frames.lambda2_estimate, np.nan)
    )
    off = np.abs(own - record.frames.lambda2[:, None])
    known = np.isfinite(off).any(axis=1)  # before anything is told, nobody knows
    median = line(error, "median")[1]
    np.testing.assert_array_equal(median[known], np.nanmedian(off[known], axis=1))
    assert known[1:].all() and np.isnan(median[~known]).all()
    limits = record.mission.potential
    for level, name in ((limits.lambda2_min, "min"), (limits.lambda2_max, "max")):
        [at] = [t.xy[1] for t in ax.texts if f"{{{name}}}" in t.get_text()]
        assert at == level
        assert any(np.all(np.array(one.get_ydata()) == level) for one in ax.lines)
    low, high = ax.get_ylim()
    assert low == 0 and high >= max(record.frames.lambda2.max(), limits.lambda2_max)


def test_two_robots_have_no_third_eigenvalue():
    ax = shown("connectivity", "two").axes[0]
    assert "λ$_3$, true" not in [one.get_label() for one in ax.lines]


def test_splits_and_losses_are_marked_in_every_panel():
    record = flown("lost")
    lost = [e["time"] for _, e in record.events.of_kind("loss")]
    (_, split), *_ = record.events.of_kind("split")
    for ax in shown("connectivity", "lost").axes:
        dots = [one.get_xdata()[0] for one in ax.lines if one.get_linestyle() == ":"]
        assert set(lost) <= set(dots)
        assert shades(ax, RED.lower())[0][0] == pytest.approx(split["time"])


@pytest.mark.parametrize("variant", ["six", "lost", "thirty"])
def test_edge_counts_are_those_of_the_graph(variant):
    record = flown(variant)
    [ax] = shown("edges", variant).axes
    edges, mutual, pairs = count_edges(record).T
    np.testing.assert_array_equal(line(ax, "edges")[1], edges)
    np.testing.assert_array_equal(line(ax, "where both see each other")[1], mutual)
    np.testing.assert_array_equal(line(ax, "pairs of robots")[1], pairs)
    for k in range(0, len(record.frames.time), 20):
        live = np.flatnonzero(record.frames.alive[k]).tolist()
        two = list(combinations(live, 2))
        assert len(two) == pairs[k]
        assert sum(record.frames.edge_weight[k, i, j] > 0 for i, j in two) == edges[k]
        both = [
            record.frames.visibility[k, i, j] and record.frames.visibility[k, j, i] for i, j in two
        ]
        weighs = [record.frames.edge_weight[k, i, j] > 0 for i, j in two]
        assert sum(np.array(both) & np.array(weighs)) == mutual[k]


@pytest.mark.parametrize("variant", ["six", "lost", "thirty", "two"])
def test_yaw_errors_are_drawn_on_the_visibility_of_their_pair(variant):
    record = flown(variant)
    axes = [ax for ax in shown("yaw", variant).axes if ax.get_title(loc="left")]
    pairs = select_pairs(record)
    n = record.mission.agents
    assert len(axes) == len(pairs) == min(MAX_PAIRS, n * (n - 1) // 2)
    for ax, (i, j) in zip(axes, pairs, strict=True):
        assert ax.get_title(loc="left").endswith(f"i = {i}, j = {j}")
        both = record.frames.alive[:, i] & record.frames.alive[:, j]
        for one, (a, b) in zip(ax.lines, ((i, j), (j, i)), strict=True):
            off = np.abs(np.sin(record.frames.yaw_estimate_error[:, a, b] / 2))
            np.testing.assert_array_equal(one.get_ydata(), np.where(both, off, np.nan))
        sees, seen_too = record.frames.visibility[:, i, j], record.frames.visibility[:, j, i]
        cases = (sees & ~seen_too, ~sees & seen_too, sees & seen_too, both)
        for number, case in enumerate(cases, 1):
            case = both & case if number < LOST else ~both
            inside = np.zeros(len(record.frames.time), dtype=bool)
            for start, end in shades(ax, VISIBILITY_COLORS[number]):
                inside |= (record.frames.time >= start - 1e-9) & (record.frames.time < end - 1e-9)
            np.testing.assert_array_equal(inside[:-1], case[:-1])


def test_selected_pairs_have_most_kinds_of_visibility():
    record = flown("thirty")
    ways = {
        pair: len(set(classify_visibility(record, *pair).tolist()) - {LOST})
        for pair in combinations(range(30), 2)
    }
    shown_ways = [ways.pop(pair) for pair in select_pairs(record)]
    assert min(shown_ways) >= max(ways.values()) > 0


def test_distances_are_the_least_by_brute_force():
    record = flown("lost")
    robots, obstacles = shown("distances", "lost").axes
    least, near = line(robots, "the least")[1], line(obstacles, "the least")[1]
    balls = record.mission.obstacle_arrays.spheres
    for k in range(0, len(record.frames.time), 25):
        there = record.frames.position[k, record.frames.alive[k]]
        gaps = [np.linalg.norm(p - q) for p, q in combinations(there, 2)]
        assert least[k] == pytest.approx(min(gaps))
        away = [np.linalg.norm(p - ball[:3]) - ball[3] for p in there for ball in balls]
        assert near[k] == pytest.approx(min(away))
    between = record.mission.repulsion
    for ax in (robots, obstacles):
        said = {t.get_text(): t.xy[1] for t in ax.texts}
        assert said == {
            "least,\n1 m": between.min_distance,
            "repulsion begins,\n3.5 m": between.max_distance,
        }


def test_without_obstacles_no_distance_to_them_is_drawn():
    [ax] = shown("distances", "two").axes
    assert ax.get_ylabel() == "to another robot [m]"


def test_lost_robots_are_not_nearest_neighbors():
    there = np.zeros((1, 3, 3))
    there[0, :, 0] = [0, 1, 3]
    there[0, 1] = np.nan
    np.testing.assert_array_equal(nearest_agent_distance(there), [[3, np.nan, 3]])


@pytest.mark.parametrize("variant", ["six", "lost", "recorded", "thirty"])
def test_trajectories_end_where_robots_are_or_are_lost(variant):
    record = flown(variant)
    deep, above = shown("paths", variant).axes
    last = len(record.frames.time) - 1
    for i in range(record.mission.agents):
        end = int(np.flatnonzero(record.frames.alive[:, i]).max(initial=0))
        place = record.frames.position[end, i]
        mark = "o" if record.frames.alive[last, i] else "X"
        for ax, shown_axes in ((deep, 3), (above, 2)):
            dots = [one for one in ax.lines if one.get_marker() == mark]
            at = [np.ravel(coordinates(one)) for one in dots]
            assert any(np.allclose(p, place[:shown_axes]) for p in at if len(p) == shown_axes)
    [leader] = [one for one in above.lines if one.get_color() == ORANGE and one.get_lw() == 2.0]
    live = record.frames.alive[:, 0]
    assert len(record.frames.time) <= MAX_POINTS
    np.testing.assert_array_equal(leader.get_xydata()[live], record.frames.position[live, 0, :2])
    assert np.isnan(leader.get_xydata()[~live]).all()


def coordinates(one):
    """Return the coordinates of a line in space or from above."""
    return one.get_data_3d() if hasattr(one, "get_data_3d") else one.get_data()


def test_edges_are_drawn_wider_with_weight():
    record = flown("six")
    mission = record.mission
    weight = interaction_graph(
        record.frames.position[-1], record.frames.yaw[-1], mission.camera
    ).weights
    for ax in shown("paths", "six").axes:
        edges = [one for one in ax.lines if one.get_color() == GREEN]
        assert len(edges) == np.triu(weight > 0).sum()
        order = np.argsort([one.get_linewidth() for one in edges], kind="stable")
        weights = weight[tuple(np.argwhere(np.triu(weight) > 0).T)]
        assert (np.diff(weights[order]) >= -1e-9).all()


def test_fields_of_view_open_about_the_optical_axis():
    record = flown("six")
    above = shown("paths", "six").axes[1]
    wedges = [p for p in above.patches if isinstance(p, Wedge)]
    for i, wedge in enumerate(wedges):
        assert wedge.center == pytest.approx(record.frames.position[-1, i, :2])
        half = np.degrees(np.arccos(0.4))
        middle = np.degrees(record.frames.yaw[-1, i]) + 45  # the axis is between x and y
        assert (wedge.theta1, wedge.theta2) == pytest.approx((middle - half, middle + half))
    assert len(wedges) == 6


def test_camera_that_looks_down_has_no_sector():
    record = flown("blind")
    down = record.mission.camera._replace(optical_axis=(0.0, 0.0, -1.0), a_min=-0.5)
    above = drawn("paths", replace(record, mission=replace(record.mission, camera=down))).axes[1]
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


def test_from_above_a_wall_is_filled_and_a_floor_is_not():
    figure = matplotlib.figure.Figure()
    ax = figure.add_subplot()
    planes = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]])
    ball = np.array([[2.0, 3.0, 1.0, 0.5]])
    draw_obstacles_from_above(ax, Obstacles(ball, np.zeros((0, 6)), planes), SPACE, 2.0)
    [wall] = ax.collections
    ground = wall.get_paths()[0].vertices
    assert (ground.min(axis=0), ground.max(axis=0)) == (
        pytest.approx([0, 0]),
        pytest.approx([1, 4]),
    )
    [circle] = [p for p in ax.patches if isinstance(p, Circle)]
    assert (*circle.center, circle.radius) == (2, 3, 0.5)


def test_weight_figure_agrees_with_the_graph():
    record = flown("six")
    reach, view, either, plane = shown("weights", "six").axes[:4]
    sight, alone = record.mission.camera, np.zeros(3)
    toward = np.pi / 4  # of the optical axis
    for d, gamma in reach.lines[0].get_xydata()[1::20]:
        there = np.array([alone, d * np.array([np.cos(toward), np.sin(toward), 0])])
        assert interaction_graph(there, np.array([0.0, 0.0]), sight).weights[0, 1] == pytest.approx(
            gamma
        )
    for degrees, f in view.lines[0].get_xydata()[::20]:
        way = toward + np.radians(degrees)
        there = np.array([alone, 5 * np.array([np.cos(way), np.sin(way), 0])])
        assert interaction_graph(there, np.zeros(2), sight).fov_weights[0, 1] == pytest.approx(
            f, abs=1e-12
        )
    f = either.images[0].get_array()
    assert (f[0, 0], f[0, -1], f[-1, 0], f[-1, -1]) == (0, 1, 1, 1)
    image = plane.images[0]
    left, right, low, high = image.get_extent()
    weight = image.get_array()
    x, y = np.linspace(left, right, 201), np.linspace(low, high, 201)
    for row, column in ((140, 130), (100, 150), (60, 60), (150, 101)):
        there = np.array([alone, [x[column], y[row], 0]])
        away = toward + np.arctan2(y[row], x[column]) - np.pi / 2  # so j looks away from i
        found = interaction_graph(there, np.array([0.0, away]), sight)
        assert found.fov_weights[1, 0] == 0
        assert found.weights[0, 1] == pytest.approx(weight[row, column])
    assert weight.max() == 1 and weight.min() == 0


def test_weights_by_range_alone_are_constant_over_the_angle():
    view = shown("weights", "blind").axes[1]
    assert (view.lines[0].get_ydata() == 1).all() and not view.texts


def test_potential_and_repulsion_are_drawn_with_the_mission_values():
    record = flown("six")
    mission = record.mission
    v, slope, away = shown("potential", "six").axes
    laws = (
        (v, lambda x: evaluate_potential(x, mission.potential)),
        (slope, lambda x: negative_slope(x, mission.potential)),
        (away, lambda d: d * repulsion_gain(d, mission.repulsion)),
    )
    for ax, law in laws:
        x, y = ax.lines[0].get_xydata().T
        np.testing.assert_allclose(y, [law(one) for one in x])
        assert y[-1] == 0
    marks = [one.get_xdata()[0] for one in away.lines if one.get_linestyle() == ":"]
    assert marks == [mission.repulsion.min_distance, mission.repulsion.max_distance]
    [(low, high)] = shades(v, "#56b4e9")
    assert (low, high) == pytest.approx((record.frames.lambda2.min(), record.frames.lambda2.max()))
    assert BLUE == v.lines[0].get_color()
