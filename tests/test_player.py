"""Player of a run: its page shows what the run file holds, in a browser without a network."""

import json
import shutil
import struct
import zlib
from dataclasses import replace
from functools import cache

import formation_runs
import numpy as np
import pytest
from connectivity_cast import connected_poses, fly, posed, spheres
from playwright.sync_api import sync_playwright
from recorded_run import make_mission, record_run, recorded
from test_reconfiguration_figures import orbit

import sato
from problems.alignment import compute_shape_error
from sato.connectivity.mission import AgentLoss
from sato.network.graph import CommunicationGraph
from sato.player.encode import MISSING, encode_scene
from sato.player.page import write_player
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.scene import interpolate_positions
from sato.record import RunFileError
from sato.run_data import RunData
from sato.runs import Run
from sato.scenario.errors import InputError
from sato.scene import ALIVE, LOST, Links, enclose_obstacle
from sato.systems import load_system

CHROMIUM = shutil.which("chromium")
FLAGS = [
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
WRECKS = {
    "system": "reconfiguration",
    "name": "wrecks",
    "swarm": {
        "start": {"kind": "points", "positions_m": [[0, 0], [2, 0], [4, 0], [6, 0]]},
        "comm_radius_m": 5.0,
        "collision_radius_m": 0.5,
    },
    "model": {"kind": "double_integrator", "max_control_m_s2": 0.1, "max_speed_m_s": 0.5},
    "plan": {"step_s": 1.0, "horizon_steps": 4},
    "leg": [
        {"shape": {"kind": "ring", "spacing_m": 2.0}, "steps": 20},
        {
            "shape": {"kind": "ring", "spacing_m": 2.5},
            "steps": 20,
            "lose": {"kind": "agents", "agents": [1], "body": "coast"},
        },
    ],
    "obstacle": [{"kind": "box", "low_m": [20.0, 20.0], "high_m": [21.0, 22.0]}],
}


@cache
def flown(name):
    """Fly a small run; return its data and its drawn mission."""
    if name == "plane":
        run = recorded(make_mission())
        return run.recorded, run.mission
    if name == "orbit":
        run = recorded(orbit())
        return run.recorded, run.mission
    if name == "wrecks":
        run = sato.run(WRECKS)
        return run.recorded, run.drawn_mission
    if name == "formation":
        mission, frames = formation_runs.fly("protocol.limit_s=9")
        return formation_runs.dataset(mission, frames), mission
    rng = np.random.default_rng(4)
    obstacles = spheres([(20.0, 20.0, 3.0, 1.0)])
    mission = posed(
        *connected_poses(rng),
        duration=1.0,
        obstacles=obstacles,
        losses=(AgentLoss(5, 0.5),),
    )
    system = load_system("connectivity")
    return record_run(system, fly(mission), mission).recorded, mission


NAMES = ["plane", "orbit", "wrecks", "formation", "connectivity"]


@cache
def shown(name):
    """Return the scene of a small run."""
    data, mission = flown(name)
    return load_system(data.attrs["system"]).scene(data, mission)


def decode(contents):
    """Decode what is written for the page: its header, and a function that reads an array."""
    body = zlib.decompress(contents)
    (length,) = struct.unpack_from("<I", body)
    header = json.loads(body[4 : 4 + length])

    def read(about):
        shape, start = about["shape"], 4 + length + about["start"]
        count = int(np.prod(shape))
        low, high = np.frombuffer(body, np.uint8, 2 * count, start).reshape(2, -1).astype(int)
        steps = (low + 256 * high).reshape(-1, shape[0]).T
        codes = np.cumsum(np.cumsum(steps, axis=0), axis=0).astype(np.uint16)
        values = np.where(
            codes == MISSING, np.nan, about["scale"] * (about["first"] + codes.astype(float))
        )
        return values.reshape(shape)

    return header, read


@pytest.mark.parametrize("name", NAMES)
def test_encoded_states_are_within_the_stated_error(name):
    scene = shown(name)
    header, read = decode(encode_scene(scene, {}))
    d = scene.position.shape[2]
    for key, values in (("position", scene.position), ("velocity", scene.velocity)):
        found, error = read(header[key]), header[key]["error"]
        assert error <= 1e-5 * np.ptp(values)
        np.testing.assert_allclose(found[..., :d], values, rtol=0, atol=error * (1 + 1e-9))
        assert not found[..., d:].any()
    assert header["time"] == pytest.approx(scene.time.tolist())
    for key in ("status", "held"):
        about = header["status"] if key == "status" else header["targets"]["held"]
        expected = scene.status if key == "status" else scene.targets.held
        np.testing.assert_array_equal(read(about), expected)
    for about, coloring in zip(header["colorings"], scene.colorings, strict=True):
        error = about["values"]["error"] * (1 + 1e-9)
        np.testing.assert_allclose(read(about["values"]), coloring.values, rtol=0, atol=error)


def test_long_runs_are_thinned_evenly_and_the_page_is_told(monkeypatch):
    scene = shown("connectivity")
    monkeypatch.setattr("sato.player.encode.MAX_STATES", scene.status.size // 3)
    header, read = decode(encode_scene(scene, {}))
    every = header["every"]
    assert 3 <= every <= 4
    assert header["time"] == pytest.approx(scene.time[::every].tolist())
    links, pairs = header["links"], read(header["links"]["pairs"]).reshape(-1, 2)
    ends = np.cumsum(links["count"])
    for k in range(0, len(scene.time), every):
        entry = np.searchsorted(links["first"], k // every, side="right") - 1
        found = pairs[ends[entry] - links["count"][entry] : ends[entry]]
        weights = flown("connectivity")[0]["edge_weight"][k]
        np.testing.assert_array_equal(found, np.argwhere(np.triu(weights, 1) > 0))


def test_status_tells_live_vehicles_wrecks_and_those_that_are_gone():
    scene, (data, _) = shown("wrecks"), flown("wrecks")
    lost = data["time"] >= 20.0
    assert (scene.status[lost, 1] == LOST).all() and (scene.status[~lost, 1] == ALIVE).all()
    assert (np.delete(scene.status, 1, axis=1) == ALIVE).all()
    plane = shown("plane").status
    np.testing.assert_array_equal(plane == ALIVE, flown("plane")[0]["alive"])
    assert not (plane == LOST).any()
    np.testing.assert_array_equal(
        shown("connectivity").status == LOST, ~flown("connectivity")[0]["alive"]
    )


def test_formation_links_join_neighbors_and_points_fit_their_holders():
    scene, (data, mission) = shown("formation"), flown("formation")
    firsts = [first for first, _ in scene.links.listed]
    assigned = np.flatnonzero((scene.targets.held >= 0).all(axis=1))
    assert len(assigned) > 10
    for k in assigned[:: len(assigned) // 5]:
        held, formation = scene.targets.held[k], mission.gains[int(data["leg_index"][k])].formation
        pairs = scene.links.listed[int(np.searchsorted(firsts, k, side="right")) - 1][1]
        graph = np.zeros_like(formation.graph)
        graph[held[pairs[:, 0]], held[pairs[:, 1]]] = True
        np.testing.assert_array_equal(graph | graph.T, formation.graph)
        off = data["position"][k] - scene.targets.position[k, held]
        fit = compute_shape_error(data["position"][k], formation.points[held])
        assert np.linalg.norm(off) / np.sqrt(len(off)) == pytest.approx(fit.error, rel=0.5)


@pytest.mark.parametrize("axes", [2, 3])
def test_hull_of_an_obstacle_faces_outward_and_encloses_it(axes):
    sphere = sato.obstacles.Sphere((1.0, 2.0, 3.0)[:axes], 0.5)
    hull = enclose_obstacle(sphere)
    corners = hull.vertices[hull.triangles] - sphere.place
    np.testing.assert_allclose(np.linalg.norm(hull.vertices - sphere.place, axis=1), 0.5)
    if axes == 3:
        volume = np.linalg.det(corners).sum() / 6
        assert volume == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=0.05)
    else:
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
        assert area == pytest.approx(np.pi * 0.5**2, rel=0.05)


def test_run_without_instants_is_refused_in_a_sentence():
    data, mission = flown("formation")
    empty = {
        name: v._replace(values=v.values[:0]) if "time" in v.dims else v
        for name, v in data.variables.items()
    }
    with pytest.raises(RunFileError, match="the run has no instants, and nothing can be shown"):
        Run(RunData(empty, data.attrs), {}, mission).scene()


def test_constants_and_unknown_numbers_are_encoded_exactly():
    scene = shown("plane")
    for constant in (0.3, -7.1, 0.0, np.nan):
        series = (scene.series[0]._replace(values=np.full(len(scene.time), constant)),)
        header, read = decode(encode_scene(replace(scene, series=series), {}))
        np.testing.assert_array_equal(read(header["series"][0]["values"]), series[0].values)


def test_a_scene_in_which_none_are_linked_is_encoded():
    listed = ((0, np.zeros((0, 2), dtype=int)),)
    scene = replace(shown("plane"), links=Links("links", listed=listed))
    header, _ = decode(encode_scene(scene, {}))
    assert header["links"]["count"] == header["links"]["pairs"]["shape"] == [0]


def test_run_of_a_system_without_scenes_is_refused_in_a_sentence(monkeypatch):
    data, mission = flown("plane")
    bare = replace(load_system("reconfiguration"), scene=None)
    monkeypatch.setattr("sato.runs.load_system", lambda name: bare)
    with pytest.raises(InputError, match="runs of reconfiguration have no scene"):
        Run(data, {}, mission).scene()


def test_recording_for_rerun_holds_positions_and_links(tmp_path):
    reason = 'Rerun is not installed; pip install "sato-swarm[rerun]" installs it'
    reader = pytest.importorskip("rerun.chunk", reason=reason).RrdReader
    data, mission = flown("wrecks")
    scene, found = shown("wrecks"), {"/vehicles": {}, "/lost": {}, "/links": {}}
    path = Run(data, {}, mission).export(tmp_path / "run.rrd", "rrd")
    columns = {"/links": "LineStrips3D:strips"}
    for chunk in reader(path).stream():
        if chunk.entity_path in found:
            rows = chunk.to_record_batch().to_pydict()
            values = rows[columns.get(chunk.entity_path, "Points3D:positions")]
            times = [time.total_seconds() for time in rows["time"]]
            found[chunk.entity_path] |= dict(zip(times, values, strict=True))
    for k, time in enumerate(scene.time.tolist()):
        alive, lost = scene.status[k] == ALIVE, scene.status[k] == LOST
        for name, which in (("/vehicles", alive), ("/lost", lost)):
            place = np.reshape(found[name][time], (-1, 3))
            np.testing.assert_allclose(place[:, :2], scene.position[k, which], rtol=1e-6)
        graph = CommunicationGraph.from_positions(scene.position[k], mission.comm_radius, alive)
        assert len(found["/links"][time]) == len(graph.pairs[0])


def test_recording_without_rerun_is_refused_with_the_install_line(tmp_path, monkeypatch):
    monkeypatch.setattr("sato.export.find_spec", lambda name: None)
    data, mission = flown("plane")
    with pytest.raises(InputError, match=r'pip install "sato-swarm\[rerun\]" would do'):
        Run(data, {}, mission).export(tmp_path / "run.rrd", "rrd")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("there is no Chromium; `apt-get install chromium` installs one")
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a function that writes the page of a run, once."""
    folder = tmp_path_factory.mktemp("pages")

    @cache
    def write(name):
        return write_player(shown(name), flown(name)[0].attrs, folder / f"{name}.html")

    return write


@pytest.fixture
def visit(browser, files):
    """Return a function that opens the page of a run; nothing may be fetched or said."""
    page, heard = browser.new_page(viewport={"width": 1280, "height": 720}), []
    page.on("request", lambda request: heard.append(request.url))
    page.on("console", lambda message: heard.append(message.text))
    page.on("pageerror", lambda error: heard.append(str(error)))

    def opened(name):
        page.goto(files(name).as_uri())
        page.wait_for_function("window.player")
        return page

    yield opened
    page.close()
    assert [text for text in heard if not text.startswith(("file:", "data:"))] == []
    assert sum(text.startswith("file:") for text in heard) == 1


def places(page, time):
    """Seek a time; return the positions that are shown."""
    found = page.evaluate("t => (player.seek(t), Array.from(player.view.points))", float(time))
    return np.reshape(found, (-1, 3))


@pytest.mark.parametrize("name", NAMES)
def test_positions_shown_are_those_of_the_run(name, visit):
    scene, page = shown(name), visit(name)
    d, error = scene.position.shape[2], page.evaluate("player.run.error")
    instants = np.linspace(0, len(scene.time) - 1, 4).astype(int)
    for k in instants:
        found = places(page, scene.time[k])
        np.testing.assert_allclose(found[:, :d], scene.position[k], rtol=1e-6, atol=1.01 * error)
        assert not found[:, d:].any()
        drawn = page.evaluate("Array.from(player.view.bodies.geometry.attributes.size.array)")
        np.testing.assert_array_equal(np.array(drawn) > 0, scene.status[k] > 0)
    assert page.title() == page.inner_text("h1")


def test_vehicles_move_on_the_cubic_pieces_of_the_trajectories(visit):
    data, mission = flown("plane")
    evidence, page = ReconfigurationRecord.from_data(data, mission), visit("plane")
    [expected] = interpolate_positions(evidence, np.array([4.5]))
    found = places(page, 4.5 * mission.step)[:, :2]
    there = np.isfinite(expected[:, 0])
    np.testing.assert_allclose(found[there], expected[there], atol=1e-3)


def test_play_moves_on_until_paused_and_starts_again_at_the_end(visit):
    page = visit("connectivity")
    before = page.inner_text("#time")
    page.keyboard.press("Space")
    page.wait_for_function("player.time > 0.1")
    page.click("#play")
    paused = page.inner_text("#time")
    assert paused != before and page.inner_text("#play") == "Play"
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.inner_text("#time") == paused
    page.keyboard.press("End")
    assert page.inner_text("#time") == "1 s of 1 s"
    page.click("#play")
    page.wait_for_function("player.time < 0.5")


def test_keys_step_jump_between_events_and_change_the_view(visit):
    page, time = visit("plane"), shown("plane").time
    page.keyboard.press("ArrowRight")
    assert page.evaluate("player.time") == pytest.approx(time[1])
    page.keyboard.press("]")
    assert page.inner_text("#event") == "3 s: replan, 6 vehicles: 0, 1, 2, 3, 4, 5"
    page.keyboard.press("Home")
    assert page.evaluate("player.time") == time[0]
    before = page.evaluate("player.view.camera.position.toArray()")
    page.keyboard.press("3")
    assert page.evaluate("player.view.camera.position.toArray()") != before
    page.fill("#seek", "6")
    assert page.evaluate("player.time") == pytest.approx(6, abs=0.1)


@pytest.mark.parametrize("name", ["wrecks", "formation", "connectivity"])
def test_every_coloring_differs_and_lost_vehicles_are_gray(name, visit):
    scene, page = shown(name), visit(name)
    places(page, scene.time[-1])
    seen = []
    for number, coloring in enumerate(scene.colorings):
        page.select_option("#coloring", str(number))
        colors = np.reshape(page.evaluate("Array.from(player.painter.colors)"), (-1, 3))
        gray = 0x8C / 255
        np.testing.assert_allclose(colors[scene.status[-1] == LOST], gray, atol=1e-6)
        live, values = scene.status[-1] == ALIVE, coloring.values[-1]
        if coloring.categories:
            names = [coloring.categories[int(value)][1] for value in values[live]]
            rgb = [[int(name[i : i + 2], 16) / 255 for i in (1, 3, 5)] for name in names]
            np.testing.assert_allclose(colors[live], rgb, atol=1e-6)
        elif coloring.is_target:
            assert len(np.unique(colors[live], axis=0)) == len(np.unique(values[live]))
        seen.append(colors.tobytes())
    assert len(set(seen)) >= len(seen) - (name == "formation")  # where one component is all


@pytest.mark.parametrize("name", ["plane", "connectivity"])
def test_links_shown_are_those_of_the_graph(name, visit):
    scene, page, (data, mission) = shown(name), visit(name), flown(name)
    page.set_checked("#show-links", True)
    for k in (0, len(scene.time) // 2, len(scene.time) - 1):
        places(page, scene.time[k])
        found = np.reshape(page.evaluate("player.view.pairs"), (-1, 2)).astype(int)
        graph = np.zeros((scene.status.shape[1],) * 2, dtype=bool)
        graph[found[:, 0], found[:, 1]] = True
        if name == "plane":
            alive = scene.status[k] == ALIVE
            near = CommunicationGraph.from_positions(
                scene.position[k], mission.comm_radius, alive
            ).adjacency
        else:
            near = data["edge_weight"][k] > 0
        np.testing.assert_array_equal(graph | graph.T, near)


def test_clicked_vehicle_is_followed_by_the_camera(visit):
    page = visit("wrecks")
    x, y = page.evaluate(
        """() => {
          const { view } = player, box = view.canvas.getBoundingClientRect();
          const at = new THREE.Vector3().fromArray(view.points, 3 * 2).project(view.camera);
          return [box.x + (at.x + 1) * box.width / 2, box.y + (1 - at.y) * box.height / 2];
        }"""
    )
    page.mouse.click(x, y)
    assert page.input_value("#follow") == "2"
    assert "speed: " in page.inner_text("#details")
    offset = "player.view.camera.position.toArray().map((v, i) => v - player.view.points[6 + i])"
    before = page.evaluate(offset)
    places(page, 12.0)
    np.testing.assert_allclose(page.evaluate(offset), before, atol=1e-3)
    page.keyboard.press("Escape")
    assert page.input_value("#follow") == "-1"


def test_name_of_a_scenario_is_text_and_never_markup(browser, tmp_path):
    attributes = dict(flown("plane")[0].attrs) | {"name": "</title><b>@DATA@</b>"}
    path = write_player(shown("plane"), attributes, tmp_path / "new" / "page.html")
    page = browser.new_page()
    page.goto(path.as_uri())
    page.wait_for_function("window.player")
    assert page.inner_text("h1") == page.title() == "</title><b>@DATA@</b>, seed 3"
    page.close()
