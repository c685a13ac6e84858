"""Formation scenarios as files: what they say, what they refuse, and that they can be repeated."""

import json
from dataclasses import fields

import numpy as np
import pytest
import tomli_w
from test_cli import call, sentence

import sato
from problems.gain_design import design_gains
from sato.formation import Formation
from sato.formation.mission import legacy_formation
from sato.scenario.file import parse, read, scenarios
from sato.shapes.formation_library import load_formation
from sato.shapes.graphs import random_dense_graph
from sato.shapes.random_points import sample_formation, sample_positions

SIX = """
system = "formation"
name = "six"

[swarm]
agents = 6
start = { kind = "random", box_m = [9, 9], separation_m = 1.5 }

[protocol]
hover_s = 1.0
limit_s = 60.0

[[leg]]
formation = { kind = "library", name = "swarm6/Star" }
graph = "own"
"""
RANDOM = 'leg.formation={kind="random", box_m=[8, 8, 2], separation_m=2}'
BUILT_IN = [name for name in scenarios() if name.startswith("formation")]


@pytest.fixture
def home(tmp_path, monkeypatch):
    (tmp_path / "six.toml").write_text(SIX)
    shape = load_formation("swarm6/Star")
    np.savetxt(tmp_path / "points.csv", shape.points, "%.17g", ",")
    np.savetxt(tmp_path / "edges.csv", np.argwhere(shape.graph), "%d", ",")
    (tmp_path / "lonely.csv").write_text("0,1\n1,2\n2,0\n3,4\n4,5\n5,3\n")
    (tmp_path / "cycle.csv").write_text("0,1\n1,2\n2,3\n3,4\n4,5\n5,0\n")
    design_gains(shape).save(tmp_path / "star.npz")
    design_gains(load_formation("swarm6/Star", "complete")).save(tmp_path / "complete.npz")
    design_gains(load_formation("swarm6/Hex")).save(tmp_path / "hex.npz")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def built(*settings, seed=1):
    return parse(SIX, settings).build(np.random.default_rng(seed))


def same(one, other):
    """Whether two missions are the same to the last bit."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return one == other


# What is wrong, and what the sentence must name: the place, and what would do.
REFUSED = {
    "an unknown key": ("swarm.agentz=6", ["swarm.agentz", "did you mean swarm.agents?"]),
    "a key without its unit": ("keep_out=1", ["keep_out", "write keep_out_m"]),
    "an area in metres": ("assignment.fineness_m=1", ["fineness_m", "write fineness"]),
    "too few vehicles": ("agents=2", ["swarm.agents", "at least 3"]),
    "more vehicles than points": ("agents=7", ["leg.0.formation", "7 vehicles", "6 points"]),
    "no kind of start": ("start={kind='ringg'}", ["swarm.start", 'did you mean "ring"?']),
    "a start with no room": (
        "start={kind='random', box_m=[2, 2], separation_m=1.5}",
        ["swarm.start.box_m", "full after", "would do"],
    ),
    "a start in three sides": ("start.box_m=[9, 9, 9]", ["swarm.start.box_m", "2 sides", "3"]),
    "a start within the keep-out": (
        "start.separation_m=1",
        ["swarm.start.separation_m", "keep_out_m = 1.2", "1.2 or more would do"],
    ),
    "a start one above another": (
        "start={kind='points', positions_m=[[0,0,1],[0,1,4],[9,0,1],[0,9,1],[9,9,1],[5,5,1]]}",
        ["swarm.start", "vehicles 0 and 1", "1 m apart in the plane", "move one of them"],
    ),
    "a start in motion": (
        "start={kind='points', positions_m=[[0,0]], velocities_m_s=[[1,0]]}",
        ["swarm.start.velocities_m_s", "at rest"],
    ),
    "braking that nobody can": ("brake_m_s2=0.6", ["avoidance.brake_m_s2", "0.5"]),
    "others noticed too late": ("notice_m=2", ["avoidance.notice_m", "2.25 would do"]),
    "an upright printed law": (
        "avoidance={legacy_avoidance=true}\ncontrol={upright=true}",
        ["control.upright", "mirror image", "upright = false"],
    ),
    "an auction that cannot end": (
        "radio.loss=0.1",
        ["assignment.kind", '"vsdaa"', '"cbaa"', "would do"],
    ),
    "a loss of everything": ("radio.loss=1.0", ["radio.loss", "less than 1"]),
    "messages between control steps": ("rate_hz=60", ["radio.rate_hz", "50 would do"]),
    "messages too often": ("rate_hz=1000", ["radio.rate_hz", "50 would do"]),
    "a push of nobody": (
        "push=[{vehicle=6, start_s=0, end_s=1, velocity_m_s=[1,0,0]}]",
        ["push.0", "no vehicle 6", "0 to 5"],
    ),
    "a push that ends before it starts": (
        "push=[{vehicle=1, start_s=2, end_s=1, velocity_m_s=[1,0,0]}]",
        ["push.0", "never begins"],
    ),
    "a push in the plane": (
        "push=[{vehicle=1, start_s=0, end_s=1, velocity_m_s=[1,0]}]",
        ["push.0.velocity_m_s", "3 coordinates", "got 2"],
    ),
    "two pushes at a time": (
        "push=[{vehicle=1, start_s=5, end_s=9, velocity_m_s=[1,0,0]},"
        "{vehicle=2, start_s=4, end_s=6, velocity_m_s=[1,0,0]}]",
        ["push.0.start_s", "one stick", "6 would do"],
    ),
    "no legs": ("leg=[]", ["leg", "at least 1"]),
    "a name not in the library": (
        "leg.formation.name=Stahr",
        ["leg.0.formation", 'no formation "Stahr"', "swarm6/Star"],
    ),
    "a formation closer than the keep-out": (
        "leg.formation={kind='ring', radius_m=1.0}",
        ["leg.0.formation", "1.2 m", "would do"],
    ),
    "a formation drawn closer than that": (
        "leg.formation={kind='random', box_m=[9, 9, 1], separation_m=1}",
        ["leg.0.formation.separation_m", "keep_out_m = 1.2"],
    ),
    "a formation with no room": (
        "leg.formation={kind='random', box_m=[2, 2, 1], separation_m=2}",
        ["leg.0.formation", "full after", "would do"],
    ),
    "a formation drawn in the plane": (
        "leg.formation={kind='random', box_m=[9, 9], separation_m=2}",
        ["leg.0.formation", "three sides"],
    ),
    "a formation one above another": (
        "leg.formation={kind='ring', radius_m=9, normal=[1, 0, 0]}",
        ["leg.0.formation", "apart in the plane", "keep-out of 1.2 m"],
    ),
    "points of a file that is not there": (
        "leg.formation={kind='file', file='none.csv'}",
        ["leg.0.formation", "none.csv"],
    ),
    "an unknown graph": ("leg.graph=complet", ["leg.0.graph", 'did you mean "complete"?']),
    "an own graph of none": (RANDOM, ["leg.0.graph", "library", '"complete" would do']),
    "a graph in parts": ("leg.graph={file='lonely.csv'}", ["leg.0.graph", "0, 1, 2"]),
    "a graph too thin": (
        "leg.graph={kind='pairs', pairs=[[0,1],[1,2],[2,3],[3,4],[4,5]]}",
        ["leg.0.graph", "too sparse", "0, 5"],
    ),
    "a graph of points that are not there": (
        "leg.graph={kind='pairs', pairs=[[0,6]]}",
        ["leg.0.graph.pairs", "[0, 6]", "0 to 5"],
    ),
    "a graph of nothing": ("leg.graph={kind='pairs', pairs=[]}", ["leg.0.graph.pairs", "no pairs"]),
    "a share that does not hold": (
        "leg.graph={kind='sparse', share=0.1}",
        ["leg.0.graph", "share", "would do"],
    ),
    "a graph without gains": (
        "leg.graph={file='cycle.csv'}",
        ["leg.0.graph", "no gains stabilise", "swarm6/Star", "by proof", "add edges"],
    ),
    "gains of another shape": (
        "leg.gains={file='hex.npz'}",
        ["leg.0.gains.file", "hex.npz", "other points", "`sato gains`"],
    ),
    "gains of another graph": (
        "leg.gains={file='complete.npz'}",
        ["leg.0.gains.file", "other graph"],
    ),
    "gains that are points": ("leg.gains={file='points.csv'}", ["leg.0.gains.file", "points.csv"]),
    "gains that are not there": ("leg.gains={file='none.npz'}", ["leg.0.gains.file", "none.npz"]),
    "a method that is none": ("leg.gains=magic", ["leg.0.gains", '"magic"', "auto"]),
    "gains of a few numbers": (
        "leg.gains={kind='listed', edges=[[0, 1, 2]], bounds=[1, 1], method='mine'}",
        ["leg.0.gains", "five numbers an edge"],
    ),
    "gains of nobody": (
        "leg.gains={kind='listed', edges=[[0, 6, 1, 0, 1]], bounds=[1, 1], method='mine'}",
        ["leg.0.gains.edges", "0 to 5"],
    ),
    "gains that are made up": (
        "leg.gains={kind='listed', edges=[[0, 2, 1, 0, 1]], bounds=[1, 1], method='mine'}",
        ["leg.0.gains", "do not belong to this formation"],
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_flown_is_refused_in_a_sentence_before_anything_is_written(home, case):
    settings, words = REFUSED[case]
    sets = [word for setting in settings.split("\n") for word in ("--set", setting)]
    refused = call("run", "six.toml", "--out", "there", *sets)
    assert refused.exit_code == 2, refused.output
    said = sentence(refused)
    assert said.startswith(("sato: six.toml: ", "sato: --set"))
    for word in words:
        assert word in said
    assert not (home / "there").exists()


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_built_in_scenario_says_what_it_shows_and_writes_itself_whole(name):
    assert len(scenarios()[name]) > 20
    scenario = read(name)
    assert scenario.name == name
    text = scenario.to_toml()
    assert parse(text).to_toml() == text


def test_there_are_scenarios_of_one_transition_a_hundred_vehicles_six_and_the_printed_code():
    assert BUILT_IN == ["formation", "formation100", "formation6", "formation_printed"]


def test_what_is_not_said_is_as_the_flight_has_it():
    mission = built()
    plain = Formation(mission.start, mission.gains, mission.frames)
    hover = {"hover": mission.protocol.hover_time, "limit": mission.protocol.time_limit}
    assert same(mission.protocol, plain.supervision._replace(**hover))
    for name in ("law", "avoidance", "limits", "assigning", "radio", "step", "every", "pushes"):
        assert same(getattr(mission, name), getattr(plain, name)), name


@pytest.mark.parametrize("kind", ["cbaa", "hungarian", "none"])
def test_the_printed_code_is_one_key_and_what_is_said_beside_it_counts(kind):
    settings = ["legacy_avoidance=true", f"assignment.kind={kind}"]
    mission = built(*settings)
    printed = legacy_formation(mission.start, mission.gains, kind)
    hover = {"hover": mission.protocol.hover_time, "limit": mission.protocol.time_limit}
    assert same(mission.protocol, printed.supervision._replace(**hover))
    for name in ("law", "avoidance", "limits", "assigning", "radio", "step", "every"):
        assert same(getattr(mission, name), getattr(printed, name)), name
    assert np.array_equal(mission.frames.rotation, printed.coordinate_frames.rotation)
    assert not mission.frames.offset.any() and not mission.frames.drift.any()
    assert mission.frames.noise == printed.coordinate_frames.noise
    other = built(*settings, "protocol.settled_mm_s=300", "frames.noise_m=0", "yaw=random")
    assert other.protocol.settled == pytest.approx(0.3) and other.frames.noise == 0
    assert not np.array_equal(other.frames.rotation, printed.coordinate_frames.rotation)


def test_whoever_watches_looks_fifty_times_a_second_however_fine_the_control():
    for step, every in ((0.02, 1), (0.01, 2), (0.004, 5), (0.1, 1)):
        mission = built(f"step_s={step}", "rate_hz=10")
        assert mission.every == every


def test_vehicles_beyond_a_byte_have_longer_numbers():
    start = "start={kind='random', box_m=[90, 90], separation_m=2}"
    shape = "leg.formation={kind='ring', spacing_m=2}"
    mission = built("agents=257", start, shape, "leg.graph=complete")
    assert mission.radio.number == 9


def test_first_the_start_is_drawn_then_points_and_graph_of_each_leg_then_frames():
    text = SIX.replace(SIX[SIX.index("[[leg]]") :], "")
    leg = '[[leg]]\nformation={kind="random", box_m=[9, 9, 2], separation_m=2}\n'
    graph = 'graph={kind="thinned", removals=2}\n'
    mission = parse(text + 2 * (leg + graph)).build(np.random.default_rng(5))
    rng = np.random.default_rng(5)
    assert np.array_equal(mission.start[:, :2], sample_positions(6, (9, 9), 1.5, rng))
    assert (mission.start[:, 2] == 1).all()
    for gains in mission.gains:
        assert np.array_equal(gains.formation.points, sample_formation(6, (9, 9, 2), 2.0, rng))
        assert np.array_equal(gains.formation.graph, random_dense_graph(6, 2, rng))


def test_points_graph_and_gains_come_from_files_beside_the_scenario(home, monkeypatch):
    leg = "formation={file='points.csv'}\ngraph={file='edges.csv'}\ngains={file='star.npz'}\n"
    (home / "files.toml").write_text(SIX.replace(SIX[SIX.index("formation = {") :], leg))
    monkeypatch.chdir("/")
    mission, own = read(home / "files.toml").build(np.random.default_rng(1)), built()
    [found], [library] = mission.gains, own.gains
    assert np.array_equal(found.formation.points, library.formation.points)
    assert np.array_equal(found.formation.graph, library.formation.graph)
    np.testing.assert_allclose(found.xy, library.xy, atol=1e-12)
    np.testing.assert_allclose(found.z, library.z, atol=1e-12)
    assert (found.method, found.bound_xy) == (library.method, library.bound_xy)


def test_a_scenario_from_files_is_written_whole_and_gives_the_same_to_the_last_bit(home):
    np.savetxt(home / "start.csv", 3.0 * load_formation("swarm6/Hex").points, "%.17g", ",")
    scenario = read(
        "six.toml",
        [
            "start={kind='points', file='start.csv'}",
            "leg.formation={file='points.csv'}",
            "leg.graph={file='edges.csv'}",
            "leg.gains={file='star.npz'}",
        ],
    )
    mission = scenario.build(np.random.default_rng(3))
    text = scenario.to_toml()
    for file in home.glob("*.*"):
        file.unlink()
    assert "file" not in text
    again = parse(text).build(np.random.default_rng(3))
    names = [f.name for f in fields(Formation) if f.name != "shapes"]
    assert all(same(getattr(mission, name), getattr(again, name)) for name in names)
    [one], [other] = mission.gains, again.gains
    assert np.array_equal(one.xy, other.xy) and np.array_equal(one.z, other.z)
    assert one.matches_formation(other.formation)


@pytest.mark.parametrize(
    "shape",
    [
        "{kind='text', text='I', height_m=9}",
        "{kind='ring', spacing_m=2}",
        "{kind='lattice', spacing_m=2}",
        "{kind='polygon', vertices_m=[[0,0],[9,0],[0,9]]}",
        "{kind='points', positions_m=[[0,0],[2,0],[4,0],[0,2],[2,2],[4,3]]}",
        "{kind='random', box_m=[9, 9, 0], separation_m=2}",
    ],
)
@pytest.mark.parametrize("graph", ["complete", "{kind='thinned', removals=1}"])
def test_any_shape_will_do_on_any_graph_and_nobody_is_above_another(shape, graph):
    mission = built(f"leg.formation={shape}", f"leg.graph={graph}")
    points = mission.gains[0].formation.points
    assert points.shape == (6, 3) and not points[:, 2].any()
    assert mission.gains[0].rate > 0


def test_frames_may_agree_in_yaw_alone_and_the_rest_is_drawn_the_same():
    one, other = built(), built("yaw=aligned")
    assert (other.coordinate_frames.rotation == 1).all() and not (
        one.coordinate_frames.rotation == 1
    ).any()
    assert np.array_equal(one.start, other.start)
    assert np.array_equal(one.frames.offset, other.frames.offset)
    assert np.abs(one.frames.offset).max() <= 10
    np.testing.assert_allclose(np.linalg.norm(one.frames.drift, axis=1), 0.01)


def test_pushes_are_those_of_the_file():
    [push] = built(
        "push=[{vehicle=2, start_min=0.1, end_s=9, velocity_m_s=[0, 0.3, 0]}]"
    ).operator_commands
    assert (push.vehicle, push.start, push.end) == (2, 6.0, 9.0)
    assert push.velocity.tolist() == [0, 0.3, 0]


def test_of_what_does_not_keep_vehicles_apart_is_warned():
    for settings, words in (
        (["legacy_avoidance=true"], "does not keep vehicles apart"),
        (["margin_m=0.03"], "twice frames.noise_m = 0.02.* 0.05 would do"),
    ):
        scenario = parse(SIX, settings)
        with pytest.warns(UserWarning, match=words):
            scenario.warn(scenario.build(np.random.default_rng(0)))
    parse(SIX).warn(built())


def test_the_same_seed_gives_the_same_run_also_from_its_own_text(home):
    first, again = (sato.run("six.toml", seed=4) for _ in range(2))
    assert first.summary["success"] and first.summary["broken"] == []
    assert first.data.attrs["digest"] == again.data.attrs["digest"]
    third = sato.run(parse(first.data.attrs["scenario"]), seed=4)
    assert third.data.attrs["digest"] == first.data.attrs["digest"]
    assert sato.run("six.toml", seed=5).data.attrs["digest"] != first.data.attrs["digest"]


def test_a_run_from_the_command_line_is_judged_and_its_verdict_is_the_exit_code(home):
    flown = call("run", "six.toml", "--out", "there", "--seed", "4")
    assert flown.exit_code == 0, flown.output
    assert flown.stderr.startswith("leg 1 of 1 at 0 s: 1 component, least separation ")
    assert "waiting" in flown.stderr and "shape error, m" in flown.stdout
    said = json.loads((home / "there" / "summary.json").read_text())
    assert said["system"] == "formation" and len(said["legs"]) == 1
    assert call("check", "there").exit_code == 0
    short = call("run", "six.toml", "--out", "short", "--set", "limit_s=4", "--quiet")
    assert short.exit_code == 1
    assert json.loads((home / "short" / "summary.json").read_text())["success"] is False
    assert call("check", "short").exit_code == 0  # it says of itself what it came to


def test_the_tables_are_plain_toml():
    text = parse(SIX).to_toml()
    assert tomli_w.dumps(parse(text).model_dump(exclude_none=True)) == text
