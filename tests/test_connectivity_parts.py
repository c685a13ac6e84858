"""Potential, repulsion and obstacles."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from sato.connectivity.controller import (
    ASYMPTOTE_OFFSET,
    evaluate_potential,
    negative_slope,
    repulsion_gain,
)
from sato.connectivity.obstacles import (
    Obstacles,
    blocks_line_of_sight,
    nearest_points,
    obstacle_distances,
)
from sato.connectivity.settings import Potential, Repulsion

POTENTIALS = st.builds(
    lambda least, span, strength: Potential(least, least + span, strength),
    st.floats(0, 0.5), st.floats(0.5, 6), st.floats(0.01, 1),
)  # fmt: skip
REPULSIONS = st.builds(
    lambda nearest, span, strength: Repulsion(nearest, nearest + span, strength),
    st.floats(0.1, 2), st.floats(0.2, 4), st.floats(0.1, 2),
)  # fmt: skip
SHARES = st.floats(0.01, 0.99)  # of the way from the asymptote to where all ends


@given(POTENTIALS, SHARES)
def test_action_is_minus_the_slope_of_the_potential(potential, share):
    x = share * (potential.lambda2_max - potential.lambda2_min)
    h = 1e-5 * min(x, 1)
    assume(x > ASYMPTOTE_OFFSET + h)
    at = potential.lambda2_min + x
    fall = (evaluate_potential(at - h, potential) - evaluate_potential(at + h, potential)) / (2 * h)
    # Central differences err by h² V‴/6 ~ strength m² h²/x⁴, rounding by ε V/h.
    assert negative_slope(at, potential) == pytest.approx(fall, rel=1e-6, abs=1e-8)


@given(POTENTIALS)
def test_potential_ends_smoothly_at_lambda2_max(potential):
    most, strength, h = potential.lambda2_max, potential.strength, 1e-6
    beyond = most + np.array([0.0, 1.0, 100.0])
    assert evaluate_potential(beyond, potential) == pytest.approx(np.zeros(3), abs=1e-25)
    assert negative_slope(beyond, potential) == pytest.approx(np.zeros(3), abs=1e-13)
    assert evaluate_potential(most - h, potential) <= 3 * strength * h * h
    assert 0 < negative_slope(most - h, potential) <= 10 * strength * h


@given(POTENTIALS, SHARES, SHARES)
def test_potential_and_action_decrease_with_lambda2(potential, share, other):
    low, high = sorted((share, other))
    assume(high - low > 1e-6)
    m = potential.lambda2_max - potential.lambda2_min
    low, high = potential.lambda2_min + low * m, potential.lambda2_min + high * m
    for law in (evaluate_potential, negative_slope):
        assert law(low, potential) >= law(high, potential) > 0


@given(POTENTIALS)
def test_potential_grows_as_one_over_the_distance_to_lambda2_min(potential):
    least, m = potential.lambda2_min, potential.lambda2_max - potential.lambda2_min
    at = least + ASYMPTOTE_OFFSET
    grown = potential.strength * (m - ASYMPTOTE_OFFSET) ** 2 / ASYMPTOTE_OFFSET
    assert evaluate_potential(at, potential) == pytest.approx(grown)
    # Nearer than that, and below the limit, all is finite and stays as it is.
    beyond = np.array([least + ASYMPTOTE_OFFSET / 2, least, -1.0])
    for law in (evaluate_potential, negative_slope):
        assert law(beyond, potential) == pytest.approx(np.full(3, law(at, potential)))


@given(REPULSIONS, SHARES, SHARES)
def test_repulsion_decreases_with_distance_to_zero(repulsion, share, other):
    low, high = sorted((share, other))
    assume(high - low > 1e-6)
    least, most, strength = repulsion
    m, h = most - least, 1e-6
    assert repulsion_gain(least + low * m, repulsion) >= repulsion_gain(least + high * m, repulsion)
    assert 0 < repulsion_gain(most - h, repulsion) <= 2 * strength * (h / m) ** 2
    beyond = most + np.array([0.0, 1e-9, 5.0])
    assert repulsion_gain(beyond, repulsion) == pytest.approx(np.zeros(3), abs=1e-25)
    near = least + ASYMPTOTE_OFFSET * np.array([1, 1 / 2, -9])
    steep = strength * m * (1 - ASYMPTOTE_OFFSET / m) ** 2 / ASYMPTOTE_OFFSET
    assert repulsion_gain(near, repulsion) == pytest.approx(np.full(3, steep))


PLACES = st.tuples(*[st.floats(-6, 6)] * 3).map(np.array)
UNITS = PLACES.filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))
SPHERES = st.tuples(PLACES, st.floats(0.1, 3)).map(lambda s: np.append(*s))
BOXES = st.tuples(PLACES, st.tuples(*[st.floats(0.1, 5)] * 3)).map(
    lambda b: np.concatenate([b[0], b[0] + np.array(b[1])])
)
PLANES = st.tuples(UNITS, st.floats(-3, 3)).map(lambda p: np.append(*p))


def surfaces(sphere, box, plane, rng):
    """Sample the surfaces of three obstacles."""
    ways = rng.normal(size=(2000, 3))
    of_sphere = sphere[:3] + sphere[3] * ways / np.linalg.norm(ways, axis=1)[:, None]
    of_box = rng.uniform(box[:3], box[3:], (2000, 3))
    side, axis = rng.integers(0, 2, 2000), rng.integers(0, 3, 2000)
    of_box[np.arange(2000), axis] = box.reshape(2, 3)[side, axis]
    spread = rng.uniform(-20, 20, (2000, 3))
    of_plane = spread - (spread @ plane[:3] - plane[3])[:, None] * plane[:3]
    return of_sphere, of_box, of_plane


@given(PLACES, SPHERES, BOXES, PLANES)
def test_nearest_point_is_nearer_than_any_sample_of_the_surface(p, sphere, box, plane):
    obstacles = Obstacles(sphere[None], box[None], plane[None])
    drawn = surfaces(sphere, box, plane, np.random.default_rng(0))
    points, distances = nearest_points(p, obstacles), obstacle_distances(p, obstacles)
    for number, (surface, point, d) in enumerate(zip(drawn, points, distances, strict=True)):
        assert obstacle_distances(point, obstacles)[number] == pytest.approx(0, abs=1e-12)
        assert np.linalg.norm(point - p) == pytest.approx(abs(d), abs=1e-12)
        assert np.linalg.norm(surface - p, axis=1).min() >= abs(d) - 1e-12


@given(PLACES, PLACES, SPHERES, BOXES, PLANES)
def test_line_of_sight_is_blocked_by_points_inside_obstacles(p, q, sphere, box, plane):
    none = Obstacles.of(())
    for one in (
        none._replace(spheres=sphere[None]),
        none._replace(boxes=box[None]),
        none._replace(planes=plane[None]),
        Obstacles(sphere[None], box[None], plane[None]),
    ):
        way = p + np.linspace(0, 1, 2001)[:, None] * (q - p)
        least = obstacle_distances(way, one).min()
        # Between two samples the distance can be less by half of what they are apart.
        if least < -1e-9:
            assert blocks_line_of_sight(p, q, one) and blocks_line_of_sight(q, p, one)
        if least > np.linalg.norm(q - p) / 4000 + 1e-9:
            assert not blocks_line_of_sight(p, q, one) and not blocks_line_of_sight(q, p, one)


def test_box_blocks_lines_of_sight_along_an_axis():
    # Two of three coordinates rest, which a division by the way would not bear.
    one = Obstacles.of(())._replace(boxes=np.array([[-1.0, -1, -1, 1, 1, 1]]))
    p, q = np.array([-3.0, 0.5, 0.5]), np.array([3.0, 0.5, 0.5])
    assert blocks_line_of_sight(p, q, one)
    assert blocks_line_of_sight(np.zeros(3), np.array([0.0, 0.0, 2e-309]), one)  # 1 over it is ∞
    beside, short = np.array([0, 1.0, 0]), np.array([-2.0, 0.5, 0.5])
    assert not blocks_line_of_sight(p + beside, q + beside, one)
    assert not blocks_line_of_sight(p, short, one)
