"""Load of a radio link: rounds in a time, and the figures of [Lusk2020, sec. V-B]."""

import numpy as np
import pytest

from sato.network.graph import CommunicationGraph
from sato.network.radio import Radio


def load(vehicles, diameter, period, neighbors=1):
    """Bits a second that a vehicle receives, with auctions of vehicles × diameter rounds."""
    auction = Radio().count_auction_bits(vehicles, vehicles * diameter)
    return neighbors * (Radio().localization_rate + auction / period)


def test_message_of_an_auction_holds_its_numbers_and_all_bids():
    assert Radio().count_auction_bits(9, 1) == 64 + 9 * 64


@pytest.mark.parametrize(
    ("delay", "rounds"), [(0.0, 0), (0.02, 1), (0.14, 7), (0.141, 8), (0.001, 1)]
)
def test_delay_is_rounded_up_to_whole_rounds(delay, rounds):
    assert Radio(delay=delay).delay_rounds == rounds


def test_rounds_within_a_time_are_whole():
    times = (0.0, 0.019, 0.02, 0.58, 1.2, 2.0)
    assert [Radio().rounds_within(t) for t in times] == [0, 0, 1, 29, 60, 100]


# Published numbers


def test_positions_take_5_2_kbit_s_from_a_neighbor():
    assert Radio().localization_rate == 5200


@pytest.mark.parametrize(("n", "d"), [(6, 2), (30, 1), (30, 2), (100, 3), (800, 3)])
def test_auction_takes_the_published_bits_from_a_neighbor(n, d):
    assert Radio().count_auction_bits(n, n * d) == pytest.approx(1e3 * 0.064 * n * d * (n + 1))


SLANTED_PLANE = "01 02 03 12 14 25 34 35 45"
PYRAMID = "02 03 05 12 15 23 34 45"


@pytest.mark.parametrize("edges", [SLANTED_PLANE, PYRAMID])
def test_six_vehicles_take_about_9_kbit_s_from_a_neighbor(edges):
    adjacency = np.zeros((6, 6), dtype=bool)
    for edge in edges.split():
        i, j = int(edge[0]), int(edge[1])
        adjacency[i, j] = adjacency[j, i] = True
    graph = CommunicationGraph(adjacency, np.full(6, True))
    assert graph.diameter.tolist() == [2] * 6
    assert load(6, 2, 1.2) == pytest.approx(9680.0)


def test_headers_of_ros_add_up_to_the_load_measured_for_thirty_vehicles():
    # Pairs to remove are drawn evenly from 1 … 26, of the 435 edges: 28.1 neighbors.
    neighbors, period, rounds = 2 * (435 - 13.5) / 30, 2.0, 30 * 2
    payload = load(30, 2, period, neighbors)
    assert payload == pytest.approx(1818.6e3, rel=1e-4)
    header, length = 8 * (4 + 8 + 4), 8 * 4  # number, time and empty frame; of a list [bit]
    positions, bids = header * Radio().message_rate, (header + 2 * length) * rounds / period
    assert payload + neighbors * (positions + bids) == pytest.approx(2161e3, rel=1e-3)


def test_eight_hundred_vehicles_saturate_54_mbit_s_each():
    # 802.11g; 13 neighbors and diameter 3, one of the pairs with a product of 39.
    assert load(804, 3, 30.0, neighbors=13) <= 54e6 < load(805, 3, 30.0, neighbors=13)
    received = load(800, 3, 30.0, neighbors=13)
    assert received == pytest.approx(53.4e6, rel=1e-3)
    assert received * 800 / 13 == pytest.approx(3.29e9, rel=1e-2)  # sent once, heard by 13


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"message_rate": 0.0}, "rate_hz: must be greater than 0"),
        ({"loss_probability": 1.0}, "loss: must be less than 1"),
        ({"loss_probability": -0.1}, "loss: must be at least 0"),
        ({"delay": -1.0}, "delay_s: must be at least 0"),
        ({"id_bits": 0}, "id_bits: must be greater than 0"),
    ],
)
def test_impossible_radio_is_refused(bad, message):
    with pytest.raises(ValueError, match=message):
        Radio(**bad)
