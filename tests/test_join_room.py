"""Joins without room: vehicles that wait, and vehicles that do not join."""

from itertools import islice

import numpy as np
import pytest
from reconfiguration_runs import make_mission, row
from recorded_run import altered

import sato
from sato.reconfiguration import loop


def stay(places, **changes):
    """Three vehicles that stay, and others that join among them at step 1 and fly away."""
    start = 2 * row(3, 0.0)
    away = np.c_[2 * np.arange(len(places)), np.full(len(places), 9.0)]
    leg = sato.Leg(
        sato.Points(np.vstack([start, away]), keep_order=True),
        "auto",
        joins=[sato.Join(len(places), places, at_step=1, room="refuse")],
    )
    limits = {"assignment": "given", "comm_radius": 40.0, "max_control": 0.4}
    return make_mission(start, leg, **(limits | changes))


def test_vehicles_are_refused_if_and_only_if_they_have_no_room(rng):
    counts = np.zeros(2, dtype=int)
    for _ in range(5):
        places = np.zeros((0, 2))
        while len(places) < 12:
            drawn = rng.uniform([-3, -1], [3, 1])
            if (np.linalg.norm(places - drawn, axis=1) >= 0.5).all():
                places = np.vstack([places, drawn])
        flight = loop.simulate(stay(places), np.random.default_rng(0))
        events = [event for frame in islice(flight, 2) for event in frame.events]
        refused = [i for event in events if event["kind"] == "refused" for i in event["agents"]]
        joined = [i for event in events if event["kind"] == "join" for i in event["agents"]]
        away = np.linalg.norm(places[:, None] - 2 * row(3, 0.0), axis=2).min(axis=1)
        assert refused == (3 + np.flatnonzero(away < 0.5)).tolist()
        assert sorted(refused + joined) == list(range(3, 15))
        counts += len(refused), len(joined)
    assert counts.all() and counts.sum() == 60


def test_missions_in_which_one_is_surely_refused_are_refused_themselves():
    # The starts are farther apart than R, and not than R and the margin.
    for room, steps in (("wait", 0), ("refuse", 1)):
        join_with_margin(room, steps)
    with pytest.raises(sato.InputError, match=r"leg\.0\.join: agent 2 cannot join and stop clear"):
        join_with_margin("refuse", 0)


def join_with_margin(room, at_step):
    """A mission in which a vehicle joins 0.6 m from another, where both keep 0.5 m and 0.3 m."""
    joins = [sato.Join(1, [[-1.0, 0.6]], at_step=at_step, room=room)]
    return make_mission(2 * row(2, 0.0), sato.Leg(2 * row(3, 4.0), 40, joins=joins), margin=0.3)


def test_a_vehicle_that_waits_cannot_be_lost_meanwhile():
    joins = [sato.Join(1, [[-1.0, 0.1]], at_step=1)]
    loss = sato.Loss("agents", agents=(2,), at_step=2)
    leg = sato.Leg(2 * row(3, 4.0), 40, joins=joins, losses=[loss])
    run = sato.run(make_mission(2 * row(2, 0.0), leg, comm_radius=20.0))
    (join,) = run.events("join")
    assert join["agents"] == [2] and join["time"] > 2.0
    assert run.data.alive.values[-1].all() and run.check().kept


def test_a_vehicle_without_room_at_its_step_is_refused_and_the_run_is_kept():
    joins = [sato.Join(1, 2 * row(3, 0.1)[:1], at_step=1, room="refuse")]
    away = sato.Leg(2 * row(4, 4.0), 30, joins=joins)
    run = sato.run(make_mission(2 * row(3, 0.0), away, comm_radius=20.0))
    (refused,) = run.events("refused")
    assert (refused["time"], refused["agents"]) == (1.0, [3])
    assert not run.events("join") and not run.data.alive.values[:, 3].any()
    assert run.summary["reached"] and run.check().kept
    events = run.recorded["event"]
    run = altered(run, "event", ["refused" in str(e) for e in events], events[0])
    assert "alive" in {promise.name for promise in run.check().broken}


def test_a_spacecraft_that_waits_to_join_is_no_fault_of_the_run():
    start = np.zeros((2, 3))
    start[1, 1] = 200.0
    goal = np.vstack([start + np.array([0.0, 400.0, 0.0]), start[:1]])
    join = sato.Join(1, start[:1] + 5.0, at_step=1)
    leg = sato.Leg(sato.Points(goal, keep_order=True), 40, joins=[join])
    limits = {
        "assignment": "given",
        "step": 30.0,
        "comm_radius": 2e3,
        "max_control": 0.01,
        "max_speed": 2.0,
    }
    mission = make_mission(
        start, leg, model=sato.ClohessyWiltshire(1.1e-3), collision_radius=20.0, **limits
    )
    run = sato.run(mission)
    (join,) = run.events("join")
    assert join["time"] > 30.0
    assert {promise.name for promise in run.check().broken} <= {"reached"}


def test_vehicles_wait_for_room_also_from_the_first_step():
    start, targets = 4 * row(2, 0.0), 2 * row(4, 9.0)
    places = (start[:1], [[9.0, 0.0]], [[9.1, 0.0]])
    joins = [sato.Join(start=place, at_step=0) for place in places]
    leg = sato.Leg(np.vstack([targets, [[9.0, 9.0]]]), 60, joins=joins)
    run = sato.run(make_mission(start, leg))
    assert run.summary["reached"] and run.check().kept
    assert run.data["alive"].values[0].tolist() == [True, True, False, True, False]
