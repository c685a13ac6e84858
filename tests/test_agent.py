"""One vehicle as an object: the loop, control for control and message for message; refusals."""

import pickle
import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pandas as pd
import pytest
from agents import decide, fly_by_messages
from reconfiguration_runs import (
    at_rest,
    crowd_in_the_way,
    leg_to,
    make_mission,
    row,
    wreck_in_the_way,
)

import sato
from dynamics import ClohessyWiltshire, DoubleIntegrator
from dynamics.plant import LinearPlant, Plant
from sato.auctions.vsdaa import init_state, run_kernel, run_vsdaa
from sato.network.graph import CommunicationGraph
from sato.reconfiguration import assignment, planning
from sato.reconfiguration.agent_inputs import (
    AgentMessage,
    as_instant,
    as_state,
    check_inbox,
)
from sato.reconfiguration.agent_stages import BiddingMessage, ExchangeMessage
from sato.reconfiguration.loop import _Flight, simulate
from sato.scp import resolve_conflicts
from sato.scp.exchange import run_batched

ROUNDING = 1e-9  # BLAS rounds a product of one row otherwise than the same row among others
DECISIONS = {"reset", "slack", "braked", "infeasible", "cautious"}


def spread(rng, count, axes=2, box=4.0):
    """Random positions at least 0.7 m apart."""
    points = np.zeros((0, axes))
    while len(points) < count:
        p = rng.uniform(-box / 2, box / 2, axes)
        if not len(points) or np.linalg.norm(points - p, axis=1).min() > 0.7:
            points = np.concatenate([points, p[None]])
    return points


def listed(points):
    return sato.Points(points, keep_order=True)


def disturbed(rng):
    noise = {"disturbance": 3e-3, "position_noise": 2e-3, "thrust_error": 0.02}
    leg = sato.Leg(spread(rng, 7), 14)
    return make_mission(spread(rng, 5), leg, replan_steps=1, max_control=0.3, **noise)


def disconnected(rng):
    changes = {"comm_radius": 1.6, "allow_undetectable": True, "reset": "need"}
    leg = sato.Leg(listed(spread(rng, 6, 3, 3.0)), 16)
    return make_mission(spread(rng, 6, 3, 6.0), leg, **changes)


def varying(rng):
    loss, join = sato.Loss("agents", agents=(1,), at_step=5), sato.Join(2, row(2, 3.0), at_step=3)
    legs = (
        sato.Leg(listed(spread(rng, 7)), 16, losses=(loss,), joins=(join,)),
        sato.Leg(listed(spread(rng, 7)), 14, recount=True),
        sato.Leg(spread(rng, 8), 14),
    )
    return make_mission(spread(rng, 5), *legs, max_control=0.2)


def hurried(rng):
    leg = sato.Leg(spread(rng, 5, box=6.0), 12)
    limits = {"max_control": [0.1, 0.2, 0.15, 0.1], "max_speed": 0.3}
    limits |= {"collision_radius": [0.4, 0.7, 0.5, 0.3], "priority": [1, 0, 1, 2]}
    changes = {"comm_radius": 2.5, "allow_undetectable": True, **limits}
    return make_mission(spread(rng, 4, box=6.0), leg, bidder_ids=False, **changes)


def orbiting(rng):
    leg = sato.Leg(spread(rng, 4, 3), 12)
    model = ClohessyWiltshire(1e-3)
    return make_mission(spread(rng, 4, 3), leg, model=model, max_control=0.3, objective="energy")


WIND = np.array([0.05, 0.0])


class Windy(Plant):
    """Double integrators that a wind accelerates."""

    def propagate(self, x, u, t, dt, substeps=1):
        """Add the wind to the controls."""
        return LinearPlant(DoubleIntegrator(2)).propagate(x, u + WIND, t, dt, substeps)


def given(rng):
    # Wind puts the targets of the second leg out of reach.
    legs = [sato.Leg(spread(rng, 4), 16), sato.Leg(spread(rng, 4), "auto", time_factor=1.0)]
    changes = {"assignment": "given", "max_control": 0.3, "comm_radius": 2.5, "plant": Windy()}
    changes |= {"reset": "need", "objective": "energy", "margin": 0.0}
    return make_mission(spread(rng, 4), *legs, allow_undetectable=True, **changes)


def slow(rng):
    # Way costs are lower bounds that hardly hold at this speed, so that the forecast is wrong.
    rng = np.random.default_rng(3)
    start, targets = rng.uniform(-2.5, 2.5, (8, 2)), rng.uniform(-2.5, 2.5, (12, 2))
    leg = sato.Leg(listed(targets + np.array([4.0, 0.0])), 20)
    changes = {"max_control": 0.2, "max_speed": 0.25, "comm_radius": 100.0, "target_count": 12}
    return make_mission(start, leg, collision_radius=1e-3, allow_undetectable=True, **changes)


def crowded(rng):
    # In so little time some are kept from their targets, and begin again: seed 1.
    rng = np.random.default_rng(1)
    ahead = {"foresight_steps": 10, "freeze_steps": 10, "comm_radius": 20.0, "reset": "need"}
    leg = sato.Leg(spread(rng, 6, box=2.5), 10)
    return make_mission(spread(rng, 6, box=2.5), leg, assignment="given", **ahead)


def exchanged(rng):
    # Two pairs pass through each other, in hardly more time than each takes alone.
    block = np.array([[2.0, 0.0], [2.0, 0.6]])
    start = np.vstack([block, block * [-1, 1]])
    leg = sato.Leg(listed(start * [-1, 1]), "auto", time_factor=1.1)
    return make_mission(start, leg, assignment="given", comm_radius=6.0)


def packed(rng):
    # One is delayed, and paths to the dense group of targets spread.
    places = np.array([[a + b / 2, b * 3**0.5 / 2] for a in range(-4, 5) for b in range(-4, 5)])
    places = 0.575 * places[np.argsort(np.linalg.norm(places, axis=1), kind="stable")][:10]
    rng = np.random.default_rng(7)
    start = rng.permutation(places) * 1.2 + rng.uniform(0, 1.0, 2)
    leg = sato.Leg(listed(places), "auto", time_factor=1.1)
    return make_mission(start, leg, assignment="given", max_speed=0.3, comm_radius=3.0)


def warm_started(rng):
    start = 2 * row(5, 0.0)  # programs that differ in b alone
    leg = sato.Leg(start + np.array([0.0, 4.0]) + rng.normal(0.0, 0.1, (5, 2)), 12)
    changes = {
        "solver": "scs",
        "tolerance": 1e-4,
        "objective": "energy",
        "max_control": 0.13,
        "max_speed": 1.0,
    }
    return make_mission(start, leg, comm_radius=20.0, **changes)


def surrounded(rng):
    # Two die and coast on; one obstacle comes by, another is seen only when it is near.
    passing = sato.Sphere((-4.0, 1.0), 0.4, velocity=(0.15, 0.0))
    hidden = sato.Sphere((0.2, -0.2), 0.3, known=False)
    loss = sato.Loss("agents", agents=(1, 4), at_step=5, body="coast")
    places = spread(rng, 20, box=6.0)
    places = places[hidden.distances(places) > 0.6]
    start, targets = places[:6], places[6:14]
    changes = {"obstacles": (passing, hidden), "box": [[-5.0, -5.0], [5.0, 5.0]]}
    changes |= {"sensing_radius": 1.5, "max_control": 0.3, "comm_radius": 6.0}
    changes["collision_radius"] = [0.3, 0.5, 0.4, 0.35, 0.45, 0.5]
    return make_mission(start, sato.Leg(targets, 30, losses=(loss,)), **changes)


def drifting(rng):
    # Two of six spacecraft fall silent on their way.
    loss = sato.Loss("agents", agents=(0, 3), at_step=4, body="coast")
    leg = sato.Leg(spread(rng, 8, 3), 12, losses=(loss,))
    model = ClohessyWiltshire(1e-3)
    return make_mission(spread(rng, 6, 3), leg, model=model, max_control=0.3)


MISSIONS = [disturbed, disconnected, varying, hurried, orbiting, given, warm_started, slow]
OTHERS = [crowded, exchanged, packed, surrounded, crowd_in_the_way, drifting, wreck_in_the_way]


@pytest.mark.filterwarnings("ignore:the plant does otherwise than the model")  # in wind
@pytest.mark.parametrize("draw", [*MISSIONS, *OTHERS])
def test_agents_fly_as_the_loop_does(rng, draw):
    mission = draw(rng)
    frames = list(simulate(mission, np.random.default_rng(1)))[:40]
    flown = 0
    for frame, (x, control, agents, _, _) in zip(frames, fly_by_messages(mission, 1), strict=False):
        flown += 1
        np.testing.assert_allclose(x[:, : mission.axes], frame.position, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(control, frame.control, rtol=0, atol=ROUNDING)
        for i, agent in agents.items():
            assert agent.target_index == frame.target_index[i]
            assert agent.memory.memory.target_count[i] == frame.target_count[i]
        told = [(e["kind"], i) for e in frame.events if "leg" not in e for i in e["agents"]]
        if any(event["kind"] == "replan" for event in frame.events):
            expected = sorted(event for event in told if event[0] in DECISIONS)
            events = [(e["kind"], i) for i, agent in agents.items() for e in agent.events]
            assert sorted(events) == expected
    assert flown >= len(frames) - 1


def test_agents_that_keep_their_targets_claim_them_again():
    # Two networks; as vehicles hear no farther, they commit again every few steps.
    start = np.vstack([row(4, 0.0), row(2, 7.0)])
    leg = sato.Leg(listed(start + np.array([[1.0, 2.0]] * 4 + [[1.0, -1.0]] * 2)), 50)
    mission = make_mission(start, leg, comm_radius=2.5, max_speed=0.2)
    flight, renewed = _Flight(mission, np.random.default_rng(0)), set()
    for _, (_, _, agents, _, _) in zip(flight.fly_leg(0), fly_by_messages(mission), strict=False):
        for i, agent in agents.items():
            own, memory = agent.memory.memory, flight.memory
            heard = slice(own.claim_step.shape[1])
            assert own.claim_step[i].tolist() == memory.claim_step[i, heard].tolist()
            assert own.claimed_target[i].tolist() == memory.claimed_target[i, heard].tolist()
            assert (memory.claim_step[i, own.claim_step.shape[1] :] == -1).all()
        renewed.add(int(flight.memory.claim_step[0, 0]))
    assert len(renewed) > 4


def by_stage(rounds, agent, kind):
    """Messages of one kind that an agent sent, a list for each stage."""
    stages = {}
    for sent in rounds:
        if agent in sent and isinstance(sent[agent].content, kind):
            stages.setdefault(sent[agent].stage, []).append(sent[agent].content)
    return list(stages.values())


def equal_bids(message, price, winner):
    bids = message.bids
    return np.array_equal(bids.winner, winner) and np.allclose(bids.price, price, 0, ROUNDING)


@pytest.mark.filterwarnings("ignore:the plant does otherwise than the model")  # in wind
@pytest.mark.parametrize("draw", MISSIONS)
def test_agents_send_the_messages_that_batched_rounds_compute(rng, draw, monkeypatch):
    mission, auctions, exchanges = draw(rng), [], []

    def record_auction(auction):
        asked = auction.cost, auction.graph, auction.target_count, auction.opening
        state, history = init_state(*asked), []
        for _ in run_kernel(state, auction.epsilon, auction.bidder_ids, [], stride=1):
            history.append((state.price.copy(), state.winner.copy()))
        auctions.append(history)
        return run_vsdaa(auction)

    def record_exchange(planners, graph, *rest):
        exchanges.append(list(run_batched(planners, graph)))
        return resolve_conflicts(planners, graph, *rest)

    monkeypatch.setitem(assignment.METHODS, "auction", record_auction)
    monkeypatch.setattr(planning, "resolve_conflicts", record_exchange)
    frames = simulate(mission, np.random.default_rng(1))
    compared = 0
    for _, (_, _, agents, _, rounds) in zip(range(40), fly_by_messages(mission, 1), strict=False):
        auctions.clear()
        exchanges.clear()
        next(frames)
        for i in agents:
            heard = iter(auctions)  # more than its own, where another component bids again
            for own in by_stage(rounds, i, BiddingMessage):
                assert any(
                    all(
                        equal_bids(message, price[i], winner[i])
                        for message, (price, winner) in zip(own[1:], history, strict=False)
                    )
                    for history in heard
                )
                compared += len(own) - 1
            for own in by_stage(rounds, i, ExchangeMessage):
                (history,) = [exchange for exchange in exchanges if i in exchange[0]]
                for (sent, _), planners in zip(own[1:], history, strict=False):
                    expected = planners[i].message
                    assert sent.is_final == expected.is_final
                    assert sent.priority == pytest.approx(expected.priority, abs=ROUNDING)
                    np.testing.assert_allclose(
                        sent.control_points, expected.control_points, rtol=0, atol=ROUNDING
                    )
                    compared += 1
    assert compared > 20


def four(**changes):
    start, goals = row(4, 0.0), row(4, 3.0)
    mission = make_mission(start, sato.Leg(goals, 14), **changes)
    return mission, {i: sato.Agent(mission, i) for i in range(4)}


def first_instant(mission, agents, time=0.0):
    graph = CommunicationGraph.from_positions(
        mission.initial_states[:, :2], mission.comm_radius, mission.alive
    )
    return list(decide(agents, time, mission.initial_states, graph))


def test_order_of_messages_and_those_of_earlier_stages_do_not_matter():
    mission, agents = four()
    _, others = four()
    x, sent, history = mission.initial_states, [], []
    while not sent or not all(agent.is_finished for agent in agents.values()):
        heard = {i: [m for m in sent if m.sender != i] for i in agents}
        older = [m for m in history if m.stage < sent[0].stage]
        for i, other in others.items():
            other.step(0.0, x[i], [*(m for m in older if m.sender != i), *heard[i][::-1]])
        history += sent
        sent = [agent.step(0.0, x[i], heard[i])[1] for i, agent in agents.items()]
    for i, agent in agents.items():
        assert others[i].is_finished
        np.testing.assert_array_equal(agent.memory.control, others[i].memory.control)


def test_restored_memory_continues_the_flight():
    mission, agents = four()
    first_instant(mission, agents)
    copies = {i: sato.Agent(mission, i) for i in agents}
    for i, agent in agents.items():
        copies[i].memory = pickle.loads(pickle.dumps(agent.memory))
    assert len(first_instant(mission, agents, 1.0)) == len(first_instant(mission, copies, 1.0))
    for i, agent in agents.items():
        np.testing.assert_array_equal(agent.memory.control, copies[i].memory.control)


def test_agent_from_a_mission_of_one_vehicle_flies_the_same():
    mission, agents = four()
    first_instant(mission, agents)
    leg = sato.Leg(row(4, 3.0), 14)
    own = {i: sato.Agent(make_mission(row(4, 0.0)[[i]], leg), i, 4) for i in range(4)}
    first_instant(mission, own)
    for i, agent in agents.items():
        np.testing.assert_array_equal(agent.memory.control, own[i].memory.control)


def test_agents_of_any_numbers_are_each_given_a_target_of_their_own():
    goals = {17: [1.5, 3.0], 3: [-1.5, 3.0], 203: [0.0, 3.5]}
    starts = {17: [-1.0, 0.0], 3: [1.0, 0.0], 203: [0.0, -1.0]}
    agents = {}
    for i in goals:
        leg = sato.Leg(np.array([goals[i]]), 14)
        mission = make_mission(np.array([starts[i]]), leg, assignment="given", max_control=0.4)
        agents[i] = sato.Agent(mission, i)
    x = np.zeros((204, 4))
    x[list(starts), :2] = list(starts.values())
    adjacency = np.zeros((204, 204), dtype=bool)
    adjacency[np.ix_(list(goals), list(goals))] = ~np.eye(3, dtype=bool)
    graph = CommunicationGraph(adjacency, np.isin(range(204), list(goals)))
    for k in range(24):
        if k == 6:
            goals |= {3: [0.5, 5.0]}
            for i, agent in agents.items():
                agent.set_targets(np.array([goals[i]]), 18)
        list(decide(agents, float(k), x, graph))
        u = np.zeros((204, 2))
        u[list(agents)] = [agent.memory.control for agent in agents.values()]
        x = np.hstack([x[:, :2] + x[:, 2:] + u / 2, x[:, 2:] + u])
    np.testing.assert_allclose(x[list(goals), :2], list(goals.values()), atol=1e-5)


WRONG_INBOXES = {
    lambda hello: [hello, hello]: "hears one agent twice",
    lambda hello: [hello._replace(instant=2)]: "hears agent 1 in instant 2, stage 0: in each round",
    lambda hello: [hello._replace(content=5)]: "hears int from agent 1 in place of CensusMessage",
}


@pytest.mark.parametrize("number", [-1, 1.0, "0", True, 4096])
def test_number_that_is_none_is_refused(number):
    with pytest.raises(ValueError, match=r"number:? must be a.* got"):
        sato.Agent(four()[0], number)


@pytest.mark.parametrize("count", [0, -1, 2.5, "4"])
def test_target_count_that_is_none_is_refused(count):
    with pytest.raises(sato.InputError, match="target_count: must be an integer above 0, got"):
        sato.Agent(four()[0], 0, count)


@pytest.mark.parametrize("time", [-1.0, np.nan, np.inf, "0", None, 1.75e9])
def test_time_that_is_none_is_refused(time):
    with pytest.raises(ValueError, match="time must be the seconds since the start"):
        as_instant(four()[0], "time", time)


def test_agents_take_times_and_states_with_units():
    mission = four()[0]
    plain, marked = sato.Agent(mission, 0), sato.Agent(mission, 0)
    state = np.append(mission.start.positions[0], [0.0, 0.0])
    row = pd.Series(state[[1, 0, 3, 2]] * [1, 100, 1, 1], index=["y", "x_cm", "vy", "vx"])
    control, _ = plain.step(0.0, state, [])
    assert np.array_equal(marked.step(0.0 * u.min, row, [])[0], control)


@pytest.mark.parametrize(
    "state", [np.full(4, np.nan), [0, 1], "none", None, [1j] * 4, np.zeros((1, 4))]
)
def test_state_that_is_none_is_refused(state):
    with pytest.raises(ValueError, match=r"state must be 4 finite numbers, position \[m\] and"):
        as_state(four()[0], state)


def see_one(mission, thing):
    return sato.Agent(mission, 0).step(0.0, mission.initial_states[0], [], seen=[thing])


@pytest.mark.parametrize(
    ("thing", "reason"),
    [
        ((1,), "seen.0: must be an Obstacle or 2 values, got"),
        (("1", np.zeros(4)), 'seen.0.0: must be an integer at least 0, got "1"'),
        ((True, np.zeros(4)), "seen.0.0: must be an integer at least 0, got true"),
        ((1, np.full(4, np.nan)), "state must be 4 finite numbers"),
        (sato.Sphere((9.0, 9.0, 9.0), 1.0), "seen.0: has 3 coordinates, and the mission 2"),
        ((0, np.zeros(4)), "seen.0: is agent 0 itself"),
    ],
)
def test_what_an_agent_cannot_have_seen_is_refused(thing, reason):
    with pytest.raises(ValueError, match=re.escape(reason)):
        see_one(four()[0], thing)


@pytest.mark.parametrize("header", [("0", 0, 0), (1.0, 0, 0), (True, 0, 0), (1, -1, 0)])
def test_messages_have_whole_numbers(header):
    with pytest.raises(sato.InputError, match="must be an integer at least 0"):
        AgentMessage(*header, None)


def test_memory_of_an_agent_is_that_of_one():
    with pytest.raises(sato.InputError, match="memory: must be that of an agent, got 3"):
        sato.Agent(four()[0], 0).memory = 3
    _, agents = four()
    with pytest.raises(sato.InputError, match="memory: is that of agent 2, and this is agent 1"):
        agents[1].memory = agents[2].memory
    slower = sato.Agent(replace(agents[2].mission, tie_break=0.1), 2)
    with pytest.raises(sato.InputError, match="memory: is that of an agent of another mission"):
        slower.memory = agents[2].memory


def test_agent_bids_on_no_more_targets_than_its_leg_has():
    with pytest.raises(sato.InputError, match="target_count: 5 is more than the 4 targets of"):
        sato.Agent(four()[0], 0, target_count=5)


def test_agent_that_begins_outside_of_its_box_is_refused():
    _, agents = four(box=[[-20.0, -3.0], [20.0, 9.0]])
    with pytest.raises(sato.InputError, match=r"state: agent 0 starts outside of .* model\.box_m"):
        agents[0].step(0.0, [0.0, -3.1, 0.0, 0.0], [])


def test_wrong_use_is_refused_with_a_cure():
    mission, agents = four()
    state = mission.initial_states[0]
    with pytest.raises(ValueError, match="orders = 1, bargains = 0 and"):
        sato.Agent(replace(mission, orders=2), 0)
    listed_limits = replace(mission, max_control=(0.1, 0.2, 0.1, 0.2))
    with pytest.raises(ValueError, match=r"number must be a whole number from 0 to 3.* got 4"):
        sato.Agent(listed_limits, 4)
    with pytest.raises(ValueError, match="state must be 4 finite numbers"):
        agents[0].step(0.0, state[:2], [])
    first_instant(mission, agents)
    with pytest.raises(ValueError, match="call it at every multiple of plan"):
        agents[0].step(2.0, state, [])
    agents[0].step(1.0, state, [])
    with pytest.raises(ValueError, match="has not finished its decision of instant 1"):
        agents[0].step(2.0, state, [])
    with pytest.raises(ValueError, match="has not finished its decision"):
        agents[0].set_targets(row(4, 1.0), 14)
    with pytest.raises(ValueError, match="3 is less than the 4 that agents bid on"):
        agents[1].set_targets(row(3, 1.0), 14)
    with pytest.raises(ValueError, match=r"transfer of 100,000,000 steps takes about .* would do"):
        agents[1].set_targets(row(4, 1.0), 10**8)
    with pytest.raises(
        ValueError, match="got a NoneType; leave out those of agents that have sent"
    ):
        check_inbox(0, [None])
    hello, ahead = agents[1].step(1.0, state, [])[1], agents[2].step(1.0, state, [])[1]
    for wrong, reason in WRONG_INBOXES.items():
        with pytest.raises(ValueError, match=reason):
            agents[0].step(1.0, state, wrong(hello))
    agents[0].step(1.0, state, [hello])
    with pytest.raises(ValueError, match=r"hears agents \[1, 2\], and in the round before \[1\]"):
        agents[0].step(1.0, state, [hello, ahead])
    with pytest.raises(ValueError, match="agent 0 hears an agent of its own number"):
        agents[0].step(1.0, state, [hello._replace(sender=0)])


def test_agents_of_different_legs_refuse_to_decide_together():
    mission, agents = four()
    first_instant(mission, agents)
    agents[2].set_targets(row(4, 1.0), 20)
    with pytest.raises(ValueError, match="agents 0 and 2 hear each other and do not fly the same"):
        first_instant(mission, agents, 1.0)


def test_agents_take_a_given_target_of_their_own_in_flight():
    start = row(2, 0.0)
    mission = make_mission(start, sato.Leg(row(2, 4.0), 30), assignment="given")
    agents = {i: sato.Agent(mission, i) for i in range(2)}
    graph = CommunicationGraph(~np.eye(2, dtype=bool), np.ones(2, dtype=bool))
    x = np.hstack([start, 0 * start])
    for k in range(60):
        if k == 20:
            for i, agent in agents.items():
                agent.set_targets([[3.0 * i, 7.0]], 30)
        list(decide(agents, k * mission.step, x, graph))
        u = np.array([agent.memory.control for agent in agents.values()])
        x = LinearPlant(DoubleIntegrator(2)).propagate(x, u, 0.0, mission.step)[1]
    np.testing.assert_allclose(x[:, :2], [[0.0, 7.0], [3.0, 7.0]], atol=1e-5)
    assert all(agent.has_arrived for agent in agents.values())


def test_agents_bid_on_as_many_targets_as_they_are_where_few_are_open():
    # One of four is lost, and blocks two of four targets.
    start = np.array([[0.3, 0.0], [0.0, 4.0], [3.0, 4.0], [6.0, 4.0]])
    goal = np.array([[0.0, 0.0], [0.6, 0.0], [3.0, 0.0], [6.0, 0.0]])
    loss = sato.Loss("agents", agents=(0,), body="coast")
    leg = leg_to(at_rest(goal), 30, choose="prefix", losses=(loss,))
    mission = make_mission(start, leg, comm_radius=40.0)
    _, _, agents, *_ = next(fly_by_messages(mission))
    held = [agent.target_index for agent in agents.values()]
    frame = next(simulate(mission, np.random.default_rng(0)))
    assert held == frame.target_index[1:].tolist()
    assert len(set(held)) == 3 and {2, 3} < set(held)
