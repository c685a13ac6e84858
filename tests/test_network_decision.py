"""Decisions over a network that takes time: what is taken up is safe, whoever gets through."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from commitment_examples import continuous_separation, random_mission
from numpy.linalg import norm
from reconfiguration_runs import fly, make_mission, row

import sato
from sato.network.channel import NEVER, Channel
from sato.network.graph import CommunicationGraph
from sato.network.link import Link
from sato.network.synchronizer import Synchronizer
from sato.reconfiguration import commitment, network_decision
from sato.reconfiguration.check.recorded import delay_rows
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.network_decision import confirm

FAULTS = Link(loss_probability=0.2, late=3, outage=0.005, outage_share=0.2, round=0.001)


def over_network(mission, link, factor=3):
    """Return a mission over a network, with more time and a radius for its full speed."""
    legs = tuple(replace(leg, steps=factor * leg.steps) for leg in mission.legs)
    wide = replace(mission, link=link, legs=legs, comm_radius=60.0)
    return wide.draw(np.random.default_rng(0))


def drop_at_random(monkeypatch, seed, share):
    """Let each agent miss each stage of a decision with a probability."""
    rng, advance = np.random.default_rng(seed), Synchronizer.advance

    def miss(self, entered, rounds):
        now = advance(self, entered, rounds)
        return np.where(rng.random(len(now)) < rng.choice([0.0, share]), NEVER, now)

    monkeypatch.setattr(Synchronizer, "advance", miss)


def test_vehicles_keep_apart_whichever_of_them_get_through(monkeypatch):
    drop_at_random(monkeypatch, 5, 0.6)
    late = 0
    for seed in range(4):
        mission = random_mission(np.random.default_rng([29, seed]))
        mission = over_network(mission, Link(round=mission.replan_steps * mission.step / 2000))
        frames = fly(mission)
        assert continuous_separation(mission, frames) >= 1 - 1e-9, seed
        events = [event for frame in frames for event in frame.events]
        late += sum(event["kind"] == "unconfirmed" for event in events)
        last = frames[-1]
        targets = mission.legs[0].targets[last.target_index, : mission.axes]
        np.testing.assert_allclose(last.position, targets, atol=1e-6)
    assert late > 30


def crossing(**changes):
    """Four vehicles that cross to the places of each other, with a link."""
    start = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0]])
    options = {"comm_radius": 40.0, "link": FAULTS, "assignment": "auction"} | changes
    return make_mission(start, sato.Leg(start[[2, 3, 0, 1]] + [0.3, 0.0], 60), **options)


def test_flight_over_a_network_is_that_without_one_a_decision_later():
    mission = crossing(link=Link())
    late = replace(mission, link=Link(round=1e-4))
    ideal, found = (np.stack([f.position for f in fly(one)]) for one in (mission, late))
    lag = mission.replan_steps
    np.testing.assert_allclose(found[lag : lag + len(ideal)], ideal, atol=1e-9)


@pytest.mark.parametrize("skew", [0.0, 1.0])
def test_runs_over_lossy_networks_keep_all_promises(skew):
    periods = {"replan_steps": 4, "horizon_steps": 8, "auction_steps": 8}
    noise = {"position_noise": 0.005, "thrust_error": 0.05}
    mission = crossing(link=replace(FAULTS, skew=skew), **periods, **noise)
    run = sato.run(mission, seed=3)
    report = run.check()
    assert report.kept, [promise for promise in report.promises if not promise.kept]
    kinds = [event["kind"] for event in run.events()]
    assert ("clocks" in kinds) == (skew > 0)


def test_an_agent_that_falls_silent_in_a_decision_keeps_others_from_theirs():
    lost = sato.Loss("agents", agents=(3,), at_step=1)
    mission = crossing(link=Link(round=0.05))
    leg = replace(mission.legs[0], losses=(lost,))
    frames = fly(replace(mission, legs=(leg,)))
    first = [i for i, f in enumerate(frames) if any(e["kind"] == "assignment" for e in f.events)]
    late = [e for f in frames[: first[0]] for e in f.events if e["kind"] == "unconfirmed"]
    assert first[0] == 2 * mission.replan_steps
    assert [event["agents"] for event in late] == [[0, 1, 2]]


def test_promises_run_down_the_agents_that_wait_and_none_around_a_ring():
    adjacency = ~np.eye(4, dtype=bool)
    graph = CommunicationGraph(adjacency, np.ones(4, dtype=bool))
    channel = Channel(Link(round=1.0), graph, np.random.default_rng(0))
    network = Synchronizer(channel, np.full(4, 100))
    chosen = np.array([5, 5, 5, 9])
    chain = np.array([1, 2]), np.array([0, 1])
    np.testing.assert_array_equal(confirm(network, chosen, chain), [5, 6, 7, 9])
    ring = np.array([0, 1, 2]), np.array([1, 2, 0])
    np.testing.assert_array_equal(confirm(network, chosen, ring), [NEVER] * 3 + [9])
    late = np.array([5, NEVER, 5, 9])
    np.testing.assert_array_equal(confirm(network, late, chain), [5, NEVER, NEVER, 9])


def test_rows_are_delayed_by_the_steps_of_each_clock():
    rows = np.arange(12.0).reshape(4, 3)
    found = delay_rows(rows, np.array([0, 2, 1]))
    np.testing.assert_array_equal(found[:, 0], [0, 3, 6, 9, 9, 9])
    np.testing.assert_array_equal(found[:, 1], [1, 1, 1, 4, 7, 10])
    np.testing.assert_array_equal(found[:, 2], [2, 2, 5, 8, 11, 11])


def test_clocks_are_behind_by_whole_steps_up_to_the_skew():
    mission = crossing(link=replace(FAULTS, skew=1.9))
    delay = np.array([0.0, 0.4, 0.6, 1.6, 1.9])
    assert network_decision.whole_steps(mission, delay) == [0, 0, 1, 1, 1]
    assert network_decision.whole_steps(crossing(), delay) == []


def test_two_that_decided_apart_call_for_an_auction(monkeypatch):
    start = row(2, 0.0)
    mission = make_mission(start, sato.Leg(row(2, 6.0), 40), comm_radius=40.0, link=FAULTS)
    advance, dropped = Synchronizer.advance, []

    def miss(self, entered, rounds):
        now = advance(self, entered, rounds)
        if rounds.max() > 10 and not dropped:  # the second misses the first decision
            dropped.append(now.copy())
            now[1] = NEVER
        return now

    monkeypatch.setattr(Synchronizer, "advance", miss)
    frames = fly(mission)
    assigned = [
        (k, e["agents"])
        for k, f in enumerate(frames)
        for e in f.events
        if e["kind"] == "assignment"
    ]
    assert assigned == [(2, [0]), (4, [1])]
    assert len(np.unique(frames[-1].target_index)) == 2


@pytest.mark.parametrize("missed", range(3, 8))
def test_all_arrive_though_all_stop_as_none_gets_through_a_decision(missed, monkeypatch):
    mission = sato.read(
        "random",
        [
            *("swarm.agents=4", "swarm.comm_radius_m=20", "link.round_s=0.02"),
            *("plan.replan_steps=4", "plan.horizon_steps=8", "plan.auction_steps=8"),
        ],
    )
    finish, count = network_decision.DecisionsUnderWay.finish, 0

    def miss(*data):
        nonlocal count
        count, (each, has_heard) = count + 1, finish(*data)
        late = [np.zeros_like(through) for through in each]
        return late if count == missed else each, has_heard

    monkeypatch.setattr(network_decision.DecisionsUnderWay, "finish", miss)
    assert sato.run(mission).check().kept


def test_vehicle_joins_clear_of_what_others_take_up_when_it_joins():
    # At step 2 the first begins to fly over the place at which the second is to join.
    join = sato.Join(1, np.array([[0.75, 0.0]]), at_step=2)
    leg = sato.Leg(np.array([[8.0, 0.0], [0.75, 12.0]]), 60, joins=(join,))
    start = np.array([[0.0, 0.0]])
    mission = make_mission(start, leg, comm_radius=40.0, link=Link(round=0.001))
    frames = fly(mission)
    assert continuous_separation(mission, frames) >= 1 - 1e-9
    assert frames[-1].alive.all()


def test_obstacle_seen_in_the_middle_of_a_period_is_avoided():
    # The vehicle sees it after it has decided on a trajectory that leads through it, 20 s later.
    passing = sato.Sphere((2.0, 6.15), 0.4, velocity=(0.0, -0.29), known=False)
    leg = sato.Leg(sato.Points([[4.0, 0.0]], keep_order=True), 40)
    limits = {"max_control": 0.3, "max_speed": 0.6, "comm_radius": 40.0, "sensing_radius": 6.0}
    own = {"assignment": "given", "obstacles": (passing,), "link": Link(round=0.001)}
    mission = make_mission(np.zeros((1, 2)), leg, **limits | own)
    frames = fly(mission)
    gaps = [norm(f.position[0] - passing.place_at(f.time)) - passing.radius for f in frames]
    assert gaps[0] > 5.6 and min(gaps) >= mission.collision_radius / 2
    assert frames[-1].position[0] == pytest.approx([4.0, 0.0], abs=1e-5)


def test_nothing_is_noted_of_a_decision_that_nobody_takes_up():
    frames = fly(crossing(link=Link(round=0.02, loss_probability=0.4)))
    events = [{event["kind"]: event["agents"] for event in f.events} for f in frames]
    late = [told for told in events if told.get("unconfirmed") == [0, 1, 2, 3]]
    assert len(late) >= 1 and not any("replan" in told for told in late)
    assert sum("replan" in told for told in events) >= 1


def test_vehicles_that_start_nearer_than_the_margin_part():
    start = np.array([[0.0, 0.0], [0.505, 0.0]])
    leg = sato.Leg(np.array([[-4.0, 0.0], [4.5, 0.0]]), 40)
    mission = make_mission(start, leg, comm_radius=40.0, margin=0.1, link=Link(round=0.001))
    frames = fly(mission)
    assert len(frames) == 40 + 2 * mission.replan_steps + 1
    assert continuous_separation(mission, frames) >= 1 - 1e-9


@pytest.mark.parametrize("waits", [True, False])
def test_vehicle_waits_for_the_promise_of_one_that_is_in_its_way(monkeypatch, waits):
    # The second makes way for the first, but gets through no decision.
    start, goal = np.array([[0.0, 0.0], [1.2, 0.0]]), np.array([[4.0, 0.0], [1.2, 6.0]])
    leg = sato.Leg(sato.Points(goal, keep_order=True), 40)
    options = {"assignment": "given", "priority": (0.0, 1.0), "comm_radius": 40.0}
    mission = make_mission(start, leg, link=Link(round=0.001), **options)
    advance = Synchronizer.advance

    def miss(self, entered, rounds):
        return np.where([False, rounds.max() > 10], NEVER, advance(self, entered, rounds))

    monkeypatch.setattr(Synchronizer, "advance", miss)
    if not waits:
        none = np.zeros(0, dtype=int)
        monkeypatch.setattr(commitment, "find_waits", lambda *_: (none, none))
    frames = list(islice(simulate(mission, np.random.default_rng(0)), 40))
    assert (continuous_separation(mission, frames) >= 1 - 1e-9) == waits
