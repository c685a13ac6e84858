"""Load of the network: batched counts against agents that send their messages."""

import numpy as np
import pytest
from agents import fly_by_messages
from message_sizes import measure, purpose_of
from test_agent import MISSIONS, OTHERS

import sato
from sato.network.encoding import HEADER
from sato.network.load import PURPOSES, Load
from sato.reconfiguration.loop import _Flight


def fly_counted(mission, seed):
    """Yield the load of each agent at each instant, as the loop counts it."""
    flight, counted = _Flight(mission, np.random.default_rng(seed)), []
    record = flight.make_frame
    flight.make_frame = lambda *flown: (counted.append(flight.loads), record(*flown))
    for number in range(len(mission.legs)):
        for _ in flight.fly_leg(number):
            yield Load(*(np.stack(part, axis=1) for part in zip(*counted.pop(), strict=True)))


def count_messages(rounds, graph):
    """Load of each agent by purpose, from the messages of each round."""
    found = np.zeros((3, len(graph.alive), len(PURPOSES)), dtype=int)
    told = {}
    for messages in rounds:
        for i, message in messages.items():
            purpose = PURPOSES.index(purpose_of(message.content))
            found[0, i, purpose] += 1
            size = measure(told.get((i, purpose)), message.content)
            told[i, purpose] = message.content
            if size:
                found[1:, graph.neighbors[i], purpose] += [[1], [HEADER + size]]
    return Load(*found)


@pytest.mark.filterwarnings("ignore:the plant does otherwise than the model")  # in wind
@pytest.mark.parametrize("draw", [*MISSIONS, *OTHERS])
def test_batched_load_is_that_of_agents_that_send_messages(rng, draw):
    mission, flown = draw(rng), 0
    flights = fly_counted(mission, 1), fly_by_messages(mission, 1)
    for _, loads, (*_, graph, rounds) in zip(range(24), *flights, strict=False):
        counted = count_messages(rounds, graph)
        for name, own, expected in zip(Load._fields, loads, counted, strict=True):
            np.testing.assert_array_equal(own, expected, err_msg=f"{name} at {flown}")
        flown += 1
    assert flown > 9


def test_summary_and_figure_show_what_the_run_file_holds():
    run = sato.run("crossing", seed=0)
    received, messages = run.data["received_bytes"].values, run.data["received_messages"].values
    shown = run.summary["bytes_received_max"]
    most = received[received.sum(axis=1).argmax()]
    assert shown == {"total": most.sum(), **dict(zip(PURPOSES, most, strict=True))}
    assert run.summary["messages_received_max"] == messages.sum(axis=1).max() > 0
    assert (received > HEADER * messages).all() and run.check().kept
    above, below = run.figures()["messages"].axes
    assert above.get_ylim()[1] * 1e3 > received.sum(axis=1).max()
    points = sum(len(line.get_xdata()) for line in below.lines)
    assert points == np.count_nonzero(run.data["rounds"].values)
