"""Connectivity scenarios as files: what they say, refuse and warn of, and that they repeat."""

import json
import re
from dataclasses import fields

import numpy as np
import pytest
from test_cli import call, sentence

import sato
from dynamics.kinematic import KinematicVehicle
from dynamics.quadrotor import Quadrotor
from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.connectivity import AgentLoss
from sato.connectivity.distance import obstacle_distances
from sato.connectivity.kernel import CommandLimits
from sato.connectivity.messages import CommunicationLink
from sato.connectivity.potential import Potential, Repulsion
from sato.connectivity.power_iteration import default_gains
from sato.connectivity.yaw_estimator import YawTracking
from sato.former import ScenarioError, parse, read

SHORT = """
system = "connectivity"
name = "short"

[estimator]
kind = "flood"

[stick]
kind = "waypoints"

[run]
duration_s = 2.0
"""
THREE = (
    'swarm.start={kind="points", positions_m=[[0, 0, 2], [5, 0, 2], [30, 0, 2]], yaw_rad=[0, 0, 0]}'
)
PAIR = 'swarm.start={kind="points", positions_m=[[0, 0, 2], [5, 0, 2]], yaw_rad=[-0.8, 0]}'


def built(*settings, seed=1):
    return parse(SHORT, settings).build(np.random.default_rng(seed))


def refused(*settings):
    with pytest.raises(ScenarioError) as refusal:
        built(*settings)
    return str(refusal.value).removeprefix("scenario: ")


def same(one, other):
    """Whether two values are the same to the last bit."""
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return np.array_equal(one, other)


def test_the_built_in_one_is_the_papers_case_which_is_also_what_is_taken_where_nothing_is_said():
    mission = read("connectivity").build(np.random.default_rng(0))
    unsaid = built("run.duration_s=60")
    assert mission.agents == 6 and mission.obstacles.total == 6 and unsaid.obstacles.total == 0
    for of in (mission, unsaid):
        assert of.camera[:6] == Camera()[:6] and of.camera.optical_axis == pytest.approx(
            Camera().optical_axis
        )
        assert (of.potential, of.repulsion, of.limits) == (
            Potential(),
            Repulsion(),
            CommandLimits(),
        )
        assert (of.tracking, of.link, of.plant) == (
            YawTracking(),
            CommunicationLink(),
            KinematicVehicle(),
        )
        assert (of.estimator, of.duration, of.step) == ("flood", 60.0, 0.02)


@pytest.mark.parametrize("agents", [2, 6, 30])
@pytest.mark.parametrize("seed", range(3))
def test_any_number_of_robots_starts_apart_and_together_in_as_much_room_for_each(agents, seed):
    mission = built(f"agents={agents}", seed=seed)
    away = np.linalg.norm(mission.start[:, None] - mission.start, axis=2) + 9 * np.eye(agents)
    assert away.min() >= 1.8
    assert (
        algebraic_connectivity(
            interaction_graph(mission.start, mission.start_yaw, mission.camera).weights
        ).lambda2
        > 0.05
    )
    box = np.array([8, 8, 3]) * (agents / 6) ** (1 / 3)
    inside = mission.start - [0, 0, 3]
    assert (inside >= 0).all() and (inside <= box).all()
    off = mission.start_yaw_estimate - (mission.start_yaw - mission.start_yaw[:, None])
    assert 0.2 < np.abs(off).max() <= 0.5 or agents == 2


def test_waypoints_are_drawn_as_far_apart_as_asked_and_obstacles_clear_of_them_and_of_starts():
    mission = built("obstacles.count=25", "stick.spacing_m=4")
    ways = np.vstack([mission.start[:1], mission.stick.waypoints])
    assert np.linalg.norm(np.diff(ways, axis=0), axis=1) == pytest.approx([4, 4, 4])
    assert mission.obstacles.total == 25
    assert obstacle_distances(mission.start, mission.obstacles).min() > 1.5
    assert obstacle_distances(ways[1:], mission.obstacles).min() > 1.8


def test_every_table_reaches_the_mission():
    mission = built(
        "swarm.yaw_error_deg=0", "camera.blind=true", "camera.occlusion=true", "body_m=0.2",
        "camera.axis=[0, 0, 3]", "potential.lambda2_max=2", "repulsion.strength=1",
        "tracking.printed=true", "limits.turn_deg_s=90", "link.every=2", "link.late=1",
        "link.loss=0.1", "camera_m=0.05", 'plant={kind="kinematic", lag_s=0.3, noise=0.01}',
        'estimator={kind="power_pi", exchange_s=0.001}',
        'swarm.start={kind="random", box_m=[5, 5, 2.5], lambda2=0.02}',
        "death=[{robot=2, time_s=1}]",
    )  # fmt: skip
    assert mission.start_yaw_estimate == pytest.approx(mission.start_yaw - mission.start_yaw[:, None])
    assert mission.range_only and mission.occlusion and mission.body_radius == 0.2
    assert mission.camera.optical_axis == (0, 0, 1) and mission.potential.lambda2_max == 2
    assert mission.repulsion.strength == 1 and mission.tracking.as_printed
    assert mission.limits.yaw_rate == pytest.approx(np.pi / 2) and mission.link == CommunicationLink(
        2, 1, 0.1
    )
    assert mission.camera_noise == 0.05 and mission.plant == KinematicVehicle(0.3, 0.01)
    assert mission.estimator == "power_pi" and mission.power_iteration == default_gains(0.001, 6)
    assert mission.losses == (AgentLoss(2, 1.0),)
    assert built('plant={kind="quadrotor", tilt_deg=20}').plant == Quadrotor(max_tilt=np.pi / 9)


def test_obstacles_are_spheres_boxes_and_planes():
    obstacles = built(
        "agents=2", PAIR,
        'obstacle=[{kind="plane", normal=[0, 0, 2], through_m=[7, 7, 0.5]}, '
        '{kind="sphere", centre_m=[0, 9, 2], radius_m=1}, '
        '{kind="box", low_m=[8, -1, 0], high_m=[9, 1, 4]}]',
    ).obstacles  # fmt: skip
    places = np.array([[0, 0, 2], [0, 9, 2.5], [8.5, 0, 2], [0, -4, 5], [7, 2, 2]])
    expected = [[8, 8, 1.5], [-0.5, np.hypot(8, 8), 2], [np.hypot(8.5, 9) - 1, -0.5, 1.5]]
    assert obstacle_distances(places, obstacles)[:3] == pytest.approx(np.array(expected))
    assert obstacle_distances(places, obstacles)[4, 1] == pytest.approx(np.sqrt(2))


def test_who_is_lost_and_when_is_drawn_where_it_is_not_said():
    deaths = built("death=[{}, {robot=0}, {time_s=1.5}]").losses
    assert len({d.agent for d in deaths}) == 3 and deaths[1].agent == 0
    assert deaths[2].time == 1.5 and all(0 <= d.time <= 2 for d in deaths)
    assert deaths != built("death=[{}, {robot=0}, {time_s=1.5}]", seed=2).losses


def test_a_recorded_stick_lies_beside_the_scenario_and_goes_with_the_run(tmp_path, monkeypatch):
    (tmp_path / "stick.csv").write_text("# t, v\n0.5, 1, 0, 0\n1.0, 0, 0.5, 0\n")
    (tmp_path / "here.toml").write_text(
        SHORT.replace('"waypoints"', '"recorded"\nfile = "stick.csv"')
    )
    asked = read(tmp_path / "here.toml")
    mission = asked.build(np.random.default_rng(1))
    (tmp_path / "stick.csv").rename(tmp_path / "elsewhere.csv")
    with pytest.raises(ScenarioError, match=r'stick.file: ".*stick.csv" cannot be read'):
        asked.build(np.random.default_rng(1))
    (tmp_path / "elsewhere.csv").rename(tmp_path / "stick.csv")
    text = asked.to_toml()
    (tmp_path / "stick.csv").unlink()
    again = parse(text).build(np.random.default_rng(1))
    assert same(mission, again)
    assert again.stick.command_velocity(0.7, np.zeros(3), 0).tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("obstacles.count=5", "death=[{}]", "agents=9"),
        ("agents=2", PAIR, 'obstacle=[{kind="plane", normal=[0, 0, 1], through_m=[0, 0, 0]}]'),
        ('plant={kind="quadrotor"}', 'estimator={kind="power_pi", settle=50}'),
    ],
)
def test_what_a_run_keeps_of_its_scenario_builds_the_same_mission(settings):
    text = parse(SHORT, settings).to_toml()
    assert same(built(*settings), parse(text).build(np.random.default_rng(1)))
    assert parse(text).to_toml() == text


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        (("agents=3", THREE), r"swarm.start: .* λ₂ is 0: robots \{0, 1\} and \{2\} do not s"),
        (("agents=2", PAIR, "lambda2_min=2.5"), r"hardly hangs together, λ₂ is 2, .* = 2.5"),
        (("agents=2", PAIR, "nearest_m=5", "farthest_m=9"), r"0 and 1 start 5 m apart"),
        (("agents=2", THREE), r"swarm.start.positions_m: needs 2 rows of 3"),
        (("agents=1",), r"swarm.agents: must be at least 2, got 1|agents: must be at least 2"),
        (("d_near_m=7.5",), r"camera.d_near_m: 7.5 is not less than d_far_m = 7, .*3.5 would do"),
        (("d_min_m=3",), r"camera.d_min_m: 3 is not less than d_near_m = 3; 1 would do"),
        (("d_max_m=7",), r"camera.d_max_m: 7 is not more than d_far_m = 7; 9 would do"),
        (("a_min=0.95",), r"camera.a_min: 0.95 and a_max = 0.95 are cosines"),
        (("camera.axis=[0, 0, 0]",), r"camera.axis: .* the length not 0"),
        (("lambda2_min=4",), r"potential.lambda2_min: 4 is not less than lambda2_max = 3.01"),
        (("nearest_m=4",), r"repulsion.nearest_m: 4 is not less than farthest_m = 3.5"),
        (("slow_m_s=0.3",), r"tracking.slow_m_s: .* fast_m_s = 0.3; 0.1 would do"),
        (("estimator.kind=power_pi", "agree=50", "follow=200", "settle=200"),
         r"estimator: .* spectral radius is 2.4, .* follow = 100, agree = 141.7 and settle"),
        (("estimator.kind=power_pi", "deflate=600"), r"does not settle .* deflate = 25"),
        (("estimator.kind=power_pi", "iterate=600"), r"radius is 6.2, .* iterate = 3,"),
        (("estimator.kind=power_pi", "normalise=3000"), r"estimator: .* normalise = 25,"),
        (("tracking.k3=100",), r"tracking.k3: 100 does not settle .* becomes -1 times as large"),
        (("tracking.k2=96",), r"tracking.k2: 96, with closure = 5, does not settle"),
        (("run.step_s=0.5",), r"tracking.k2: .* control step of 0.5 s: .* gains of 0.4 would do"),
        (("link.late=10",), r"link.late: .* 0.22 s old .* may be 0.2 s.* late = 9 would do"),
        (("link.every=11",), r"link.every: .* 0.22 s old"),
        (("death={}",), r"death: "),
        (("obstacles.count=1001",), r"obstacles.count: "),
        (("camera.axis=[1e308, 0, 0]",), r"camera.axis: needs 3 coordinates"),
        (("estimator.kind=power_pi", "exchange_s=0.003"), r"exchange_s: 0.003 does not divide"),
        (('swarm.start={kind="random", box_m=[3, 3, 3]}', "agents=30"), r"start.box_m: .* is full"),
        (('swarm.start={kind="random", box_m=[90, 90, 9]}',), r"start.lambda2: none of 500"),
        (('swarm.start={kind="random", box_m=[9, 9]}',), r"start.box_m: needs 3 sides, got 2"),
        (("agents=2", PAIR, 'obstacle=[{kind="sphere", centre_m=[5, 1, 2], radius_m=0.5}]'),
         r"obstacle: robot 1 starts 0.5 m from it, of sphere 0, and repulsion.nearest_m = 1"),
        (("agents=2", PAIR, 'obstacle=[{kind="sphere", centre_m=[0, 50, 2], radius_m=1}, '
          '{kind="box", low_m=[4, -1, 0], high_m=[6, 1, 4]}]'),
         r"obstacle: robot 1 starts inside of it, of box 0"),
        (('obstacle=[{kind="box", low_m=[1, 1, 1], high_m=[2, 1, 2]}]',), r"obstacle.0.low_m: m"),
        (('obstacle=[{kind="plane", normal=[0, 0, 0], through_m=[0, 0, 0]}]',), r"has length 0"),
        (('obstacle=[{kind="sphere", centre_m=[0, 0], radius_m=1}]',), r"centre_m: needs 3 coord"),
        (("obstacles.count=1", "obstacles.radius_m=[30, 40]"), r"obstacles.radius_m: no room"),
        (("obstacles.radius_m=[2]",), r"obstacles.radius_m: needs the smallest and the largest"),
        (('stick={kind="recorded"}',), r"stick: needs a file, or times_s and velocities_m_s"),
        (('stick={kind="recorded", times_s=[1, 1], velocities_m_s=[[0, 0, 1], [0, 0, 2]]}',),
         r"stick.times_s: times must increase"),
        (("death=[{robot=6}]",), r"death.0.robot: 6 is none that is left of 0, 1, 2, 3, 4, 5"),
        (("death=[{robot=1}, {robot=1}]",), r"death.1.robot: 1 is none that is left of 0, 2"),
        (("death=[{}, {}, {}, {}, {}]",), r"death: 5 of 6 robots are lost; two must be left"),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused_with_what_would_do(settings, says):
    text = refused(*settings)
    assert re.search(says, text), text


def test_a_leader_that_outruns_the_rest_and_gains_that_cannot_follow_are_warned_of():
    asked = parse(SHORT, ["stick.speed_m_s=4"])
    with pytest.warns(UserWarning, match=r"asks for 4 m/s, and limits.speed_m_s = 3 .* 2 m/s"):
        asked.warn(asked.build(np.random.default_rng(0)))
    hasty = parse(SHORT, ["estimator.kind=power_pi"])
    with pytest.warns(UserWarning, match=r"go 6 mm from one .* limits.speed_m_s = 1.25 would do"):
        hasty.warn(hasty.build(np.random.default_rng(0)))
    calm = parse(SHORT)
    calm.warn(calm.build(np.random.default_rng(0)))  # warnings are errors here


def test_the_command_line_flies_judges_and_repeats_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call("run", "connectivity", "--set", "duration_s=3", "--out", "here", "--seed", "4")
    assert done.exit_code == 0, done.output
    assert done.stderr.startswith("the swarm is together at 0 s: 1 component, least separation")
    said = json.loads((tmp_path / "here" / "summary.json").read_text())
    assert said["success"] is True and said["broken"] == [] and said["lambda2_min"] > 0.01
    assert call("check", "here").exit_code == 0
    assert call("plot", "here").exit_code == 0
    again = sato.run("connectivity", overrides=["duration_s=3"], seed=4)
    assert again.data.attrs["digest"] == sato.load("here").data.attrs["digest"]
    refusal = call("run", "connectivity", "--set", "d_near_m=8")
    assert refusal.exit_code == 2
    assert sentence(refusal).startswith("sato: connectivity: camera.d_near_m: 8 is not less than")
