"""Missions whose vehicles never come too close, and starts from which they could."""

import tracemalloc

import numpy as np
import pytest
from commitment_examples import (
    begin,
    continuous_separation,
    least_distances,
    random_mission,
    sample,
    stop_at_once,
    swarms,
)
from reconfiguration_runs import at_rest, fly, leg_to, make_mission, row

import sato
from problems.path_separation import are_hulls_separated
from sato.reconfiguration import first_commitment, loop
from sato.reconfiguration.check.promises import check_separation
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.first_commitment import find_first_commitments
from sato.reconfiguration.stopping import (
    pad_controls,
    stays_within_reach,
    stopping_horizon,
)


@pytest.mark.parametrize("joins", [False, True])
def test_start_that_cannot_stop_within_reach_is_refused(joins):
    # The second stops after 5.25 m; the first does not hear it, and would go to meet it.
    start = np.array([[0.0, 0.0, 0.0, 0.0], [6.0, 0.0, -1.0, 0.0]])
    join = sato.Join(1, sato.Points(start[1:, :2], start[1:, 2:]), at_step=0)
    leg = sato.Leg(np.array([[12.0, 0.0], [-6.0, 3.0]]), 60, joins=(join,) if joins else ())
    limits = {"max_control": (0.5, 0.1), "max_speed": 1.0, "comm_radius": 4.6}
    limits |= {"horizon_steps": 2, "auction_steps": 2, "assignment": "given"}
    place = "leg.join.start" if joins else "swarm.start"
    with pytest.raises(sato.InputError, match=f"{place}: agent 1 needs .* m to stop"):
        make_mission(start[:1] if joins else start, leg, **limits)


@pytest.mark.parametrize("keeps_plans", [True, False])
def test_vehicles_never_come_closer_than_their_distance(monkeypatch, keeps_plans):
    if not keeps_plans:
        monkeypatch.setattr(sato.Reconfiguration, "keeps_plans", False)
    cautious = solves = 0
    for seed in range(30):
        mission = random_mission(np.random.default_rng([19, seed]))
        frames = begin(mission, 30)
        assert continuous_separation(mission, frames) >= 1 - 1e-9, seed
        events = [event for frame in frames for event in frame.events]
        cautious += sum(event["kind"] == "cautious" for event in events)
        solves += sum(event.get("solves", 0) for event in events)
    assert solves > 300  # they are in each other's way
    assert keeps_plans or cautious > 20


def test_first_commitments_are_clear_within_reach_and_end_at_rest():
    bent = 0
    for seed in (59, 371, 432, *range(100)):  # the first three would leave reach to stop clear
        rng, d = np.random.default_rng([3, seed]), 2
        n, speed = int(rng.integers(2, 6)), 0.35 if seed == 59 else 0.45
        places = swarms.place(rng, np.full(n, 0.6), 1.2, d)
        start = np.hstack([places, rng.normal(0, speed, (n, d))])
        leg = sato.Leg(3.0 * np.arange(n)[:, None] * np.eye(d)[0], 60)
        limits = {"max_control": 0.2, "max_speed": 1.0, "horizon_steps": 1, "comm_radius": 2.51}
        try:
            mission = make_mission(start, leg, replan_steps=1, auction_steps=1, **limits)
        except sato.InputError:
            continue
        committed = find_first_commitments(mission)
        u = pad_controls([committed[i].u for i in range(n)], len(committed[0].u))
        horizon = stopping_horizon(mission, u.shape[1])
        x = horizon.discrete_model.simulate(start, u)
        assert np.abs(x[:, -1, d:]).max() <= 1e-12
        least = least_distances(sample(x, u, mission.step)) + 9 * np.eye(n)
        assert least.min() >= mission.collision_radius - 1e-9
        path = horizon.control_points(x, u)
        assert stays_within_reach(mission, horizon, x, path).all()
        at_once = [stop_at_once(mission.control_limit(i), start[i, d:], 1.0)[0] for i in range(n)]
        bent += not np.allclose(u[:, 0], at_once)
    assert bent > 0


def test_pairs_that_meet_are_those_of_all_pairs_in_little_memory(rng):
    for agents, gap in ((60, 2.5), (1000, 12.0)):
        middle, d = rng.uniform(0, gap * agents**0.5, (agents, 1, 1, 2)), 2
        paths = middle + np.cumsum(rng.normal(0, 0.02, (agents, 80, 4, d)), axis=1)
        paths[: agents // 4] += 4 * np.linspace(0, 1, 80)[:, None, None]
        clearance = rng.uniform(0.5, 1.0, agents)
        tracemalloc.start()
        found = first_commitment._find_meeting(paths, clearance)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 1e8  # all pairs of 1,000 at once would take 2.6e9
        met = [
            [i, j]
            for i in range(30)
            for j in range(i + 1, agents)
            if not are_hulls_separated(paths[i] - paths[j], clearance[[i, j]].mean()).all()
        ]
        assert found[found[:, 0] < 30].tolist() == met
        assert met


def test_vehicles_that_wait_for_others_hold_their_targets():
    # The third joins far away, and begins its clock again. Vehicles that did
    # no more than stop would drift by 0.07 m.
    targets = np.vstack([row(2, 0.0), [[60.0, 3.0]]])
    leg = sato.Leg(targets, 60, joins=[sato.Join(1, [[60.0, 0.0]], at_step=58)])
    mission = make_mission(row(2, 0.0), leg, disturbance=4e-3, replan_steps=1, margin=0.1)
    run = sato.run(mission)
    away = np.linalg.norm(run.data.position.values[60:, :2] - targets[:2], axis=2)
    assert len(away) >= 58 and away.max() < 0.03
    assert run.summary["reached"] and [e["agents"] for e in run.events("reset")] == [[2]]


def test_leg_goes_on_where_its_deadline_comes_between_two_auctions():
    # Six meet in the middle; one of them is not there at the deadline, two steps before an auction.
    turn = np.arange(6) * np.pi / 3
    start = 1.6 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    start += np.random.default_rng([5, 3]).normal(0, 0.02, (6, 2))
    leg = leg_to(at_rest(-start), 14)
    mission = make_mission(start, leg, assignment="given", max_control=0.2)
    assert (mission.replan_steps, mission.auction_steps) == (2, 4)
    away = np.linalg.norm(fly(mission)[-1].position + start, axis=1)
    assert away.max() <= mission.position_tolerance


def test_commitments_do_not_grow_with_noise():
    leg, noise = leg_to(at_rest(row(3, 3.0)), 20), {"position_noise": 0.01, "velocity_noise": 0.003}
    mission = make_mission(row(3, 0.0), leg, comm_radius=20.0, replan_steps=1, **noise)
    flight = loop._Flight(mission, np.random.default_rng(0))
    steps = [max(len(own.u) for own in flight.committed.values()) for _ in flight.fly_leg(0)]
    assert len(steps) == 20 and max(steps) == steps[0]


def test_mission_without_reach_is_refused():
    changes = {"comm_radius": 1.1, "max_speed": 0.01, "margin": 0.62}
    with pytest.raises(sato.InputError, match="no more than the 1"):
        make_mission(2 * row(2, 0.0), sato.Leg(2 * row(2, 1.0), 400), **changes)


def test_the_error_of_the_check_decides_no_verdict_that_more_pieces_decide():
    class Drag(sato.LinearModel):
        axes = 2

        def A(self, t):
            return np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 2)), -0.4 * np.eye(2)]])

    start = np.array([[-6.0, 0.0], [6.0, 0.1], [0.0, 6.0], [0.1, -6.0]])
    limits = {"max_control": 0.2, "max_speed": 1.0, "comm_radius": 12.0, "collision_radius": 0.5}
    leg = sato.Leg(-start, 30)
    more = {"step": 1.0, "assignment": "given"} | limits
    run = sato.run(sato.Reconfiguration(model=Drag(), start=start, legs=[leg], **more))
    record = ReconfigurationRecord.from_data(run.recorded, run.drawn_mission)
    coarse, fine = check_separation(record, finer=0), check_separation(record)
    assert coarse.tolerance <= coarse.value < 0.50001 and not coarse.kept
    assert fine.kept and run.verdict == "kept"
