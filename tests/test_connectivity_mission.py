"""Connectivity missions as definitions: defaults, random draws, refusals and round trips."""

import re

import numpy as np
import pytest

from dynamics.kinematic import KinematicVehicle
from dynamics.quadrotor import Quadrotor
from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.connectivity.mission import AgentLoss, Connectivity
from sato.connectivity.obstacles import Box, Plane, RandomSpheres, Sphere, obstacle_distances
from sato.connectivity.settings import (
    CommandLimits,
    Potential,
    PowerIterationGains,
    Repulsion,
    YawTracking,
)
from sato.connectivity.start import Poses, RandomPoses
from sato.connectivity.stick import RecordedStick, WaypointStick
from sato.network.link import Link
from sato.scenario.errors import InputError, ScenarioError
from sato.scenario.file import parse, read

SHORT = """
system = "connectivity"
name = "short"

[estimator]
kind = "flood"

[stick]
kind = "waypoints"
start_s = 0.0

[run]
duration_s = 2.0
"""
THREE = (
    'swarm.start={kind="points", positions_m=[[0, 0, 2], [5, 0, 2], [30, 0, 2]], yaw_rad=[0, 0, 0]}'
)
PAIR = 'swarm.start={kind="points", positions_m=[[0, 0, 2], [5, 0, 2]], yaw_rad=[-0.8, 0]}'


def drawn(*settings, seed=1):
    return parse(SHORT, settings).draw(np.random.default_rng(seed))


def refused(*settings):
    with pytest.raises((ScenarioError, InputError)) as refusal:
        drawn(*settings)
    return str(refusal.value).removeprefix("scenario: ")


def test_defaults_are_the_published_parameters():
    # [Bernard2023, Table I]
    for mission in (Connectivity(), read("connectivity")):
        assert mission.camera[:6] == (1.0, 3.0, 7.0, 9.0, 0.4, 0.95)
        axis = np.array(mission.camera.optical_axis)
        assert axis / np.linalg.norm(axis) == pytest.approx(np.array([1, 1, 0]) / np.sqrt(2))
        assert mission.potential[:2] == (0.01, 3.01) and mission.repulsion[:2] == (1.0, 3.5)
        assert mission.tracking[:3] == (10.0, 10.0, 10.0)


def test_arrays_of_poses_make_a_mission():
    start = np.array([[0.0, 0, 2], [5, 0, 2], [5, 4, 2]])
    mission = Connectivity(start=start, yaw=np.array([-0.8, 0, -2]), duration=20.0)
    assert mission.agents == 3 and np.array_equal(mission.initial_position, start)
    given = {"start": Poses(start, mission.yaw), "duration": 20.0}
    assert mission == Connectivity(**given)
    with pytest.raises(InputError, match=r"swarm.yaw_rad: is given twice"):
        Connectivity(**given, yaw=mission.yaw)
    with pytest.raises(InputError, match=r"swarm.start.yaw_rad: needs 3 angles, got none"):
        Connectivity(start=start)
    with pytest.raises(InputError, match=r"swarm.yaw_rad: needs a start with positions"):
        Connectivity(yaw=mission.yaw)
    with pytest.raises(InputError, match=r"swarm.yaw_error_rad: needs 3 x 3 errors"):
        Connectivity(**given, yaw_error=np.zeros((2, 2)))
    with pytest.raises(ValueError, match=r"known once the mission is drawn"):
        Connectivity().initial_position  # noqa: B018


@pytest.mark.parametrize("agents", [2, 6, 30])
@pytest.mark.parametrize("seed", range(3))
def test_random_starts_are_separated_and_connected_in_a_box_that_grows(agents, seed):
    mission = drawn(f"agents={agents}", seed=seed)
    position = mission.initial_position
    gap = np.linalg.norm(position[:, None] - position, axis=2) + 9 * np.eye(agents)
    assert gap.min() >= 1.8
    weights = interaction_graph(position, mission.yaw, mission.camera).weights
    assert algebraic_connectivity(weights).lambda2 > 0.05
    box = np.array([8, 8, 3]) * (agents / 6) ** (1 / 3)
    inside = position - [0, 0, 3]
    assert (inside >= 0).all() and (inside <= box).all()
    error = mission.initial_relative_yaw - (mission.yaw - mission.yaw[:, None])
    assert 0.2 < np.abs(error).max() <= 0.5 or agents == 2


def test_drawn_obstacles_are_clear_of_starts_and_spaced_waypoints():
    mission = drawn("obstacles.count=25", "stick.spacing_m=4")
    ways = np.vstack([mission.initial_position[:1], mission.stick.waypoints])
    assert np.linalg.norm(np.diff(ways, axis=0), axis=1) == pytest.approx([4, 4, 4, 4])
    obstacles = mission.obstacle_arrays
    assert obstacles.total == 25
    assert obstacle_distances(mission.initial_position, obstacles).min() > 1.5
    assert obstacle_distances(ways[1:], obstacles).min() > 1.8


def test_losses_are_drawn_where_robot_or_time_is_absent():
    losses = drawn("death=[{}, {robot=0}, {time_s=1.5}]").losses
    assert len({loss.agent for loss in losses}) == 3 and losses[1].agent == 0
    assert losses[2].time == 1.5 and all(0 <= loss.time <= 2 for loss in losses)
    assert losses != drawn("death=[{}, {robot=0}, {time_s=1.5}]", seed=2).losses


def test_stick_rests_at_first_and_is_then_held_and_let_go_in_turns():
    stick = WaypointStick(np.array([[9.0, 0, 0]]), start_time=2.0, hold_time=3.0, release_time=1.0)
    times = np.arange(0.0, 10.0, 0.5)
    held = [stick.command_velocity(time, np.zeros(3), 0).any() for time in times]
    assert times[held].tolist() == [2, 2.5, 3, 3.5, 4, 4.5, 6, 6.5, 7, 7.5, 8, 8.5]


def test_recorded_stick_lies_beside_the_scenario_and_goes_with_the_run(tmp_path):
    (tmp_path / "stick.csv").write_text("# t, v\n0.5, 1, 0, 0\n1.0, 0, 0.5, 0\n")
    (tmp_path / "here.toml").write_text(
        SHORT.replace('"waypoints"\nstart_s = 0.0', '"recorded"\nfile = "stick.csv"')
    )
    asked = read(tmp_path / "here.toml")
    mission, text = asked.draw(np.random.default_rng(1)), asked.to_toml()
    (tmp_path / "stick.csv").unlink()
    with pytest.raises(InputError, match=r'stick.file: ".*stick.csv" cannot be read'):
        asked.draw(np.random.default_rng(1))
    again = parse(text).draw(np.random.default_rng(1))
    assert mission == again
    assert again.stick.command_velocity(0.7, np.zeros(3), 0).tolist() == [1, 0, 0]


def random_mission(seed):
    """Build a mission with every field at random."""
    rng = np.random.default_rng(seed)

    def pick(*options):
        return options[rng.integers(len(options))]

    def numbers(low, high, count=3):
        return rng.uniform(low, high, count).tolist()

    poses = drawn("agents=4", seed=seed % 7)
    start = {"start": poses.initial_position, "yaw": poses.yaw}
    if pick(True, False):
        box = pick(None, numbers(4, 9))
        start = {"agents": 4, "start": RandomPoses(box, *numbers(-1, 3, 1), *numbers(0.1, 1, 2))}
        ranges, cosines = np.cumsum(numbers(0.5, 3, 4)), numbers(-1, 0.4, 1) + numbers(0.5, 1, 1)
        start["camera"] = Camera(*ranges, *cosines, tuple(numbers(0.1, 2)))
    obstacles = [
        Sphere(tuple(numbers(60, 90)), rng.uniform(0.1, 9)),
        Box(tuple(numbers(60, 90)), tuple(numbers(91, 99))),
        Plane((0.3, -0.2, 1.7), tuple(numbers(-99, -60))),
    ]
    waypoints = pick(None, rng.uniform(-9, 9, (rng.integers(1, 5), 3)))
    return Connectivity(
        **start,
        yaw_error=pick(rng.uniform(), rng.uniform(-1, 1, (4, 4))),
        range_only=pick(True, False), occlusion=pick(True, False), body_radius=rng.uniform(0.1, 1),
        potential=Potential(*numbers(0, 1e-6, 1), *numbers(1, 6, 2)),
        repulsion=Repulsion(*numbers(0.1, 1, 1), *numbers(2, 4, 2)),
        tracking=YawTracking(*numbers(1, 20), 0.1, *numbers(0.2, 1, 2), pick(True, False)),
        limits=CommandLimits(*numbers(0.1, 9, 2)), camera_noise=rng.uniform(),
        link=Link(*rng.integers(1, 3, 2), rng.uniform()),
        estimator=pick("flood", "exact"),
        power_iteration=PowerIterationGains(0.002, *(pick(None, g) for g in numbers(1, 9, 6))),
        plant=pick(KinematicVehicle(*numbers(0, 1, 2)), Quadrotor(*numbers(0.1, 1, 4))),
        stick=pick(WaypointStick(waypoints, rng.integers(1, 5), *numbers(0.1, 9, 7)),
                   RecordedStick(np.cumsum(numbers(0.1, 1)), rng.uniform(-3, 3, (3, 3)))),
        obstacles=obstacles[: rng.integers(4)],
        random_obstacles=RandomSpheres(rng.integers(4), sorted(numbers(0.1, 1, 2))),
        losses=pick((), (AgentLoss(pick(None, 2), pick(None, *numbers(0, 9))),)),
        duration=rng.uniform(0.1, 99), step=pick(0.02, 0.01),
    )  # fmt: skip


def test_two_hundred_random_missions_written_as_toml_are_read_back_equal():
    for seed in range(200):
        mission = random_mission(seed)
        assert parse(mission.to_toml()) == mission
        assert mission != random_mission(seed + 1)


@pytest.mark.parametrize(
    "changes",
    [
        (),
        ("obstacles.count=5", "death=[{}]", "agents=9"),
        ("agents=2", PAIR, 'obstacle=[{kind="plane", normal=[0, 0, 1], through_m=[0, 0, 0]}]'),
        ('plant={kind="quadrotor"}', 'estimator={kind="power_pi", settle=50}'),
    ],
)
def test_drawn_mission_stays_as_it_is_when_written_and_when_drawn_again(changes):
    mission = drawn(*changes)
    assert parse(mission.to_toml()) == mission
    assert mission.draw(np.random.default_rng(7)) == mission
    again = parse(parse(SHORT, changes).to_toml())
    assert again.draw(np.random.default_rng(1)) == mission


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (("agents=3", THREE), r"swarm.start: λ₂ is 0 with robots \{0, 1\} and \{2\} con"),
        (("agents=2", PAIR, "lambda2_min=2.5"), r"λ₂ is 2 .*lambda2_min = 2.5"),
        (("agents=2", PAIR, "nearest_m=5", "farthest_m=9"), r"0 and 1 start 5 m apart"),
        (("agents=2", THREE), r"swarm.start.positions_m: needs 2 rows of 3"),
        (("agents=1",), r"swarm.agents: must be at least 2, got 1|agents: must be at least 2"),
        (("d_near_m=7.5",), r"camera.d_near_m: 7.5 is not less than d_far_m = 7; 3.5 would do"),
        (("d_min_m=3",), r"camera.d_min_m: 3 is not less than d_near_m = 3; 1 would do"),
        (("d_max_m=7",), r"camera.d_far_m: 7 is not less than d_max_m = 7; 5.6 would do"),
        (("a_min=0.95",), r"camera.a_min: 0.95 is not less than a_max = 0.95"),
        (("camera.axis=[0, 0, 0]",), r"camera.axis: .* not all 0"),
        (("lambda2_min=4",), r"potential.lambda2_min: 4 is not less than lambda2_max = 3.01"),
        (("nearest_m=4",), r"repulsion.nearest_m: 4 is not less than farthest_m = 3.5"),
        (("slow_m_s=0.3",), r"tracking.slow_m_s: .* fast_m_s = 0.3; 0.1 would do"),
        (("estimator.kind=power_pi", "agree=50", "follow=200", "settle=200"),
         r"estimator: .* spectral radius is 2.4, .* follow = 100, agree = 141.7 and settle"),
        (("estimator.kind=power_pi", "deflate=600"), r"is unstable .* deflate = 25"),
        (("estimator.kind=power_pi", "iterate=600"), r"radius is 6.2, .* iterate = 3,"),
        (("estimator.kind=power_pi", "normalize=3000"), r"estimator: .* normalize = 25,"),
        (("tracking.k3=100",), r"tracking.k3: k3 = 100 .* becomes -1 times as large"),
        (("tracking.k2=96",), r"tracking.k2: k2 \+ closure = 101 /s is unstable"),
        (("run.step_s=0.5",), r"tracking.k2: .* control step of 0.5 s: .* 0.4 would do"),
        (("link.late=10",), r"link.late: .* 0.22 s old .* may be 0.2 s.* late = 9 would do"),
        (("link.every=11",), r"link.every: .* 0.22 s old"),
        (("link.round_s=0.1",), r"link.round_s: a round takes every × run.step_s here; leave it"),
        (("link.skew_s=0.1",), r"link.skew_s: the ages of messages .* leave it out"),
        (("link.outage_s=0.1",), r"link.outage_share: is 0, and outage_s is not: give both"),
        (("link.outage_s=0.04", "outage_share=0.9"),
         r"link.outage_share: 0.9 with outages of 1.5 rounds .* or outage_s = 0.34 would do"),
        (("obstacles.count=1001",), r"obstacles.count: "),
        (("camera.axis=[1e20, 0, 0]",), r"camera.axis: needs 3 coordinates"),
        (("estimator.kind=power_pi", "exchange_s=0.003"), r"exchange_s: 0.003 does not divide"),
        (('swarm.start={kind="random", box_m=[3, 3, 3]}', "agents=30"), r"start.box_m: .* is full"),
        (('swarm.start={kind="random", box_m=[90, 90, 9]}',), r"start.lambda2: none of 500"),
        (('swarm.start={kind="random", box_m=[9, 9]}',), r"start.box_m: .* 3 items, not 2"),
        (("agents=2", PAIR, 'obstacle=[{kind="sphere", center_m=[5, 1, 2], radius_m=0.5}]'),
         r"obstacle.0: robot 1 starts 0.5 m from this sphere, and repulsion .*nearest_m = 1"),
        (("agents=2", PAIR, 'obstacle=[{kind="sphere", center_m=[0, 50, 2], radius_m=1}, '
          '{kind="box", low_m=[4, -1, 0], high_m=[6, 1, 4]}]'),
         r"obstacle.1: robot 1 starts inside of this box"),
        (('obstacle=[{kind="box", low_m=[-9, -9, 0], high_m=[9, 9, 9]}]',),
         r"^obstacle.0: robot . starts inside of this box"),
        (("lambda2_min=2.99",), r"^swarm.start: λ₂ is .* above potential.lambda2_min = 2.99"),
        (('obstacle=[{kind="box", low_m=[1, 1, 1], high_m=[2, 1, 2]}]',), r"obstacle.0.low_m: m"),
        (('obstacle=[{kind="plane", normal=[0, 0, 0], through_m=[0, 0, 0]}]',), r"has length 0"),
        (('obstacle=[{kind="sphere", center_m=[0, 0], radius_m=1}]',), "obstacle.0: has 2 coor"),
        (("obstacles.count=1", "obstacles.radius_m=[30, 40]"), r"obstacles.radius_m: no room"),
        (("obstacles.radius_m=[2]",), r"obstacles.radius_m: needs the smallest and the largest"),
        (('stick={kind="recorded"}',), r"stick: needs a file, or times_s and velocities_m_s"),
        (('stick={kind="recorded", times_s=[1, 1], velocities_m_s=[[0, 0, 1], [0, 0, 2]]}',),
         r"stick.times_s: must increase"),
        (("death=[{robot=6}]",), r"death.0.robot: must be one of 0, 1, 2, 3, 4, 5, got 6"),
        (("death=[{robot=1}, {robot=1}]",), r"death.1.robot: must be one of 0, 2, .* got 1"),
        (("death=[{}, {}, {}, {}, {}]",), r"death: 5 of 6 robots are lost; two must be left"),
    ],
)  # fmt: skip
def test_infeasible_missions_are_refused_with_a_value_that_would_do(changes, message):
    text = refused(*changes)
    assert re.search(message, text), text


def test_a_flight_takes_a_step_or_more():
    assert "run.duration_s: 0.001 is less than a step; 0.0" in refused("duration_s=0.001")


def test_fast_leader_and_slow_power_iteration_are_doubted():
    (fast,) = drawn("stick.speed_m_s=4").warnings()
    assert re.search(r"asks for 4 m/s, and limits.speed_m_s = 3 .* 2 m/s", fast)
    (turning,) = drawn("limits.turn_rad_s=90").warnings()
    assert "14.3 turns a second; is it in rad/s?" in turning
    (slow,) = drawn("estimator.kind=power_pi").warnings()
    assert re.search(r"fly 6 mm from one .* limits.speed_m_s = 1.25 would do", slow)
    assert not drawn().warnings()
    (late,) = drawn("death=[{time_s=1.5}, {time_s=3}]").warnings()
    assert late == "a robot is to be lost at 3 s, and the flight ends at 2 s"
    (unheld,) = drawn("stick.start_s=30").warnings()
    assert unheld == "the stick is first held at 30 s, and the flight ends at 2 s"
