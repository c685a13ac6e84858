"""Separation of many paths at once: boxes and balls leave out no piece that matters."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from problems.path_separation import (
    BOX_PIECES,
    are_hulls_separated,
    are_paths_separated,
    near_pieces,
)


def random_paths(rng, count, pieces, axes):
    """Draw smooth paths that wind about each other, a few of which rest."""
    ends = rng.normal(0, 0.3, (count, pieces + 1, axes)).cumsum(axis=1)
    ends[: count // 4] = ends[: count // 4, :1]
    ends += rng.uniform(-3, 3, (count, 1, axes))
    third = np.linspace(0, 1, 4)[:, None]
    return ends[:, :-1, None] * (1 - third) + ends[:, 1:, None] * third


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 3), st.integers(1, 3 * BOX_PIECES))
def test_separation_of_paths_is_that_of_all_their_pieces(seed, axes, pieces):
    rng = np.random.default_rng(seed)
    paths = random_paths(rng, 12, pieces, axes)
    i, j = np.triu_indices(12, 1)
    radius = rng.uniform(0.1, 1.5, len(i))
    each = are_hulls_separated(paths[i] - paths[j], radius)
    assert np.array_equal(are_paths_separated(paths, i, j, radius), each.all(axis=1))
    pair, piece = near_pieces(paths, i, j, radius)
    left_out = np.ones(each.shape, dtype=bool)
    left_out[pair, piece] = False
    assert each[left_out].all() and len(pair) == len(
        {*zip(pair.tolist(), piece.tolist(), strict=True)}
    )


def test_boxes_leave_out_nearly_all_of_paths_that_meet_once(rng):
    across = np.array([[1.0, 0.0], [-1.0, 0.0]])[:, None] * np.linspace(-20, 20, 81)[:, None]
    third = np.linspace(0, 1, 4)[:, None]
    paths = across[:, :-1, None] * (1 - third) + across[:, 1:, None] * third
    pair, piece = near_pieces(paths, np.array([0]), np.array([1]), np.array([1.0]))
    assert 38 in piece and 41 in piece and len(piece) <= 2 * BOX_PIECES and set(pair) == {0}


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_paths_that_are_not_finite_are_not_separated(value):
    paths = np.zeros((2, 3, 4, 2))
    paths[1, ..., 0] = 5.0
    one, other = np.array([0]), np.array([1])
    assert are_paths_separated(paths, one, other, np.ones(1)).all()
    paths[0, 1] = value
    with np.errstate(invalid="ignore"):
        assert not are_paths_separated(paths, one, other, np.ones(1)).any()


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_paths_have_no_pairs(count):
    none = np.zeros(0, dtype=int)
    assert not len(are_paths_separated(np.zeros((count, 5, 4, 2)), none, none, np.zeros(0)))
