"""Figures and animations of a reconfiguration: they show the data, inside the figure."""

import os
from dataclasses import replace
from functools import cache
from itertools import product

import matplotlib
import numpy as np
import pytest
from full_disk import file_size_limit
from pictures import check_layout, draw, line
from PIL import Image
from recorded_run import (
    fly_straight,
    in_order,
    make_crossing,
    make_mission,
    recorded,
    with_data,
)

from dynamics import ClohessyWiltshire
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant
from sato.figures.style import ISOLATED, marker_style, style_components
from sato.film import SwarmFilm
from sato.reconfiguration.check.fuel import compute_step_fuel
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures import (
    FIGURES,
    ORBIT_FIGURES,
    PAIR_FIGURES,
    make_figures,
)
from sato.reconfiguration.figures.scene import interpolate_positions
from sato.reconfiguration.leg import Leg, Loss
from sato.record import drawn_mark, find_drawn

LETTERS = """
[[leg]]
shape = { kind = "text", text = "U$_$" }
[[leg]]
shape = { kind = "ring" }
"""


def box():
    """Twelve craft that become a ring in space, about no chief in particular."""
    model = ClohessyWiltshire(1.1e-3)
    place = np.random.default_rng(2).uniform(-1500, 1500, (12, 3))
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack([500 * np.cos(turn), 1000 * np.sin(turn), 800 * np.cos(turn)], axis=1)
    start, goals = (np.hstack([p, model.bounded_velocity(p)]) for p in (place, ring))
    return make_mission(
        12, model=model, plant=LinearPlant(model), start=start,
        legs=(Leg(in_order(goals), 20),), step=60.0,
        comm_radius=1200.0, collision_radius=50.0, max_control=0.01, max_speed=6.0,
    )  # fmt: skip


def plane():
    start = make_mission().initial_states[:6].copy()
    start[2:, 0] += 0.5  # the row falls apart: two, three and one
    start[5, 0] += 0.5
    return make_mission(comm_radius=1.21, start=start, allow_undetectable=True)


def orbit():
    """The same about a chief, in two legs, of which the second begins with a loss."""
    about = box()
    orbit = Orbit.from_elements(6878e3, inclination=0.8)
    [leg] = about.legs
    again = Leg(in_order(leg.targets[::-1]), 12, losses=(Loss("agents", agents=(3,)),))
    return replace(about, legs=(leg, again), plant=LinearPlant(about.linear_model, orbit))


def flat_orbit():
    about = orbit()
    start = about.initial_states.copy()
    start[:, 2::3] = 0
    leg = Leg(in_order(about.legs[0].targets * [1, 1, 0, 1, 1, 0]), 18)
    return replace(about, start=start, legs=(leg,))


# Mission, and the number of instants that are recorded; all without one.
RUNS = {
    "plane": (plane, None),
    "box": (box, None),
    "orbit": (orbit, None),
    "flat orbit": (flat_orbit, None),
    "stopped orbit": (orbit, 24),
    "only start, in orbit": (orbit, 1),
    "pair": (lambda: make_crossing(0.3), None),
    "stopped": (make_mission, 15),
    "only start": (make_mission, 1),
}
IN_ORBIT = [name for name in RUNS if "orbit" in name]
IN_PAIRS = [name for name in RUNS if "only" not in name]
EVERY = [
    *product(FIGURES, RUNS),
    *product(PAIR_FIGURES, IN_PAIRS),
    *product(ORBIT_FIGURES, IN_ORBIT),
]


@cache
def flown(name):
    """Record a run once; return it with its record."""
    make, count = RUNS[name]
    about = make()
    run = recorded(about, fly_straight(about, own_targets=name == "pair")[:count])
    if name == "plane":
        run = with_data(run, run.data.assign_attrs(scenario=LETTERS))
    return run, ReconfigurationRecord.from_data(run.recorded, about)


@cache
def drawn(name, run):
    return draw((FIGURES | PAIR_FIGURES | ORBIT_FIGURES)[name], flown(run)[1])


@pytest.mark.parametrize(("name", "run"), EVERY)
def test_texts_stay_inside_the_figure_and_do_not_overlap(name, run):
    check_layout(drawn(name, run))


@pytest.mark.parametrize("run", RUNS)
@pytest.mark.parametrize("name", ["stages", "first-leg", "trajectories"])
def test_panels_share_limits_and_scale(name, run):
    axes = drawn(name, run).axes
    assert len({(ax.get_xlim(), ax.get_ylim()) for ax in axes}) == 1
    names = axes[-1].get_xlabel(), axes[0].get_ylabel()
    if run == "box":
        assert {ax.get_zlabel() for ax in axes} == {"z [km]"}
    else:
        orbital = "y, along-track [km]", "x, radial [km]"
        assert names == (orbital if run in IN_ORBIT else ("x [m]", "y [m]"))
        assert all(ax.get_aspect() == 1 for ax in axes)


def test_stages_are_the_start_each_leg_end_and_each_loss():
    axes = drawn("stages", "plane").axes
    titles = [ax.get_title().split("\n")[0] for ax in axes]
    after = [r"(b) after leg 1, ‘U\$_\$’", "(c) 1 agent lost", "(d) after leg 2, ring"]
    assert titles == ["(a) start", *after]
    assert [ax.get_title().split("\n")[1] for ax in axes[:2]] == ["3 components", "1 component"]


def points(ax):
    """Return the positions of the agents drawn in a panel."""
    return np.vstack([line.get_xydata() for line in ax.lines if line.get_zorder() == 3])


def test_markers_are_at_positions_and_lost_agents_have_none():
    axes = drawn("stages", "plane").axes
    for ax, k, lost in zip(axes, [0, 12, 12, 22], [[6], [6], [2, 6], [2]], strict=True):
        there = np.delete(flown("plane")[1].frames.position[k], lost, axis=0)
        assert sorted(map(tuple, points(ax))) == sorted(map(tuple, there))


def test_first_leg_is_six_instants_with_their_networks():
    axes, frames = drawn("first-leg", "plane").axes, flown("plane")[1].frames
    assert len(axes) == 6
    for ax, k in zip(axes, [0, 1, 4, 6, 9], strict=False):  # and the last, of the leg
        live = frames.alive[k]
        assert sorted(map(tuple, points(ax))) == sorted(map(tuple, frames.position[k, live]))
        count = len(set(frames.component[k, live].tolist()))
        assert ax.get_title().split("\n")[1].startswith(f"{count} component")


def test_components_differ_in_color_and_marker():
    component = np.array([4, 1, 4, 2, 1, 4, -1, 7])
    found = [(members.tolist(), look) for members, look, _ in style_components(component)]
    assert found == [([0, 2, 5], marker_style(0)), ([1, 4], marker_style(1)), ([3, 7], ISOLATED)]
    assert len({tuple(marker_style(rank).values()) for rank in range(56)}) == 56
    for rank in range(55):
        assert marker_style(rank)["color"] != marker_style(rank + 1)["color"]
        assert marker_style(rank)["marker"] != marker_style(rank + 1)["marker"]


def test_separation_is_drawn_between_samples():
    [ax] = drawn("separation", "pair").axes
    [steps] = [p for p in ax.patches if hasattr(p, "get_data")]
    assert steps.get_data().values.min() == pytest.approx(0.3, rel=1e-9)
    labels = [t.get_text() for t in ax.figure.legends[0].get_texts()]
    assert "least: 0.3 m" in labels
    [limit] = [text for text in ax.texts if text.get_text() == "collision\nradius, 0.2 m"]
    assert limit.xy[1] == 0.2


@pytest.mark.parametrize(("run", "count"), [("plane", 7), ("flat orbit", 12)])
def test_fuel_of_every_agent_is_above_its_bound(run, count):
    [ax] = drawn("fuel", run).axes
    dots = np.vstack([line.get_xydata() for line in ax.lines[1:]])
    assert len(dots) == count
    assert (dots[:, 1] >= dots[:, 0] * (1 - 1e-6)).all()


def test_half_plane_is_tangent_and_clears_the_control_points():
    axes = drawn("half-space", "pair").axes
    assert len(axes) == 3
    [edge] = [line for line in axes[2].lines if line.get_color() == "#D55E00"]
    a, b = edge.get_xydata()
    [control] = [line for line in axes[2].lines if line.get_marker() == "D"]
    normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
    # Tangent to the circle, and the step's four points beyond it.
    assert abs(normal @ a) == pytest.approx(0.2, rel=1e-9)
    side = np.sign(normal @ a)
    assert (side * (control.get_xydata() @ normal) >= 0.2).all()


@pytest.mark.parametrize(("distance", "said"), [(0.3, "closest: 0.3 m"), (0.1, "a collision")])
def test_half_space_is_of_the_closest_pair_as_flown(distance, said):
    mission = make_crossing(distance)
    run = recorded(mission, fly_straight(mission, own_targets=True))
    record = ReconfigurationRecord.from_data(run.recorded, mission)
    figure = draw(PAIR_FIGURES["half-space"], record)
    [mark] = [line for line in figure.axes[0].lines if line.get_marker() == "v"]
    assert said in mark.get_label()
    assert np.linalg.norm(mark.get_xydata()) == pytest.approx(distance, rel=1e-6)
    path = line(figure.axes[0], "$j$ relative to $i$, as flown").T
    flown_path = record.frames.position[:, 1] - record.frames.position[:, 0]
    gap = np.linalg.norm(path[:, None] - flown_path, axis=2).min(axis=1)
    assert gap[::6].max() < 1e-9  # six points a step, the first of which is recorded


def test_figures_of_pairs_are_left_out_where_no_two_flew_at_a_time():
    run, record = flown("only start")
    assert PAIR_FIGURES.keys().isdisjoint(make_figures(run.recorded, record.mission))


def test_time_series_of_a_leg_end_at_its_targets():
    record, axes = flown("pair")[1], drawn("time-series", "pair").axes
    thrust, speed, place, away = axes[0], axes[2], axes[4], axes[6]
    frames = record.frames
    np.testing.assert_array_equal(line(place, "agent 1")[1], frames.position[:, 1, 0])
    np.testing.assert_array_equal(line(speed, "agent 1")[1], frames.velocity[:, 1, 0])
    np.testing.assert_array_equal(line(thrust, "agent 1")[1], frames.applied_control[:, 1, 0])
    start = np.linalg.norm(frames.position[0, 1] - record.targets[0, 1, :2])
    distance = line(away, "agent 1")[1]
    assert distance[0] == pytest.approx(start)
    assert distance[-1] <= record.mission.position_tolerance


def test_bands_of_a_large_swarm_hold_the_agents_that_are_drawn():
    axes = drawn("time-series", "orbit").axes
    for ax in axes[:9]:
        widest = ax.collections[0].get_paths()[0].vertices
        chosen = [line for line in ax.lines if line.get_label().startswith("agent")]
        assert len(chosen) == 3
        values = np.concatenate([line.get_ydata() for line in chosen])
        assert np.nanmin(values) >= widest[:, 1].min() and np.nanmax(values) <= widest[:, 1].max()


def test_fuel_figure_tells_its_bounds_apart():
    title = drawn("fuel", "pair").axes[0].get_title(loc="left")
    _, taken, asked = title.splitlines()
    assert "in the time taken" in taken and "in the time asked for" in asked


def test_instants_of_an_orbit_are_thirds_of_its_legs_in_the_orbital_plane():
    axes, frames = drawn("instants", "orbit").axes, flown("orbit")[1].frames
    minutes = [0, 7, 13, 20, 20, 24, 28, 32]  # legs of 20 and of 12 steps of a minute
    titles = [f"({c}) {t} min, points" for c, t in zip("abcdefgh", minutes, strict=True)]
    assert [ax.get_title() for ax in axes] == titles
    # Along-track to the right, radial up.
    there = frames.position[-1, frames.alive[-1]][:, [1, 0]] / 1000
    assert sorted(map(tuple, points(axes[-1]))) == sorted(map(tuple, there))
    # An agent lost between the legs is shown at the end of the first.
    assert [len(points(ax)) for ax in axes[3:5]] == [12, 11]


def test_trajectories_are_cubic_and_end_where_an_agent_is_lost():
    _, evidence = flown("orbit")
    steps, h = np.arange(float(len(evidence.time))), evidence.mission.step
    there = np.where(evidence.frames.alive[..., None], evidence.frames.position, np.nan)
    np.testing.assert_array_equal(interpolate_positions(evidence, steps), there)
    half = interpolate_positions(evidence, steps[:-1] + 0.5)
    (x, v), flies = (evidence.frames.position, evidence.frames.velocity), evidence.frames.alive[:-1]
    cubic = (x[:-1] + x[1:]) / 2 + h * (v[:-1] - v[1:]) / 8
    np.testing.assert_allclose(half, np.where(flies[..., None], cubic, np.nan), atol=1e-9)


def test_flat_swarm_has_depth_in_the_view_of_space():
    [ax] = drawn("space", "flat orbit").axes
    names = ax.get_xlabel(), ax.get_ylabel(), ax.get_zlabel()
    assert names == ("x, radial [km]", "y, along-track [km]", "z, normal [km]")
    size = np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
    assert size[2] == pytest.approx(0.4 * size.max())
    assert sum(ax.get_zlim()) == pytest.approx(0, abs=1e-9)


def test_delta_v_figure_shows_fuel_and_its_lorenz_curve():
    bars, shares = drawn("delta-v", "orbit").axes
    evidence = flown("orbit")[1]
    fuel, survivors = compute_step_fuel(evidence).sum(axis=0), evidence.frames.alive[-1]
    heights = [bar.get_height() for bar in bars.patches]
    np.testing.assert_allclose(sorted(heights), sorted(fuel))
    x, y = line(shares, "this swarm")
    assert (x[0], y[0], x[-1], y[-1]) == pytest.approx((0, 0, 100, 100))
    assert (np.diff(y, 2) > -1e-9).all() and (y <= x + 1e-9).all()
    [words] = [t.get_text() for t in shares.texts]
    assert f"mean {fuel[survivors].mean():.3g} m/s" in words
    assert f"standard deviation {fuel[survivors].std():.3g} m/s" in words


def test_all_figures_are_written_as_png_or_pdf(tmp_path):
    paths = flown("orbit")[0].plot(tmp_path / "new" / "folder")
    names = FIGURES | PAIR_FIGURES | ORBIT_FIGURES
    assert [path.name for path in paths] == [f"{name}.png" for name in names]
    for path in paths:
        with Image.open(path) as image:
            assert image.width > 600 and len(image.convert("RGB").getcolors(1 << 20)) > 20
    before = dict(matplotlib.rcParams)
    for path in flown("plane")[0].plot(tmp_path, pdf=True):
        assert path.stem in FIGURES | PAIR_FIGURES and path.read_bytes().startswith(b"%PDF")
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("kind", ["plane", "box", "orbit"])
def test_animation_is_a_gif_without_ffmpeg(kind, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    told, options = [], {"fps": 10, "frames": 7}
    path = flown(kind)[0].animate(tmp_path, **options, progress=lambda i, n: told.append((i, n)))
    assert path == tmp_path / "run.gif"
    with Image.open(path) as film:
        assert film.n_frames == 7 and film.info["duration"] == 100
        first = film.convert("RGB").tobytes()
        film.seek(6)
        assert film.convert("RGB").tobytes() != first
    assert told == [(i + 1, 7) for i in range(7)]
    assert find_drawn(tmp_path, flown(kind)[0].recorded.attrs["digest"]) == [path]


def test_animation_is_an_mp4_with_ffmpeg(tmp_path, monkeypatch):
    # A stand-in that keeps what it is sent: raw frames of four bytes a pixel.
    tool, said = tmp_path / "ffmpeg", tmp_path / "said"
    tool.write_text(f'#!/bin/sh\nfor last; do :; done\necho "$@" > {said}\nexec cat > "$last"\n')
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    path = flown("plane")[0].animate(tmp_path, fps=25, frames=3)
    assert path == tmp_path / "run.mp4"
    options = said.read_text().split()
    width, height = map(int, options[options.index("-s") + 1].split("x"))
    assert path.stat().st_size == 3 * 4 * width * height
    assert options[options.index("-framerate") + 1] == "25" and "yuv420p" in options


@pytest.mark.parametrize("method", ["plot", "animate"])
def test_a_full_disk_leaves_the_figures_and_the_film_that_were_there(method, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    options = {} if method == "plot" else {"frames": 2}
    before = {name: drawn_mark().encode() for name in ("run.gif", "stages.png", "old.png")}
    for name, content in before.items():
        (tmp_path / name).write_bytes(content)
    with file_size_limit(1000), pytest.raises(OSError, match="File too large") as caught:
        getattr(flown("plane")[0], method)(tmp_path, **options)
    assert caught.value.filename == str(tmp_path if method == "plot" else tmp_path / "run.gif")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_figures_and_films_of_another_run_do_not_stay_beside_a_run(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path / "nowhere"))
    (tmp_path / "mine.png").write_bytes(b"of my own")
    quoted = drawn_mark().join(["<p>".ljust(1 << 17), "".rjust(1 << 17)])
    (tmp_path / "mine.html").write_text(quoted)
    (tmp_path / "folder.pdf").mkdir()
    first, other = flown("pair")[0], flown("plane")[0]
    first.plot(tmp_path)
    first.animate(tmp_path, frames=2)
    drawn_files = set(find_drawn(tmp_path))
    assert {path.suffix for path in drawn_files} == {".png", ".gif"}
    first.save(tmp_path)  # they are its own
    assert set(find_drawn(tmp_path)) == drawn_files
    other.save(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["folder.pdf", "mine.html", "mine.png", "run.nc", "summary.json"]


def test_gif_stands_in_for_an_ffmpeg_that_fails_and_films_stay(tmp_path, monkeypatch):
    (tmp_path / "ffmpeg").write_text("#!/bin/sh\nhead -c 1000000 > /dev/null\nexit 1\n")
    (tmp_path / "ffmpeg").chmod(0o755)
    (tmp_path / "run.mp4").write_text("earlier")
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    for frames in (1, 9):  # it is seen at the end, or while it is written to
        with pytest.warns(UserWarning, match="ffmpeg could not write MP4, and GIF stands in"):
            assert flown("plane")[0].animate(tmp_path, frames=frames).name == "run.gif"
    names = ["ffmpeg", "run.gif", "run.mp4"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names
    assert (tmp_path / "run.mp4").read_text() == "earlier"


def test_film_moves_vehicles_on_cubic_pieces():
    run, evidence = flown("plane")
    film, h = SwarmFilm(run.scene()), evidence.mission.step
    film.draw_frame(3.25 * h)
    u = evidence.frames.applied_control[3, :6]
    x, v = evidence.frames.position[3, :6], evidence.frames.velocity[3, :6]
    there = x + v * h / 4 + u * (h / 4) ** 2 / 2
    moved = sorted(map(tuple, points(film.axes)))
    np.testing.assert_allclose(moved, sorted(map(tuple, there)), atol=1e-12)


def test_film_is_in_space_where_the_flight_is():
    for name, labels in (("box", "xyz"), ("orbit", "xyz"), ("flat orbit", "yx"), ("plane", "xy")):
        film = SwarmFilm(flown(name)[0].scene())
        got = [getattr(film.axes, f"get_{axis}label", str)()[:1] for axis in "xyz"]
        assert "".join(got) == labels
        film.draw_frame(float(film.frame_times(3)[1]))


def test_film_of_one_instant_shows_it():
    run, evidence = flown("only start")
    film = SwarmFilm(run.scene())
    film.draw_frame(float(film.frame_times(9)[0]))
    there = evidence.frames.position[0, evidence.frames.alive[0]]
    assert len(film.frame_times(9)) == 1
    assert sorted(map(tuple, points(film.axes))) == sorted(map(tuple, there))


def test_animation_without_frames_is_refused(tmp_path):
    with pytest.raises(ValueError, match="frames: must be an integer above 0, got 0"):
        flown("plane")[0].animate(tmp_path, frames=0)
