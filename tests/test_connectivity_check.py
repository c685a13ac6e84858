"""Check of connectivity runs: an unaltered run passes, and alterations are detected."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from recorded_run import record_run, with_data

import sato
from sato.check.common import find_closest_approach
from sato.connectivity.check.promises import check_run
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.loop import simulate
from sato.connectivity.system import SYSTEM, describe_progress
from sato.scenario.file import read

QUADROTOR = 'plant={kind="quadrotor"}'
SHAKEN = 'plant={kind="kinematic", lag_s=0.3, noise=0.02}'


def flown(*settings, seed=1, **changed):
    """Fly three seconds with the stick held; return the run and its drawn mission."""
    rng = np.random.default_rng(seed)
    short = "duration_s=3", "stick.start_s=0"
    mission = replace(read("connectivity", [*short, *settings]).draw(rng), **changed)
    return run_of(mission, simulate(mission, rng)), mission


def run_of(mission, frames, **attributes):
    return record_run(SYSTEM, frames, mission, **attributes)


def broken(run, mission):
    return {p.name for p in check_run(run.recorded, mission).broken}


def altered(run, name, change):
    """Change one variable of a run at the hundredth instant."""
    was, values = run.data[name], run.data[name].values.copy()
    values[100] = change(values[100])
    return with_data(run, run.data.assign({name: (was.dims, values, was.attrs)}))


def retold(run, events):
    """Replace the events of a run."""
    text = np.array([json.dumps(event) for event in events], dtype=object)
    return with_data(run, run.data.drop_vars("event").assign(event=("event", text)))


@pytest.fixture(scope="module")
def honest():
    return flown()


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ('plant={kind="kinematic", lag_s=0.3}', "link.loss=0.1", "link.late=1"),
        (SHAKEN, "noise.camera_m=0.05"),
        (QUADROTOR,),
        ("camera.occlusion=true", "camera.body_m=1.0"),
        (QUADROTOR, "camera.occlusion=true"),
        ("death=[{robot=3, time_s=1.0}, {robot=0, time_s=2.01}]",),
        (SHAKEN, "death=[{robot=3, time_s=1.0}, {robot=0, time_s=2.01}]"),
        (QUADROTOR, "camera.occlusion=true", "death=[{robot=3, time_s=1.0}]"),
        ("agents=2",),
        (QUADROTOR, "agents=2"),
        (
            "estimator.kind=exact",
            'obstacle=[{kind="plane", normal=[0, 0, 1], through_m=[0, 0, 0]}]',
        ),
        ('stick={kind="recorded", times_s=[0.5, 2], velocities_m_s=[[1, 0, 0], [0, 0, 0.5]]}',),
    ],
)
def test_unaltered_run_keeps_all_promises(settings):
    run, mission = flown(*settings)
    report = check_run(run.recorded, mission)
    assert report.kept, report.broken
    assert report.summary["success"] is True


def test_commands_that_jump_to_and_fro_are_found(honest):
    run, mission = honest
    was = run.data["velocity_command"]
    shaken = was.values + 0.2 * (-1.0) ** np.arange(len(was))[:, None, None]
    found = with_data(run, run.data.assign(velocity_command=(was.dims, shaken, was.attrs)))
    assert {"chattering", "obedience"} <= broken(found, mission)
    assert "chattering" not in broken(found, replace(mission, occlusion=True))


def test_a_potential_of_the_spectrum_ends_the_chattering_of_lambda2():
    # λ₂ and λ₃ change places again and again in this flight.
    stick = "stick.start_s=0", "stick.on_s=9", "stick.off_s=3", "stick.speed_m_s=2", "spacing_m=6"
    shares = {}
    for of in ("lambda2", "spectrum"):
        settings = ["duration_s=16", f"potential.of={of}", *stick]
        run = sato.run("connectivity", seed=5, overrides=settings)
        shares[of] = run.summary["chattering"]
        assert not run.summary["broken"]
    assert shares["lambda2"] > 0.01 and shares["spectrum"] < 0.001


def bent(values, by=1e-6):
    values = np.array(values, dtype=float)
    values.flat[1] += by
    return values


@pytest.mark.parametrize(
    ("name", "change", "promises"),
    [
        ("time", lambda t: t + 1e-6, {"times"}),
        ("position", bent, {"flight", "weights"}),
        ("position", lambda p: p * np.nan, {"numbers", "flight"}),
        ("velocity", bent, {"obedience"}),
        ("velocity_command", bent, {"obedience"}),
        ("velocity_command", lambda u: bent(u, 4.0), {"speed"}),
        ("yaw_rate", bent, {"heading"}),
        ("yaw_rate", lambda w: bent(w, 2.0), {"turn", "heading"}),
        ("yaw", bent, {"heading", "obedience"}),
        ("stick", bent, {"stick", "obedience"}),
        ("alive", lambda lives: ~lives, {"alive"}),
        ("component", lambda labels: labels + np.arange(6), {"component"}),
        ("edge_weight", bent, {"weights", "eigenvalues"}),
        ("lambda2", lambda x: x + 1e-6, {"eigenvalues"}),
        ("lambda2", lambda x: 0.005, {"eigenvalues", "connectivity"}),
        ("lambda3", lambda x: x + 1e-6, {"eigenvalues"}),
        ("visibility", lambda sees: ~sees, {"visibility"}),
        ("yaw_estimate_error", lambda x: x * np.nan, {"numbers"}),
    ],
)
def test_alteration_by_a_millionth_is_detected(honest, name, change, promises):
    run, mission = honest
    assert promises <= broken(altered(run, name, change), mission)


def test_collision_with_an_obstacle_or_an_agent_is_detected(honest):
    run, mission = honest
    center = mission.obstacle_arrays.spheres[0, :3]
    at_obstacle = altered(run, "position", lambda p: np.vstack([center, p[1:]]))
    assert {"obstacles", "flight"} <= broken(at_obstacle, mission)
    at_another = altered(run, "position", lambda p: np.vstack([p[1] + [0.9, 0, 0], p[1:]]))
    assert {"separation", "flight"} <= broken(at_another, mission)
    said = check_run(at_another.recorded, mission).summary
    assert said["min_separation_m"] <= 0.9
    assert check_run(at_obstacle.recorded, mission).summary["min_obstacle_distance_m"] < 0


def test_missing_and_invented_events_are_detected():
    run, mission = flown("death=[{robot=2, time_s=1}]", "spacing_m=2")
    told = run.events()
    assert {e["kind"] for e in told} == {"waypoint", "loss"}
    assert {"alive"} <= broken(retold(run, [e for e in told if e["kind"] != "loss"]), mission)
    assert {"stick"} <= broken(retold(run, [e for e in told if e["kind"] == "loss"]), mission)
    more = [*told, {"time": 2.9, "kind": "waypoint", "agents": [0], "number": 2}]
    assert {"stick"} <= broken(retold(run, more), mission)
    assert {"alive"} <= broken(run, replace(mission, losses=()))


def test_weights_by_range_alone_lose_connectivity_and_fail():
    run, mission = flown("camera.blind=true", "estimator.kind=exact")
    report = check_run(run.recorded, mission)
    assert {p.name for p in report.broken} == {"connectivity"}
    assert report.summary["success"] is False and report.summary["lambda2_min"] <= 0.01
    (lost,) = report.broken
    since = float(run.data["time"][np.argmax(run.data["lambda2"].values <= 0.01)])
    assert f"from {since:g} s on" in lost.message
    assert run.events("split")[0]["time"] >= since


def test_incomplete_flight_is_no_success(honest):
    _, mission = honest
    frames = list(simulate(mission, np.random.default_rng(1)))[:40]
    run = run_of(mission, frames, stopped="interrupted")
    assert broken(run, mission) == {"complete"}
    assert check_run(run.recorded, mission).summary["success"] is False
    unsaid = run_of(mission, frames)
    assert broken(unsaid, mission) == {"complete"}


def test_run_of_another_mission_is_detected(honest):
    run, mission = honest
    other = flown(seed=2)[1]
    assert {"start", "stick"} <= broken(run, other)
    assert broken(run, mission) == set()
    assert "attributes" in broken(
        run, replace(mission, limits=mission.limits._replace(yaw_rate=2.0))
    )


def test_summary_agrees_with_the_data(honest):
    run, mission = honest
    said, data = check_run(run.recorded, mission).summary, run.data
    assert said["lambda2_min"] == data["lambda2"].values.min()
    off = data["lambda2_estimate"].values - data["lambda2"].values[:, None]
    assert said["lambda2_error_mean"] == pytest.approx(np.nanmean(np.abs(off)))
    assert said["edges_mean"] == (data["edge_weight"].values > 0).sum() / 2 / len(data["time"])
    sees = data["visibility"].values
    error = np.abs(np.sin(data["yaw_estimate_error"].values / 2))
    both = [error[k, i, j] for k, i, j in zip(*np.nonzero(sees), strict=True) if sees[k, j, i]]
    one = [error[k, i, j] for k, i, j in zip(*np.nonzero(sees), strict=True) if not sees[k, j, i]]
    assert said["yaw_error_mutual"] == pytest.approx(np.mean(both))
    assert said["yaw_error_one_sided"] == pytest.approx(np.mean(one))
    p = data["position"].values
    away = np.linalg.norm(p[:, :, None] - p[:, None], axis=3)
    at_instants = (away + 9 * np.eye(6)).min()
    assert at_instants - 0.01 <= said["min_separation_m"] <= at_instants
    held = [k for k in range(len(p) - 1) if np.linalg.norm(data["stick"].values[k]) > 0]
    leader, followers = p[:, 0], p[:, 1:].mean(axis=1)
    paths = [sum(np.linalg.norm(q[k + 1] - q[k]) for k in held) for q in (followers, leader)]
    assert len(held) > 100 and said["followed"] == pytest.approx(paths[0] / paths[1])
    command = data["velocity_command"].values
    change = [np.linalg.norm(command[k + 1, 1:] - command[k, 1:], axis=1) for k in range(100, 150)]
    assert said["command_change_m_s"] == pytest.approx(np.quantile(change, 0.999))
    assert json.loads(json.dumps(said)) == said


def test_quantities_without_a_value_are_absent_from_the_summary():
    held = 'stick={kind="recorded", times_s=[0], velocities_m_s=[[0, 0, 0]]}'
    run, mission = flown("agents=2", "obstacles.count=0", held)
    said = check_run(run.recorded, mission).summary
    assert "min_obstacle_distance_m" not in said and said["waypoints"] == 0
    assert "followed" not in said and "command_change_m_s" in said


def test_separation_includes_passages_between_instants(rng):
    position = np.array([[[0, 0, 0], [1, 0.1, 0]], [[1, 0, 0], [0, 0.1, 0]]], dtype=float)
    every = np.ones((2, 2), dtype=bool)
    found = find_closest_approach(position, every)
    assert found.distance == pytest.approx(0.1) and found[1:] == (0, (0, 1), 0.5)
    lost, never = np.array([[True, True], [True, False]]), np.array([[True, False]] * 2)
    assert find_closest_approach(position, lost) == found  # it has moved until it was lost
    alone = find_closest_approach(position[:1], every[:1])
    assert alone.distance == pytest.approx(np.hypot(1, 0.1))
    assert find_closest_approach(position, never).distance == np.inf
    walk, s = rng.standard_normal((9, 4, 3)), np.linspace(0, 1, 400)[:, None, None]
    fine = np.concatenate([a + s * (b - a) for a, b in pairwise(walk)])
    away = np.linalg.norm(fine[:, :, None] - fine[:, None], axis=3) + 9 * np.eye(4)
    found = find_closest_approach(walk, np.ones((9, 4), dtype=bool))
    assert found.distance == pytest.approx(away.min(), abs=0.02)
    _, i, j = np.unravel_index(away.argmin(), away.shape)
    assert found.pair == tuple(sorted((i, j)))


def test_separation_includes_fast_passages_between_distant_instants():
    x = np.array([[0.0, 0.5, 60], [0, 19, 60], [19, 0, np.nan], [19, 0, 60]])
    position = np.stack([x, np.tile([0.0, 0.1, 0.0], (4, 1))], axis=2)
    found = find_closest_approach(position, np.ones((4, 3), dtype=bool))
    assert found == (pytest.approx(0.1), 1, (0, 1), pytest.approx(0.5, abs=0.05))


def test_agents_without_a_next_position_count_where_they_are():
    position = np.array([[[0, 0], [0.1, 0]], [[5, 0], [np.nan, np.nan]]])
    found = find_closest_approach(position, np.ones((2, 2), dtype=bool))
    assert found == (pytest.approx(0.1), 0, (0, 1), 0.0)


def test_recorded_velocity_is_in_the_world_frame(honest):
    run, mission = honest
    p, v = run.data["position"].values, run.data["velocity"].values
    assert np.diff(p, axis=0) / mission.step == pytest.approx(v[1:], abs=0.1)
    record = ConnectivityRecord.from_data(run.recorded, mission)
    error = np.abs(record.frames.yaw_estimate_error[0][record.frames.visibility[0]])
    assert error.max() <= 0.5 and error.max() > 0.05  # as drawn, but for the first correction
    frame = next(simulate(mission, np.random.default_rng(0)))
    assert describe_progress(mission, frame)[:3] == ("connected", 0, 150)
