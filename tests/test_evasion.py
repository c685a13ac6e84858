"""Evasion: ways out of what moves, alone and together with those in the way."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from reconfiguration_runs import crowd_in_the_way, make_mission

import sato
from problems.obstacle_paths import ObstaclePaths, is_path_clear, measure_gaps
from sato.reconfiguration import commitment
from sato.reconfiguration.evasion import EvasionReport, find_evasions
from sato.reconfiguration.stopping import stopping_horizon
from sato.shapes.shape import Points

R = 0.5


WORLDS = {
    "sphere": {},
    "box": {"is_box": True},
    "ellipsoids": {"separation_axes": (1.0, 0.8)},
    "unequal": {"collision_radius": [0.5, 0.45, 0.5, 0.5, 0.4, 0.5, 0.5, 0.5, 0.45]},
    "noise": {"disturbance": 2e-4, "position_noise": 1e-4},
}


@pytest.mark.parametrize(("world", "seed"), [*zip(WORLDS, [0, 1, 0, 1, 0], strict=True)])
def test_crowd_evades_what_comes_over_it(world, seed):
    mission = crowd_in_the_way(np.random.default_rng(seed), **WORLDS[world])
    run = sato.run(mission, seed=seed)
    assert not run.summary["broken"]


def test_crowd_without_evasion_is_hit(monkeypatch):
    monkeypatch.setattr(commitment, "find_evasions", lambda *_: {})
    run = sato.run(crowd_in_the_way(np.random.default_rng(0)), seed=0)
    assert run.summary["min_obstacle_distance_m"] < 0.9 * R


@cache
def record_evasions():
    """Fly a crowd; return the arguments of each evasion, and what changes."""
    found, find = [], commitment.find_evasions

    def note(*own):
        found.append((*own, find(*own)))
        return found[-1][-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(commitment, "find_evasions", note)
        sato.run(crowd_in_the_way(np.random.default_rng(0)), seed=0)
    return found


def test_evasions_keep_limits_and_all_others_make_room():
    made_room, changes = 0, 0
    for mission, horizon, reports, after in record_evasions():
        before = {report.agent: report for report in reports}
        now = before | after
        places = np.array([now[i].path[:, 0] for i in sorted(now)])
        apart = np.linalg.norm(places[:, None] - places, axis=-1)
        assert apart[np.triu_indices(len(now), 1)].min() >= R * (1 - 1e-9)
        for i, own in after.items():
            check_limits(mission, horizon, own)
            assert keeps_from_bodies(before[i], own)
            made_room += is_path_clear(before[i].path, before[i].looks[-1][1])
            changes += 1
    assert made_room
    assert changes > 5


def check_limits(mission, horizon, own):
    """Check limits, rest and reach of a report; return the largest speed and way."""
    x = horizon.discrete_model.simulate(own.state, own.u)
    np.testing.assert_allclose(own.path, horizon.control_points(x, own.u), atol=1e-12)
    assert not mission.planned_control_limit(own.agent).is_exceeded(own.u).any()
    assert not mission.speed_limit(own.agent).is_exceeded(x[1:, 2:]).any()
    np.testing.assert_allclose(x[-1, 2:], 0.0, atol=1e-12)
    way = np.linalg.norm(x[:, None, :2] - x[:, :2], axis=-1).max()
    assert way <= (mission.comm_radius - R) / 2 * (1 + 1e-9)
    return np.abs(x[:, 2:]).max(), way


def keeps_from_bodies(before, now):
    """Tell whether a changed path comes no nearer to a body, in a look, than its own or R."""

    def keeps(known):
        was, after = (measure_gaps(own.path - known.paths, known)[0] for own in (before, now))
        return (after >= np.minimum(was.min(), known.clearance[:, None]) * (1 - 1e-9)).all()

    return any(known is None or keeps(known) for _, known in before.looks)


def test_evasions_of_one_beyond_its_limits_keep_these_from_then_on():
    found = record_evasions()
    mission, horizon, reports, after = max(found, key=lambda own: len(own[-1]))
    moved = 0
    for i in after:
        fast, u = reports[i].state.copy(), np.zeros_like(reports[i].u)
        fast[2:], u[:4, 1] = (0.0, 0.9), -0.9 / 4  # beyond V and U
        path = horizon.control_points(horizon.discrete_model.simulate(fast, u), u)
        own = replace(reports[i], state=fast, u=u, path=path)
        changed = find_evasions(mission, horizon, [*reports[:i], own, *reports[i + 1 :]])
        for one in changed.values():
            check_limits(mission, horizon, one)
        moved += len(changed)
    assert moved


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


def make_reports(rng, hopeless=False, **changes):
    """One that a body comes over beside one at rest, and another far away."""
    places = np.array([[0.0, 0.0], [20.0, 0.0]])
    limits = {"comm_radius": 60.0, "collision_radius": R} | changes
    mission = make_mission(places, sato.Leg(places, 5), **limits)
    horizon = stopping_horizon(mission, 30)
    pieces = len(horizon.fine_model)
    time = (np.arange(pieces)[:, None] + np.arange(4) / 3) * horizon.fine_model.dt

    def bodies(center, velocity):
        moves = time[..., None] * np.array(velocity)[:, None, None]
        paths = np.array(center)[:, None, None] + moves
        clearance = np.full(len(center), R)
        return ObstaclePaths(paths, np.zeros((len(center), 1, 2)), clearance, np.array(velocity))

    coming = bodies([[-3.0, 0.1 * rng.normal()], [1.1, 0.0]], [[0.2, 0.0], [0.0, 0.0]])
    if hopeless:  # closed in within a step
        ring = 20.0 + 0.55 * np.cos(np.arange(12)), 0.55 * np.sin(np.arange(12))
        shut = bodies(np.column_stack(ring), (np.array([20.0, 0.0]) - np.column_stack(ring)) / 2)
    else:
        shut = bodies([[25.0, 0.0]], [[0.0, 0.0]])
    reports = []
    for i, (place, known) in enumerate(zip(places, (coming, shut), strict=True)):
        state, u = np.append(place, [0.0, 0.0]), np.zeros((horizon.steps, 2))
        path = horizon.control_points(horizon.discrete_model.simulate(state, u), u)
        reports.append(EvasionReport(i, (0.0, 0.0, i), state, u, path, R, ((3, known),)))
    return mission, horizon, reports


@pytest.mark.parametrize("hopeless", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_one_evades_whatever_becomes_of_another_far_away(seed, hopeless):
    mission, horizon, reports = make_reports(np.random.default_rng(seed), hopeless)
    after = find_evasions(mission, horizon, reports)
    assert is_path_clear(after[0].path, after[0].looks[-1][1])
    if 1 in after:  # no nearer to anything than it was
        known = reports[1].looks[-1][1]
        now, before = (
            measure_gaps(own.path - known.paths, known)[0].min(axis=1)
            for own in (after[1], reports[1])
        )
        assert (now >= np.minimum(before, R) * (1 - 1e-9)).all()
    else:
        assert hopeless or is_path_clear(reports[1].path, reports[1].looks[-1][1])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("norm", ["inf", 2])
def test_evasions_keep_a_speed_limit_that_binds(seed, norm):
    own = make_reports(np.random.default_rng(seed), max_speed=0.036, speed_norm=norm)
    fastest, _ = check_limits(*own[:2], find_evasions(*own)[0])
    assert fastest > 0.9 * 0.036


@pytest.mark.parametrize("seed", range(3))
def test_evasions_stay_within_reach(seed):
    for comm_radius in (1.5, 1.4):  # just enough, and too little
        changes = {"max_speed": 0.1, "comm_radius": comm_radius}
        mission, horizon, reports = make_reports(np.random.default_rng(seed), **changes)
        after = find_evasions(mission, horizon, reports)
        for own in after.values():
            check_limits(mission, horizon, own)
        assert (0 in after) == (comm_radius == 1.5)
