"""Evasion: ways out of what moves, alone and together with those in the way."""

import numpy as np
import pytest
from reconfiguration_runs import crowd_in_the_way, make_mission

import sato
from problems.obstacle_paths import is_path_clear
from sato.reconfiguration import commitment
from sato.shapes.shape import Points

R = 0.5


WORLDS = {
    "sphere": {},
    "box": {"is_box": True},
    "ellipsoids": {"separation_axes": (1.0, 0.8)},
    "unequal": {"collision_radius": [0.5, 0.45, 0.5, 0.5, 0.4, 0.5, 0.5, 0.5, 0.45]},
    "noise": {"disturbance": 2e-4, "position_noise": 1e-4},
}


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("world", WORLDS)
def test_crowd_evades_what_comes_over_it(world, seed):
    mission = crowd_in_the_way(np.random.default_rng(seed), **WORLDS[world])
    run = sato.run(mission, seed=seed)
    assert not run.summary["broken"]


def test_crowd_without_evasion_is_hit(monkeypatch):
    monkeypatch.setattr(commitment, "find_evasions", lambda *_: {})
    run = sato.run(crowd_in_the_way(np.random.default_rng(0)), seed=0)
    assert run.summary["min_obstacle_distance_m"] < 0.9 * R


def test_evasions_keep_limits_and_all_others_make_room(monkeypatch):
    changed, find = [], commitment.find_evasions

    def note(mission, horizon, reports):
        after, before = find(mission, horizon, reports), {r.agent: r for r in reports}
        changed.append((mission, before, after))
        return after

    monkeypatch.setattr(commitment, "find_evasions", note)
    for seed in range(2):
        sato.run(crowd_in_the_way(np.random.default_rng(seed)), seed=seed)
    made_room = 0
    for mission, before, after in changed:
        now = before | after
        places = np.array([now[i].path[:, 0] for i in sorted(now)])
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        assert apart[np.triu_indices(len(now), 1)].min() >= R * (1 - 1e-9)
        for i, report in after.items():
            assert not mission.planned_control_limit(i).is_exceeded(report.u).any()
            assert any(is_path_clear(report.path, obstacles) for _, obstacles in report.looks)
            made_room += is_path_clear(before[i].path, before[i].looks[-1][1])
    assert made_room


def test_vehicles_that_have_arrived_evade_while_others_wait_to_join(rng):
    # One sphere passes the place of the join until about 30 s, and another the targets from 10 s.
    places = np.array([[-1.5, 0.0], [0.0, 0.0], [1.5, 0.0], [3.0, 0.0]])
    places += rng.normal(0.0, 0.02, places.shape)
    join = sato.Join(1, Points(places[3:] + np.array([0.0, 1.0])), at_step=5)
    passing = sato.Sphere((3.2, -3.0), 0.3, velocity=(0.0, 0.15))
    coming = sato.Sphere((-5.5, 0.1), 0.3, velocity=(0.3, 0.0))
    limits = {"max_control": 0.2, "max_speed": 0.6, "collision_radius": R, "comm_radius": 9.0}
    leg, obstacles = sato.Leg(places, 8, joins=(join,)), (passing, coming)
    run = sato.run(make_mission(places[:3], leg, obstacles=obstacles, **limits), seed=0)
    joined = int(run.data.alive.values[:, 3].argmax())
    assert joined > 8
    assert run.summary["min_obstacle_distance_m"] >= R
    assert run.summary["min_separation_m"] >= R
    assert run.summary["reached"]
