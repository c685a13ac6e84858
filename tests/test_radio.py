"""What communication costs: laws, and the figures of [Lusk2020, sec. V-B]."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sato.auctions.cbaa_init import run_cbaa
from sato.network.graph import CommunicationGraph
from sato.network.radio import Radio

WIDE = Radio(id_bits=16)  # enough to tell 800 vehicles apart


@given(
    capacity=st.floats(0, 1e9),
    degree=st.integers(1, 100),
    diameter=st.integers(1, 9),
    period=st.floats(0.1, 100),
)
def test_the_largest_swarm_fits_and_one_vehicle_more_does_not(capacity, degree, diameter, period):
    n = WIDE.max_swarm_size(capacity, degree, diameter, period)
    if n > 0:
        assert WIDE.compute_load(np.full(n, degree), n * diameter, period)[0] <= capacity * (
            1 + 1e-12
        )
    if n < WIDE.max_vehicles:
        more = n + 1
        assert WIDE.compute_load(np.full(more, degree), more * diameter, period)[0] >= capacity * (
            1 - 1e-12
        )


def test_a_vehicle_receives_as_many_times_more_as_it_has_neighbours():
    one, two, three = Radio().compute_load(np.array([1, 2, 3]), 12, 1.0)
    assert (two, three) == (2 * one, 3 * one)


def test_all_books_of_an_auction_are_the_bits_that_all_receive(rng):
    network = CommunicationGraph(~np.eye(9, dtype=bool), np.full(9, True))
    auction = run_cbaa(rng.random((9, 9)) + 0.1, network, rounds=1)
    degree = network.adjacency.sum(axis=1)
    bits = Radio().compute_load(degree, auction.round_count, 1.0) - Radio().compute_load(
        degree, 0, 1.0
    )
    assert bits.sum() == auction.message_count * (64 + 9 * 64)


@pytest.mark.parametrize(
    ("delay", "rounds"), [(0.0, 0), (0.02, 1), (0.14, 7), (0.141, 8), (0.001, 1)]
)
def test_a_delay_counts_in_whole_rounds_begun(delay, rounds):
    assert Radio(delay=delay).delay_rounds == rounds


def test_the_rounds_in_a_time_are_those_that_are_whole():
    assert [Radio().rounds_within(t) for t in (0.0, 0.019, 0.02, 0.58, 1.2, 2.0)] == [
        0,
        0,
        1,
        29,
        60,
        100,
    ]


# Published numbers


def test_a_neighbour_costs_5_point_2_kilobits_a_second():
    assert Radio().localization_rate == 5200


@pytest.mark.parametrize(("n", "d"), [(6, 2), (30, 1), (30, 2), (100, 3), (800, 3)])
def test_an_auction_costs_a_neighbour_0_064_n_d_n_plus_1_kilobits(n, d):
    assert Radio().count_auction_bits(n, n * d) == pytest.approx(1e3 * 0.064 * n * d * (n + 1))


SLANTED_PLANE = "01 02 03 12 14 25 34 35 45"
PYRAMID = "02 03 05 12 15 23 34 45"


@pytest.mark.parametrize("edges", [SLANTED_PLANE, PYRAMID])
def test_six_vehicles_cost_each_other_about_9_kilobits_a_second(edges):
    hears = np.zeros((6, 6), dtype=bool)
    for edge in edges.split():
        i, j = int(edge[0]), int(edge[1])
        hears[i, j] = hears[j, i] = True
    network = CommunicationGraph(hears, np.full(6, True))
    assert network.diameter.tolist() == [2] * 6
    a_neighbour = Radio().compute_load(np.ones(6, dtype=int), 6 * 2, 1.2)
    assert a_neighbour == pytest.approx(np.full(6, 9680.0))


def test_thirty_vehicles_receive_less_than_was_measured_with_headers():
    # Pairs to remove are drawn evenly from 1 … 26, of the 435 edges: 28.1 neighbours.
    degree = 2 * (435 - 13.5) / 30
    load = degree * Radio().compute_load(np.ones(30, dtype=int), 30 * 2, 2.0)[0]
    assert load == pytest.approx(1818.6e3, rel=1e-4)
    assert 0.8 < load / 2161e3 < 1.0


def test_eight_hundred_vehicles_saturate_54_megabits_a_second_each():
    # 802.11g; 13 neighbours and diameter 3, one of the pairs with a product of 39.
    assert WIDE.max_swarm_size(54e6, degree=13, diameter=3, period=30.0) == 804
    assert WIDE.max_swarm_size(54e6, degree=20, diameter=2, period=30.0) == pytest.approx(
        800, rel=0.01
    )
    each = WIDE.compute_load(np.full(800, 13), 800 * 3, 30.0)
    assert each[0] == pytest.approx(53.4e6, rel=1e-3)
    assert each.sum() / 13 == pytest.approx(3.29e9, rel=1e-2)  # told once, heard by 13


def test_eight_bits_do_not_tell_eight_hundred_vehicles_apart():
    assert Radio().max_swarm_size(54e6, degree=13, diameter=3, period=30.0) == 256


def test_without_room_for_positions_there_is_no_swarm():
    assert Radio().max_swarm_size(5000.0, degree=1, diameter=1, period=1.0) == 0


# Refusals


@pytest.mark.parametrize(
    "bad",
    [
        {"message_rate": 0.0},
        {"loss_probability": 1.0},
        {"loss_probability": -0.1},
        {"delay": -1.0},
        {"id_bits": 0},
    ],
)
def test_a_radio_that_cannot_be_is_refused(bad):
    with pytest.raises(ValueError, match="the rate and the bits of a number must be positive"):
        Radio(**bad)


def test_auctions_need_time_between_them():
    with pytest.raises(ValueError, match="there must be time between auctions, got 0"):
        Radio().compute_load(np.ones(3, dtype=int), 6, 0.0)


@pytest.mark.parametrize("bad", [{"degree": 0}, {"diameter": 0}, {"period": 0.0}])
def test_a_swarm_needs_neighbours_hops_and_time(bad):
    with pytest.raises(ValueError, match="all must be positive"):
        Radio().max_swarm_size(1e6, **{"degree": 1, "diameter": 1, "period": 1.0} | bad)
