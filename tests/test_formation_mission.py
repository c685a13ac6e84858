"""Formation missions: keys, refusals, defaults, order of draws and round trips."""

import numpy as np
import pytest

from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.formation.leg import FormationLeg
from sato.formation.mission import Formation, legacy_formation
from sato.formation.settings import AssignmentSettings, FrameSettings, SupervisorSettings
from sato.scenario.errors import InputError, ScenarioError
from sato.scenario.file import parse, read, scenarios
from sato.shapes import Ring
from sato.shapes.formation_library import load_formation, random_dense_graph
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
START_FILE = "start = { kind = 'points', file = 'start.csv' }"
BUILT_IN = [name for name in scenarios() if name.startswith("formation")]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenario")
    (folder / "six.toml").write_text(SIX)
    star = load_formation("swarm6/Star")
    np.savetxt(folder / "points.csv", star.points, "%.17g", ",")
    np.savetxt(folder / "start.csv", 3 * load_formation("swarm6/Hex").points, "%.17g", ",")
    np.savetxt(folder / "edges.csv", np.argwhere(star.graph), "%d", ",")
    (folder / "lonely.csv").write_text("0,1\n1,2\n2,0\n3,4\n4,5\n5,3\n")
    (folder / "cycle.csv").write_text("0,1\n1,2\n2,3\n3,4\n4,5\n5,0\n")
    design_gains(star).save(folder / "star.npz")
    design_gains(load_formation("swarm6/Star", "complete")).save(folder / "complete.npz")
    design_gains(load_formation("swarm6/Hex")).save(folder / "hex.npz")
    return folder


def drawn(*overrides, seed=1):
    return parse(SIX, overrides).draw(np.random.default_rng(seed))


def push(vehicle=1, start=0, end=1, velocity="[1, 0, 0]"):
    return f"{{vehicle={vehicle}, start_s={start}, end_s={end}, velocity_m_s={velocity}}}"


def listed(edges):
    return f"leg.gains={{kind='listed', edges=[{edges}], bounds=[1, 1], method='mine'}}"


STACKED = "[[0,0,1],[0,1,4],[9,0,1],[0,9,1],[9,9,1],[5,5,1]]"
STILL = "{kind='points', positions_m=[[0,0]], velocities_m_s=[[1,0]]}"
REFUSED = {  # what is wrong: the key, and a value that would do
    "agents=2": "swarm.agents.* at least 3",
    "agents=7": "leg.0.formation.* 7 vehicles .* 6 points",
    "start={kind='random', box_m=[2, 2], separation_m=1.5}": "start.box_m.* full .* would do",
    "start.box_m=[9, 9, 9]": "swarm.start.box_m: must have at most 2 items, not 3",
    "start.separation_m=1": "start.separation_m.* keep_out_m = 1.2; 1.2 or more would do",
    f"start={{kind='points', positions_m={STACKED}}}": "start: 0 and 1 are 1 m apart in the plane",
    "start={kind='points', positions_m=[[0,0]]}": "start.positions_m: lists 1 .* 6 agents",
    f"start={STILL}": "start.velocities_m_s: vehicles start at rest",
    "start={kind='ring', radius_m=1}": "swarm.start.* would do",
    "drift=-1": "frames.drift: must not be negative, got -1",
    "yaw=[0.5]": r"frames.yaw: needs the shape \(6,\), got \(1,\)",
    "brake_m_s2=0.6": "avoidance.brake_m_s2.* 0.5",
    "notice_m=2": "avoidance.notice_m.* 2.25 would do",
    "avoidance={legacy_avoidance=true}\ncontrol={upright=true}": "control.upright.* mirror image",
    "radio.loss=0.1": 'assignment.kind: "vsdaa" .*"cbaa" would do',
    "link.loss=0.1": 'assignment.kind: "vsdaa" .* share of 0.1 is lost; "cbaa" would do',
    "link.outage_s=0.1\noutage_share=0.5": 'assignment.kind: .* share of 0.5 is lost; "cbaa" would',
    "link.loss=0.1\nradio.loss=0.1": "link.loss: is given beside radio.loss",
    "link.late=1\nradio.delay_s=0.1": "link.late: is given beside radio.delay_s",
    "link.every=2": "link.every: radio.rate_hz says how often .* leave it out",
    "link.round_s=0.1": "link.round_s: a round takes 1 / radio.rate_hz here; leave it out",
    "link.skew_s=0.1": "link.skew_s: no clock .* leave it out",
    "link.outage_s=0.04\noutage_share=0.9": "link.outage_share: .* outage_s = 0.34 would do",
    "rate_hz=60": "radio.rate_hz.* 50 would do",
    "assignment.period_s=0.01": "assignment.period_s: 0.01 is less .* 0.02 would do",
    f"push=[{push(vehicle=6)}]": "push.0.* no vehicle 6.* 0 to 5",
    f"push=[{push(start=2)}]": "push.0.end_s.* never begins",
    f"push=[{push(velocity='[1, 0]')}]": "push.0.velocity_m_s: must have at least 3 items, not 2",
    f"push=[{push(start=5, end=9)}, {push(2, 4, 6)}]": "push.0.start_s: one vehicle.* 6 would do",
    "leg=[]": "leg: .*at least 1",
    "leg.formation.name=Stahr": 'leg.0.formation: .*no formation "Stahr".* swarm6/Star',
    "leg.formation={kind='ring', radius_m=1.0}": "leg.0.formation.* 1.2 m.* would do",
    "leg.formation={kind='random', box_m=[9, 9, 1], separation_m=1}": "0.formation.separation_m",
    "leg.formation={kind='random', box_m=[9, 9], separation_m=2}": "leg.0.formation.*three sides",
    "leg.formation={kind='ring', radius_m=9, normal=[1, 0, 0]}": "leg.0.formation.*in the plane",
    f"leg.formation={STILL}": "leg.0.formation.velocities_m_s: a formation is at rest",
    "leg.formation={kind='file', file='none.csv'}": "leg.0.formation.* none.csv",
    RANDOM: 'leg.0.graph.* library.* "complete" would do',
    "leg.graph={file='lonely.csv'}": "leg.0.graph.* 0, 1, 2",
    "leg.graph={kind='pairs', pairs=[[0,1],[1,2],[2,3],[3,4],[4,5]]}": "leg.0.graph: too sparse",
    "leg.graph={kind='pairs', pairs=[[0,6]]}": r"leg.0.graph.pairs.* \[0, 6\].* 0 to 5",
    "leg.graph={kind='pairs', pairs=[[0.5,1]]}": "leg.0.graph.pairs: must be a list of pairs",
    "leg.graph={kind='pairs', pairs=[]}": "leg.0.graph.pairs.* list of pairs",
    "leg.graph={kind='sparse', share=0.1}": "leg.0.graph.* share .*would do",
    "leg.graph={file='cycle.csv'}": "leg.0.graph: no gains stabilize .*Star.* by proof; add edges",
    "leg.gains={file='hex.npz'}": "leg.0.gains.file: hex.npz .* other points",
    "leg.gains={file='complete.npz'}": "leg.0.gains.file.* another graph",
    "leg.gains={file='none.npz'}": "leg.0.gains.file.*none.npz",
    listed("[0, 1, 2]"): "leg.0.gains.* five numbers an edge",
    listed("[0, 6, 1, 0, 1]"): "leg.0.gains.edges.* 0 to 5",
    listed("[0, 2, 1, 0, 1]"): "leg.0.gains.* do not belong to this formation",
}


def test_gains_of_a_graph_with_fewer_edges_are_refused():
    points = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 3.0, 0.0], [0.0, 3.0, 0.0]])
    graph = np.ones((4, 4), dtype=bool) ^ np.eye(4, dtype=bool)
    graph[1, 3] = graph[3, 1] = False
    gains = design_gains(DesiredFormation(points, graph))
    leg = FormationLeg(points, "complete", gains=gains)
    with pytest.raises(InputError, match="gains: are of 5 edges, and the formation has 6"):
        Formation(start=5 * points, legs=[leg]).draw(np.random.default_rng(0))


@pytest.mark.parametrize("overrides", REFUSED)
def test_impossible_mission_is_refused_with_the_key_and_a_cure(files, overrides, monkeypatch):
    monkeypatch.chdir(files)
    with pytest.raises((InputError, ScenarioError), match=rf"(?s){REFUSED[overrides]}"):
        drawn(*overrides.split("\n"))


@pytest.mark.parametrize("step", [0.03, 0.007, 0.0123])
def test_a_rate_of_messages_that_would_do_is_taken(step):
    with pytest.raises(ScenarioError, match=r"([\d.]+) would do") as refused:
        parse(SIX, [f"step_s={step}"])
    rate = str(refused.value).split()[-3]
    assert parse(SIX, [f"step_s={step}", f"rate_hz={rate}"]).radio.message_rate == float(rate)


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_mission_and_its_draw_survive_their_own_text(name):
    mission = read(name)
    assert mission.name == name and len(scenarios()[name]) > 20
    drawn = mission.draw(np.random.default_rng(0))
    assert drawn.draw(np.random.default_rng(1)) == drawn
    for one in (mission, drawn):
        assert parse(one.to_toml()) == one


def test_arrays_alone_make_a_mission():
    points = load_formation("swarm6/Star").points
    mission = Formation(start=3 * points[:, :2], legs=[FormationLeg(points)], max_speed=0.4)
    flight = mission.draw(np.random.default_rng(0))
    assert flight.agents == 6 and np.array_equal(flight.gains[0].formation.points, points)
    assert np.array_equal(flight.initial_positions[:, :2], 3 * points[:, :2])
    assert not flight.initial_positions[:, 2].any()
    graph = load_formation("swarm6/Star").graph
    gains = design_gains(load_formation("swarm6/Star"))
    own = FormationLeg(points, graph, gains).draw(6, 1.2, np.random.default_rng(0))
    np.testing.assert_allclose(own.gain_matrix.xy, gains.xy, atol=1e-12)
    assert np.array_equal(own.desired.graph, graph)


def test_more_points_than_vehicles_are_no_formation():
    six = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [4, 1], [-2, 1]])
    mission = Formation(start=six[:4], legs=[FormationLeg(six)])
    with pytest.raises(InputError, match="4 vehicles cannot take up a formation of 6"):
        mission.draw(np.random.default_rng(0))


def test_missing_number_of_agents_and_one_sided_graph_are_refused():
    with pytest.raises(InputError, match=r"swarm\.agents: is missing"):
        Formation(start=Ring(radius=9.0), legs=[FormationLeg("Star")])
    with pytest.raises(InputError, match="graph: must be a symmetric matrix"):
        FormationLeg("Star", np.triu(np.full((6, 6), True), 1))


@pytest.mark.parametrize("method", ["cbaa", "hungarian", "none"])
def test_legacy_key_gives_the_papers_defaults(method):
    flight = parse(SIX, ["legacy_avoidance=true", f"assignment.kind={method}"])
    supervision = SupervisorSettings(convergence_speed=1.0, hover_time=1.0, time_limit=60.0)
    changed = {"agents": 6, "name": "six", "assignment": AssignmentSettings(method)}
    expected = legacy_formation(flight.start, flight.legs, supervision=supervision, **changed)
    assert flight == expected and flight.steps_per_frame == 2
    given = ["legacy_avoidance=true", "settled_mm_s=300", "frames.noise_m=0", "yaw=random"]
    other = parse(SIX, given)
    assert other.supervision.convergence_speed == pytest.approx(0.3)
    assert other.frames == FrameSettings("random", 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("step", "steps"), [(0.02, 1), (0.01, 2), (0.004, 5), (0.1, 1)])
def test_supervisor_observes_fifty_times_a_second(step, steps):
    assert parse(SIX, [f"step_s={step}", "rate_hz=10"]).steps_per_frame == steps


def test_identifiers_have_bits_enough_for_all_agents():
    start = "start={kind='random', box_m=[90, 90], separation_m=2}"
    assert parse(SIX, ["agents=257", start]).radio.id_bits == 9


def test_start_points_graphs_and_frames_are_drawn_in_this_order():
    text = SIX[: SIX.index("[[leg]]")]
    leg = """[[leg]]
formation = { kind = "random", box_m = [9, 9, 2], separation_m = 2 }
graph = { kind = "thinned", removals = 2 }
"""
    mission = parse(text + 2 * leg).draw(np.random.default_rng(5))
    rng = np.random.default_rng(5)
    flat = sample_positions(6, (9, 9), 1.5, rng)
    assert np.array_equal(mission.initial_positions, np.column_stack([flat, np.ones(6)]))
    for gains in mission.gains:
        assert np.array_equal(gains.formation.points, sample_formation(6, (9, 9, 2), 2.0, rng))
        assert np.array_equal(gains.formation.graph, random_dense_graph(6, 2, rng))
    assert mission.frames == FrameSettings().draw(6, rng)


def test_files_beside_the_scenario_become_part_of_its_text(files, monkeypatch):
    leg = "formation={file='points.csv'}\ngraph={file='edges.csv'}\ngains={file='star.npz'}\n"
    text = SIX.replace(SIX[SIX.index("formation = {") :], leg)
    text = text.replace(SIX[SIX.index("start =") : SIX.index("\n\n[protocol")], START_FILE)
    (files / "files.toml").write_text(text)
    monkeypatch.chdir("/")
    mission = read(files / "files.toml")
    text = mission.to_toml()
    assert "csv" not in text and "npz" not in text
    one, again = (m.draw(np.random.default_rng(3)) for m in (mission, parse(text)))
    assert one == again
    [found], [library] = one.gains, drawn().gains
    assert found.matches_formation(library.formation)
    np.testing.assert_allclose(found.xy, library.xy, atol=1e-12)
    np.testing.assert_allclose(found.z, library.z, atol=1e-12)
    assert (found.method, found.bound_xy) == (library.method, library.bound_xy)


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
def test_every_shape_makes_a_flat_formation_with_gains(shape, graph):
    [gains] = drawn(f"leg.formation={shape}", f"leg.graph={graph}").gains
    assert gains.formation.points.shape == (6, 3) and not gains.formation.points[:, 2].any()
    assert gains.convergence_rate > 0


def test_aligned_frames_change_no_other_draw():
    one, other = drawn().coordinate_frames, drawn("yaw=aligned").coordinate_frames
    assert (other.rotation == 1).all() and not (one.rotation == 1).any()
    assert np.array_equal(one.origin, other.origin) and np.abs(one.origin).max() <= 10
    assert np.array_equal(one.drift_rate, other.drift_rate)
    np.testing.assert_allclose(np.linalg.norm(one.drift_rate, axis=1), 0.01)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("legacy_avoidance=true", ["does not keep vehicles apart"]),
        ("margin_m=0.03", ["twice frames.noise_m = 0.02", "0.05 would do"]),
        ("brake_m_s2=0.4", ["more than half of max_acceleration_m_s2"]),
        ("step_s=0.2", ["farther than avoidance.margin_m"]),
        ("agents=6", []),
    ],
)
def test_doubtful_avoidance_is_warned_of(override, words):
    rate = ["rate_hz=5"] if "step" in override else []
    found = drawn(override, *rate).warnings()
    assert len(found) == bool(words)
    assert all(word in found[0] for word in words)


WRITTEN = [
    RANDOM + "\nleg.graph={kind='thinned', removals=3}\nleg.name='two words'",
    "leg.formation={kind='ring', spacing_m=2.5}\nleg.graph={kind='sparse', share=0.6}",
    "leg.formation={kind='lattice', radius_m=9}\nleg.gains=projection",
    "leg.formation={kind='text', text='A b', height_m=9, center_m=[3, 0]}\nleg.gains=sdp",
    "leg.graph={kind='pairs', pairs=[[0, 1], [5, 2]]}\nleg.gains=admm\nassignment.kind=none",
    "leg.gains={kind='listed', edges=[[0, 1, 0.1, 0.2, 0.3]], bounds=[1, 0.5], method='mine'}",
    "start={kind='ring', radius_m=7}\nlegacy_avoidance=true\nlimit_s=7.25\nhover_s=0",
    "start={kind='points', positions_m=[[0,0],[3,0],[6,0],[0,3],[3,3],[6,3]]}\nyaw=aligned",
    f"push=[{push(end=1.5)}]\noffset_m=3.5",
    "assignment.kind=cbaa\nradio.loss=0.125\nradio.delay_s=0.04\nkeep_out_m=1.25\nid_bits=12",
]


@pytest.mark.parametrize("overrides", WRITTEN)
def test_every_kind_of_mission_survives_its_own_text(overrides):
    mission = parse(SIX, overrides.split("\n"))
    assert parse(mission.to_toml()) == mission != parse(SIX)


def test_given_frames_survive_the_text_of_their_mission(rng):
    frames = FrameSettings().draw(6, rng)
    mission = Formation(
        start=rng.uniform(-9, 9, (6, 2)), legs=[FormationLeg("Star")], frames=frames
    )
    again = parse(mission.to_toml())
    assert again == mission and again.draw(rng).frames == frames


def test_a_list_of_pairs_is_the_graph_of_the_matrix():
    points, pairs = 3.0 * np.eye(3), [(0, 1), (1, 2)]
    matrix = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], dtype=bool)
    assert FormationLeg(points, pairs) == FormationLeg(points, matrix)
    for graph in (np.array(pairs), tuple(pairs), matrix.tolist()):
        assert FormationLeg(points, graph) == FormationLeg(points, matrix)
    with pytest.raises(InputError, match="must have rows of one length"):
        FormationLeg(points, [[0, 1], [2]])


def test_a_push_that_begins_after_every_flight_is_doubted():
    slow = {"velocity": "[0.3, 0, 0]"}
    pushes = f"{push(start=50, end=60, **slow)}, {push(start=70, end=80, **slow)}"
    (doubt,) = drawn("limit_s=60", f"push=[{pushes}]").warnings()
    assert doubt == "a push is to begin at 70 s, and the flight ends at 60 s at the latest"


def test_a_push_beyond_the_limit_of_speed_is_doubted():
    (doubt,) = drawn(f"push=[{push(velocity='[100, 0, 0]')}]").warnings()
    assert "a push asks for 100 m/s in the plane, and swarm.max_speed_m_s = " in doubt
    (doubt,) = drawn(f"push=[{push(velocity='[0, 0, -0.45]')}]").warnings()
    assert "asks for 0.45 m/s up or down, and swarm.max_climb_m_s = 0.3 is all that it" in doubt
    assert not drawn(f"push=[{push(velocity='[0.45, 0, 0.28]')}]").warnings()
