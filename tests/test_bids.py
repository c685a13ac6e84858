"""Merge of winning bids: its algebra, and the order of bids."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sato.auctions.bidder import WinningBids, find_newer_bids, merge_bids
from sato.auctions.vsdaa import NO_WINNER

LAW = settings(deadline=None, derandomize=True)
PRICES = st.sampled_from([0.0, 0.5, 1.0, 1.5])  # few, so that ties are common


@st.composite
def tables(draw: st.DrawFn, targets: int = 4) -> WinningBids:
    sizes = draw(st.lists(PRICES, min_size=targets, max_size=targets))
    winners = draw(st.lists(st.integers(NO_WINNER, 3), min_size=targets, max_size=targets))
    winner = [NO_WINNER if size == 0 else i for size, i in zip(sizes, winners, strict=True)]
    price = [-size if i == NO_WINNER else size for size, i in zip(sizes, winner, strict=True)]
    return WinningBids(np.array(price), np.array(winner))


def same(a: WinningBids, b: WinningBids) -> bool:
    return np.array_equal(a.price, b.price) and np.array_equal(a.winner, b.winner)


@LAW
@given(tables(), tables(), tables())
def test_merge_is_commutative_associative_and_idempotent(a, b, c):
    both = merge_bids(a, b)
    assert same(both, merge_bids(b, a))
    assert same(merge_bids(both, c), merge_bids(a, merge_bids(b, c)))
    assert same(merge_bids(both, b), both)
    assert same(merge_bids(a, WinningBids.empty(4)), a)


@LAW
@given(tables(), tables())
def test_merged_bids_are_no_older_than_either(a, b):
    # No entry of either is newer than the merged one.
    both = merge_bids(a, b)
    assert not find_newer_bids(both, a).any()
    assert not find_newer_bids(both, b).any()
    assert np.all(np.abs(both.price) >= np.maximum(np.abs(a.price), np.abs(b.price)))


def test_larger_magnitude_wins_then_for_sale_then_smaller_agent():
    mine = WinningBids(np.array([1.0, -2.0, 1.0, 1.0]), np.array([4, NO_WINNER, 4, 4]))
    heard = WinningBids(np.array([-1.5, 1.0, -1.0, 1.0]), np.array([NO_WINNER, 2, NO_WINNER, 3]))
    both = merge_bids(mine, heard)
    assert both.price.tolist() == [-1.5, -2.0, -1.0, 1.0]
    assert both.winner.tolist() == [NO_WINNER, NO_WINNER, NO_WINNER, 3]


def test_winner_count_counts_standing_bids_alone():
    bids = WinningBids(np.array([1.0, -2.0, 0.0, 3.0]), np.array([0, NO_WINNER, NO_WINNER, 7]))
    assert bids.winner_count == 2
