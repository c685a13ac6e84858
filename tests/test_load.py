"""Load of the network: batched counts against agents that send their messages."""

import numpy as np
import pytest
from agents import fly_by_messages
from test_agent import MISSIONS, OTHERS

from sato.network.load import PURPOSES
from sato.reconfiguration.loop import _Flight
from sato.reconfiguration.network_decision import census_rounds
from sato.reconfiguration.purposes import purpose_of


def fly_counted(mission, seed):
    """Yield the rounds of each agent at each instant, as the loop counts them."""
    flight, decided = _Flight(mission, np.random.default_rng(seed)), []
    take_up = flight._take_up
    flight._take_up = lambda outcome: (decided.append(outcome), take_up(outcome))
    for number in range(len(mission.legs)):
        for _ in flight.fly_leg(number):
            rounds = np.zeros((len(flight.x), len(PURPOSES)), dtype=int)
            graph = flight.make_graph()
            yield decided, rounds, graph
            decided.clear()


@pytest.mark.parametrize("draw", [*MISSIONS, *OTHERS])
def test_batched_rounds_are_those_of_agents_that_send_messages(rng, draw):
    mission = draw(rng)
    flown = 0
    flights = fly_counted(mission, 1), fly_by_messages(mission, 1)
    for _, (decided, rounds, _), (_, _, agents, graph, sent) in zip(
        range(40), *flights, strict=False
    ):
        rounds[:, 0] = np.where(graph.alive, census_rounds(graph), 0)
        for outcome in decided:
            rounds[:, 1:] += outcome.rounds
        counted = np.zeros_like(rounds)
        for messages in sent:
            for i, message in messages.items():
                counted[i, PURPOSES.index(purpose_of(message.content))] += 1
        assert set(np.flatnonzero(counted.any(axis=1))) == set(agents)
        np.testing.assert_array_equal(rounds, counted)
        flown += 1
    assert flown > 9
