"""Agents over a network that loses and delays messages: the batched loop, control for control."""

from itertools import islice

import numpy as np
import pytest
from agents import NetworkFlight
from lossy import relay
from reconfiguration_runs import crowd_in_the_way, make_mission, row
from test_agent import ROUNDING, listed, spread

import sato
from sato.network.channel import NEVER, Channel
from sato.network.graph import CommunicationGraph
from sato.network.link import Link
from sato.reconfiguration import commitment
from sato.reconfiguration.loop import simulate

LOSSY = {"loss_probability": 0.2, "late": 2, "outage": 0.02, "outage_share": 0.2, "round": 0.005}


def make(start, *legs, link=None, **changes):
    values = {"comm_radius": 20.0, "max_control": 0.3, "link": Link(**LOSSY | (link or {}))}
    return make_mission(start, *legs, **values | changes)


def free(rng):
    """Seven agents in a complete network, with a free choice of targets."""
    return make(spread(rng, 7), sato.Leg(spread(rng, 9), 24))


def losing(rng):
    """Eight agents and two legs; one falls silent in the middle of a decision."""
    loss = sato.Loss("agents", agents=(2,), at_step=7)
    legs = [sato.Leg(listed(spread(rng, 9)), 20, losses=(loss,))]
    legs.append(sato.Leg(listed(spread(rng, 9)), 20, recount=True))
    return make(spread(rng, 8), *legs)


def apart(rng):
    """Several networks, which meet on their way."""
    leg = sato.Leg(listed(spread(rng, 6, box=3.0)), 24)
    changes = {"comm_radius": 2.5, "allow_undetectable": True}
    return make(spread(rng, 6, box=6.0), leg, **changes)


def exchanged(rng):
    """Pairs that pass through each other, in hardly more time than each takes alone."""
    block = np.array([[2.0, 0.0], [2.0, 0.6], [2.0, 1.2]])
    start = np.vstack([block, block * [-1, 1]])
    leg = sato.Leg(listed(start * [-1, 1]), "auto", time_factor=1.1)
    return make(start, leg, assignment="given")


def interrupted(rng):
    """One is lost while all decide for the first time; clocks are behind, and keep some longer."""
    loss = sato.Loss("agents", agents=(4,), at_step=1)
    leg = sato.Leg(spread(rng, 6), 24, losses=(loss,))
    return make(spread(rng, 6), leg, link={"round": 0.01, "skew": 0.1})


def hasty(rng):
    """Time for some decisions, and for some agents, is over before they get through."""
    rng = np.random.default_rng(0)
    start, leg = spread(rng, 7), sato.Leg(spread(rng, 7), 16)
    return make(start, leg, link={"round": 0.01, "outage": 0.04})


def joining(rng):
    """One that joins, where two agents do not hear each other at first."""
    join = sato.Join(1, row(1, 4.0), at_step=3)
    leg = sato.Leg(listed(spread(rng, 7, box=3.0)), 24, joins=(join,))
    return make(spread(rng, 5, box=3.0), leg)


def surrounded(rng):
    """Two are lost and coast on, an obstacle comes by, and another is seen on the way alone."""
    passing = sato.Sphere((-4.0, 1.0), 0.4, velocity=(0.15, 0.0))
    hidden = sato.Sphere((0.2, -0.2), 0.3, known=False)
    losses = (sato.Loss("agents", agents=(i,), at_step=k, body="coast") for i, k in LOST)
    places = spread(rng, 20, box=6.0)
    places = places[hidden.distances(places) > 0.6]
    leg = sato.Leg(places[6:14], 30, losses=tuple(losses))
    changes = {"obstacles": (passing, hidden), "box": [[-5.0, -5.0], [5.0, 5.0]]}
    return make(places[:6], leg, sensing_radius=5.0, **changes)


def sighted(rng):
    """One decides before it sees what comes over its way."""
    passing = sato.Sphere((2.0, 6.15), 0.4, velocity=(0.0, -0.29), known=False)
    leg = sato.Leg(listed([[4.0, 0.0], [0.0, -4.0]]), 40)
    limits = {"max_speed": 0.6, "comm_radius": 40.0, "sensing_radius": 6.0}
    return make(np.array([[0.0, 0.0], [0.0, -3.0]]), leg, obstacles=(passing,), **limits)


LOST = (1, 6), (4, 8)
MISSIONS = [free, losing, apart, exchanged, interrupted, hasty, joining, surrounded, sighted]


def compare(mission, count=None):
    """Compare a flight by messages with that of the loop; return the frames of the loop."""
    frames = list(islice(simulate(mission, np.random.default_rng(1)), count))
    flown = list(islice(NetworkFlight(mission, 1).fly(), count))
    for frame, (x, control, target, events) in zip(frames, flown, strict=False):
        live = frame.alive
        near = {"rtol": 0, "atol": ROUNDING}
        np.testing.assert_allclose(x[live, :2], frame.position[live], **near)
        np.testing.assert_allclose(control[live], frame.control[live], **near)
        assert np.array_equal(target[live], frame.target_index[live])
        told = [i for e in frame.events if e["kind"] == "unconfirmed" for i in e["agents"]]
        assert sorted(i for i, kind in events if kind == "unconfirmed") == told
    assert len(flown) == (count or len(frames) - 1)
    return frames


@pytest.mark.parametrize("draw", MISSIONS)
def test_agents_fly_over_a_network_as_the_loop_does(rng, draw):
    compare(draw(rng))


def test_agents_evade_over_a_network_as_the_loop_does(rng, monkeypatch):
    evaded, find = [], commitment.find_evasions

    def record(*own):
        evaded.append(find(*own))
        return evaded[-1]

    monkeypatch.setattr(commitment, "find_evasions", record)
    link = Link(loss_probability=0.02, round=0.01)
    frames = compare(crowd_in_the_way(rng, rows=2, link=link, comm_radius=20.0), 10)
    assert any(evaded) and not any(e["kind"] == "unconfirmed" for f in frames for e in f.events)


def test_losses_change_nothing_where_rounds_take_no_time(rng):
    lossy = Link(loss_probability=0.3, late=2)
    mission = make_mission(spread(rng, 4), sato.Leg(spread(rng, 5), 12), link=lossy)
    with pytest.warns(UserWarning, match="lost or late change nothing"):
        agents, x = {i: sato.Agent(mission, i) for i in range(4)}, mission.initial_states
    now, never = np.zeros(4, dtype=int), np.full(4, NEVER)

    def act(own, inbox):
        return own, own.step(frame.time, x[own.number], inbox)[1]

    for _, frame in zip(range(4), simulate(mission, np.random.default_rng(1)), strict=False):
        graph = CommunicationGraph.from_positions(x[:, :2], mission.comm_radius, mission.alive)
        own = Channel(lossy, graph, rng), 2000, now, never
        history = relay(*own, lambda i: act(agents[i], []), act)
        next(after for after in history if all(own.is_finished for own in after.values()))
        control = np.array([agent.memory.control for agent in agents.values()])
        np.testing.assert_allclose(control, frame.control, rtol=0, atol=ROUNDING)
        assert [agent.target_index for agent in agents.values()] == frame.target_index.tolist()
        x = mission.flown_plant.propagate(x, control, 0.0, mission.step)[1]


def test_agent_that_missed_the_end_of_a_leg_begins_the_next_with_others(rng):
    legs = [sato.Leg(listed(spread(rng, 3)), 12), sato.Leg(listed(spread(rng, 3)), 12)]
    flight = NetworkFlight(make(spread(rng, 3), *legs))

    def decide():
        list(flight.decide(0, legs[0], 0))
        return [agent.is_leg_over for agent in flight.agents.values()]

    def follow(numbers):
        for i in numbers:
            flight.agents[i].set_targets(legs[1].shape, legs[1].steps)

    while not all(decide()):
        pass
    follow([0, 1])  # and the other has not heard that all have arrived
    assert decide() == [False, False, True]
    follow([2])
    while not all(decide()):
        pass
    memories = [agent.memory for agent in flight.agents.values()]
    assert len({memory.leg_start for memory in memories}) == 1
    held = [agent.target_index for agent in flight.agents.values()]
    assert sorted(held) == [0, 1, 2]
    goals = flight.mission.legs[1].targets[held, :2]
    np.testing.assert_allclose(flight.x[:, :2], goals, rtol=0, atol=1e-5)


def test_messages_of_another_kind_of_network_are_refused(rng):
    mission = make(spread(rng, 2), sato.Leg(spread(rng, 2), 12))
    own, other = (sato.Agent(mission, i) for i in range(2))
    packet = own.step(0.0, mission.initial_states[0], [])[1]
    ideal = make_mission(spread(rng, 2), sato.Leg(spread(rng, 2), 12))
    message = sato.Agent(ideal, 0).step(0.0, ideal.initial_states[0], [])[1]
    with pytest.raises(ValueError, match="inbox must hold messages that other agents returned"):
        other.step(0.0, mission.initial_states[1], [message])
    with pytest.raises(ValueError, match="agent 0 hears an agent of its own number"):
        own.step(0.0, mission.initial_states[0], [packet])
