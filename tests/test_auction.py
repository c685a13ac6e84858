"""Books: the algebra that lets news arrive in any order, and who wins."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sato.auction import NOBODY, Book, merge, newer

LAW = settings(deadline=None, derandomize=True)
PRICES = st.sampled_from([0.0, 0.5, 1.0, 1.5])  # few, so that ties are common


@st.composite
def books(draw: st.DrawFn, targets: int = 4) -> Book:
    sizes = draw(st.lists(PRICES, min_size=targets, max_size=targets))
    holders = draw(st.lists(st.integers(NOBODY, 3), min_size=targets, max_size=targets))
    holder = [NOBODY if size == 0 else who for size, who in zip(sizes, holders, strict=True)]
    price = [-size if who == NOBODY else size for size, who in zip(sizes, holder, strict=True)]
    return Book(np.array(price), np.array(holder))


def same(a: Book, b: Book) -> bool:
    return np.array_equal(a.price, b.price) and np.array_equal(a.holder, b.holder)


@LAW
@given(books(), books())
def test_merging_ignores_who_speaks_first(a, b):
    assert same(merge(a, b), merge(b, a))


@LAW
@given(books(), books(), books())
def test_merging_ignores_the_grouping(a, b, c):
    assert same(merge(merge(a, b), c), merge(a, merge(b, c)))


@LAW
@given(books(), books())
def test_hearing_something_twice_changes_nothing(a, b):
    once = merge(a, b)
    assert same(merge(once, b), once)
    assert same(merge(a, a), a)


@LAW
@given(books(), books())
def test_a_book_only_grows(a, b):
    # Nothing in either book is newer than what both give together.
    both = merge(a, b)
    assert not newer(both, a).any()
    assert not newer(both, b).any()
    assert np.all(np.abs(both.price) >= np.maximum(np.abs(a.price), np.abs(b.price)))


@LAW
@given(books())
def test_an_empty_book_says_nothing(a):
    assert same(merge(a, Book.empty(4)), a)


def test_the_larger_magnitude_wins_then_for_sale_then_the_smaller_number():
    mine = Book(np.array([1.0, -2.0, 1.0, 1.0]), np.array([4, NOBODY, 4, 4]))
    heard = Book(np.array([-1.5, 1.0, -1.0, 1.0]), np.array([NOBODY, 2, NOBODY, 3]))
    both = merge(mine, heard)
    assert both.price.tolist() == [-1.5, -2.0, -1.0, 1.0]
    assert both.holder.tolist() == [NOBODY, NOBODY, NOBODY, 3]


def test_bidders_are_counted_by_standing_bids_not_by_prices():
    book = Book(np.array([1.0, -2.0, 0.0, 3.0]), np.array([0, NOBODY, NOBODY, 7]))
    assert book.bidders == 2
