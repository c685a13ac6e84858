"""Vehicles with limits of their own, and limits of each axis, in whole missions."""

from dataclasses import replace

import numpy as np
import pytest
from reconfiguration_runs import make_mission
from recorded_run import altered

import sato
from dynamics.trajectory_geometry import control_points, evaluate_bezier, separations
from problems.limit import Limit
from sato.scenario.errors import InputError
from sato.scenario.file import read

ANGLE = np.arange(4) * np.pi / 2
START = 3.0 * np.c_[np.cos(ANGLE), np.sin(ANGLE)]
LIMITS = {"max_control": 0.1, "max_speed": 0.5}
BOX = {"max_control_axes": (0.06, 0.12), "max_speed_axes": (0.3, 0.5), "speed_norm": "inf"}
OWN = {"max_control": (0.05, 0.15, 0.1, 0.12), "max_speed": (0.3, 0.4, 0.6, 0.5)}


def mission(rng=None, **changes):
    """Four that cross a ring to given targets, not quite opposite."""
    aside = np.zeros_like(START) if rng is None else rng.normal(0, 0.3, START.shape)
    values = {
        "model": sato.DoubleIntegrator(2),
        "start": START,
        "legs": [sato.Leg(aside - START, steps=32)],
        "step": 1.0,
        "comm_radius": 30.0,
        "collision_radius": 0.5,
        "foresight_steps": 32,
        "assignment": "given",
    }
    return sato.Reconfiguration(**(values | changes))


@pytest.mark.parametrize("limits", [BOX, OWN], ids=["box", "own"])
def test_flights_keep_limits_of_each_axis_and_vehicle(rng, limits, tmp_path):
    run = sato.run(mission(rng, **limits))
    flown, report = run.mission, run.check()
    assert report.kept, str(report)
    u, v = np.abs(run.data["control"].values[:-1]), run.data["velocity"].values
    if "max_control" in limits:
        assert (u <= np.array(limits["max_control"])[:, None] * (1 + 1e-9)).all()
        assert (np.linalg.norm(v, axis=2) <= np.array(limits["max_speed"]) * (1 + 1e-6)).all()
        assert (u.max(axis=(0, 2)) > 0.5 * np.array(limits["max_control"])).any()
    else:
        assert (u <= np.array(BOX["max_control_axes"]) * (1 + 1e-9)).all()
        assert (np.abs(v) <= np.array(BOX["max_speed_axes"]) * (1 + 1e-6)).all()
    run.save(tmp_path)
    assert sato.load(tmp_path).check().kept
    assert sato.load(tmp_path).mission == flown
    k, i = np.unravel_index(np.argmax(u.max(axis=2)), u.shape[:2])
    more = 1.01 * flown.control_limit(int(i)).most / u[k, i].max()
    faster = altered(run, "control", (k, i), more * run.recorded["control"][k, i])
    assert not faster.check().kept


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, "model.max_control_m_s2: is missing"),
        (LIMITS | {"max_control_axes": (0.1, 0.1)}, "is given beside max_control_m_s2"),
        (BOX | {"max_speed": 0.4}, "is given beside max_speed_m_s"),
        (BOX | {"max_control_axes": (0.1, 0.1, 0.1)}, "has 3 entries, and the model has 2 axes"),
        (BOX | {"max_control_axes": (0.1, 0.0)}, "must be greater than 0, got 0"),
        (LIMITS | {"speed_norm": True}, r"speed_norm: must be 1, 2 or \"inf\", got true"),
        (BOX | {"control_norm": 2}, r"control_norm = 2; control_norm = \"inf\" would do"),
        (BOX | {"speed_norm": 2}, r"speed_norm = 2; speed_norm = \"inf\" would do"),
        (OWN | {"max_control": (0.1, 0.2)}, "has 2 entries for 4 vehicles"),
        (OWN | {"max_speed": (0.1, 0.2, -0.1, 0.3)}, r"max_speed_m_s\.2: .*greater than 0, got -0"),
    ],
)
def test_limits_that_do_not_fit_are_refused_with_those_that_would(changes, message):
    with pytest.raises(InputError, match=message):
        mission(**changes)


def test_limits_survive_a_file_in_other_units(tmp_path):
    path = tmp_path / "mission.toml"
    written = mission(**OWN).to_toml()
    path.write_text(written)
    assert read(path).max_control == OWN["max_control"]
    path.write_text(written.replace("max_control_m_s2 = [", "max_control_mm_s2 = ["))
    assert read(path).max_control == pytest.approx(1e-3 * np.array(OWN["max_control"]))


def test_equal_lists_fly_as_numbers_do(rng):
    lists = {name: (value,) * 4 for name, value in LIMITS.items()}
    aside = mission(rng, **LIMITS)
    one, other = sato.run(aside), sato.run(replace(aside, **lists))
    np.testing.assert_array_equal(one.data["position"], other.data["position"])


@pytest.mark.parametrize("speeds", [(0.5,), (np.inf, 0.5), (np.inf, np.inf)])
def test_lists_of_one_entry_and_of_no_limit_survive_a_run_file(speeds, tmp_path):
    count = len(speeds)
    many = {"start": START[:count], "legs": [sato.Leg(START[:count] + 3.0, steps=20)]}
    limits = {"max_control": (0.1,) * count, "max_speed": speeds, "allow_undetectable": True}
    run = sato.run(mission(**many, **limits))
    run.save(tmp_path)
    report = sato.load(tmp_path).check()
    assert report.kept, str(report)
    speed = next(promise for promise in report.promises if promise.name == "speed")
    assert np.isinf(speed.tolerance) == np.isinf(speeds).all()


def test_slow_vehicles_are_told_what_would_do():
    with pytest.raises(InputError, match=r"agent 0 can reach none .* times the limits"):
        sato.run(mission(**OWN | {"max_control": (0.01, 0.1, 0.1, 0.1)}))


def test_the_largest_speed_in_a_norm_is_that_of_its_set():
    assert Limit(0.5, 2, 3).largest_length == Limit(0.5, 1, 3).largest_length == 0.5
    assert Limit(0.5, "inf", 2).largest_length == pytest.approx(0.5 * 2**0.5)
    assert mission(**BOX).top_speeds == pytest.approx([(0.3**2 + 0.5**2) ** 0.5])


RADII = (0.3, 0.9, 0.5, 0.7)


def dense_distances(run, parts=20):
    """Sample the distances of all pairs, exactly for a double integrator."""
    p, v, u = (run.data[name].values for name in ("position", "velocity", "applied_control"))
    t = np.linspace(0, 1, parts)[:, None, None, None]
    p = (p[:-1] + v[:-1] * t + u[:-1] * t**2 / 2).reshape(-1, *p.shape[1:])
    return np.linalg.norm(p[:, :, None] - p[:, None], axis=3).min(axis=0)


def test_each_pair_keeps_the_mean_of_its_radii(rng):
    own = mission(rng, collision_radius=RADII, orders=2, **LIMITS)
    run = sato.run(own)
    assert run.check().kept and run.summary["reached"] and not run.summary["slack_used"]
    required = np.add.outer(RADII, RADII) / 2
    relative = (dense_distances(run) / required)[np.triu_indices(4, 1)]
    assert relative.min() == pytest.approx(run.summary["min_relative_separation"], rel=1e-3)
    assert 1 - 1e-9 <= relative.min() < 1.01
    # The others have no more room than they need: some come nearer than the largest pair may.
    assert dense_distances(run)[np.triu_indices(4, 1)].min() < 0.8
    wider = replace(own, collision_radius=(0.3, 0.9, 0.5, 0.8))
    promise = sato.Run(run.recorded, run.summary, wider).check().broken
    assert "separation" in {each.name for each in promise}


def test_relative_separation_is_that_of_the_worst_pair(rng):
    for _ in range(5):
        x, v, radii = rng.normal(size=(6, 7, 3)), rng.normal(size=(6, 7, 3)), rng.uniform(1, 3, 7)
        alive = rng.random((6, 7)) < 0.9
        found = separations(x, v, alive, 0.5, radii)
        points = np.moveaxis(control_points(np.moveaxis(x, 0, 1), np.moveaxis(v, 0, 1), 0.5), 0, 1)
        for k in range(5):
            path = np.array([evaluate_bezier(points[k], t) for t in np.linspace(0, 1, 400)])
            gap = np.linalg.norm(path[:, :, None] - path[:, None], axis=3).min(axis=0)
            gap /= np.add.outer(radii, radii) / 2
            i, j = np.nonzero(np.triu(np.outer(alive[k], alive[k]), 1))
            assert found.distance[k] == pytest.approx(gap[i, j].min(), rel=1e-3, abs=1e-3)
            assert found.distance[k] <= gap[i, j].min() + 1e-12


def test_the_vehicle_of_highest_priority_flies_as_if_it_were_alone():
    fuel = {}
    for first in (1, 2):
        order = tuple(float(i == first) for i in range(4))
        run = sato.run(mission(priority=order, **LIMITS))
        assert run.check().kept
        control = run.data["control"].values[:-1]
        fuel[first] = np.abs(control).sum(axis=(0, 2))
    alone = 2 * 6 / 32  # about the least fuel of a way of 6 m, in 32 s
    for first, each in fuel.items():
        assert each[first] == pytest.approx(min(f[first] for f in fuel.values()), rel=1e-6)
        assert alone < each[first] < 1.3 * alone and (each > 1.001 * each[first]).any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"collision_radius": (0.5, 0.5)},
            "collision_radius_m: has 2 entries for 4 vehicles",
        ),
        ({"priority": (1.0, 2.0)}, "swarm.priority: has 2 entries for 4 vehicles"),
        ({"priority": (1, 2, 3, 4), "orders": 2, "bargains": 1}, "bargains = 0, or no priorities"),
        ({"collision_radius": (0.5, 0.5, 0.5, -0.5)}, "collision_radius_m.3: .*greater than 0"),
        ({"collision_radius": RADII, "comm_radius": 1.0}, "which is 4.8 m"),
    ],
)
def test_radii_and_priorities_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        mission(**LIMITS | changes)


def test_entries_of_those_that_join_come_after_those_of_the_start():
    late = [sato.Join(None, np.array([[6.0, 0.0]]), at_step=4)]
    legs = [sato.Leg(np.vstack([-START, [[6.0, 3.0]]]), steps=32, joins=late)]
    with pytest.raises(InputError, match="4 entries for 5 vehicles, those that join included"):
        mission(legs=legs, collision_radius=RADII, **LIMITS)
    near = mission(legs=legs, collision_radius=(*RADII, 0.4), **LIMITS)
    np.testing.assert_array_equal(near.radii, (*RADII, 0.4))


def test_starts_are_checked_pair_by_pair():
    start = np.array([[0.0, 0.0], [0.7, 0.0], [4.0, 0.0], [5.0, 0.0]])
    legs = [sato.Leg(start[::-1], steps=40)]
    radii = {"legs": legs, "start": start, "comm_radius": 60.0}
    with pytest.raises(InputError, match=r"agent 0 starts 0\.7 m from agent 1, closer .* 0\.8 m"):
        sato.run(
            mission(collision_radius=(0.4, 1.2, 0.4, 0.4), assignment="given", **LIMITS | radii)
        )


def test_given_targets_of_unequal_vehicles_keep_the_distance_of_their_pair():
    start = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.6]])
    radii = {"collision_radius": (2.0, 0.5, 0.5), "comm_radius": 40.0, "max_speed": 1.0}
    for targets in (start + np.array([0.0, 6.0]), start):
        mission = make_mission(start, sato.Leg(targets, "auto"), assignment="given", **radii)
        run = sato.run(mission)
        assert run.summary["reached"] and run.check().kept
    alone = make_mission(
        start[:1],
        sato.Leg(start[:1], 5),
        assignment="given",
        collision_radius=(2.0,),
        max_speed=0.1,
    )
    assert alone.find_tightest(np.hstack([start, 0 * start])) == (pytest.approx(0.6), 2.0)
    near = start - [[0, 0], [3, 0], [3, 0]]  # 1 m from the first, where the two keep 1.25 m
    with pytest.raises(InputError, match=r"target 0 is 1 m from target 1, .* 1\.2500012 m"):
        make_mission(start, sato.Leg(near, "auto"), assignment="given", **radii)
    with pytest.raises(InputError, match=r"3 targets are 0\.6 m apart"):
        make_mission(start, sato.Leg(start, "auto"), **radii)
    with pytest.raises(InputError, match=r"takes 0\.2 m beyond the collision radius of 0\.5 m"):
        make_mission(start, sato.Leg(start, "auto"), assignment="given", margin=0.2, **radii)
