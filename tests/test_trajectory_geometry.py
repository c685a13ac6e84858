"""Trajectory geometry, against dense sampling, SciPy and laws of convexity."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal
from scipy.optimize import minimize_scalar, nnls

from dynamics import ClohessyWiltshire, DoubleIntegrator, LinearizedModel, discretize_zoh
from dynamics.closest_approach import closest_approaches
from dynamics.convex_hulls import body_distances
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant
from dynamics.trajectory_geometry import (
    control_points,
    evaluate_bezier,
    hull_distance,
    interpolation_error,
    interpolation_error_bound,
    sampled_interpolation_error,
    sampled_separations,
    separations,
)
from problems.path_separation import are_balls_separated, are_hulls_separated

number = st.floats(-10, 10, allow_subnormal=False).map(lambda v: 0.0 if abs(v) < 1e-9 else v)
hulls = st.sampled_from([2, 3]).flatmap(lambda d: arrays(float, (4, d), elements=number))
line = st.tuples(
    arrays(float, (1, 3), elements=number),
    arrays(float, (1, 3), elements=number),
    arrays(float, (4, 1), elements=number),
).map(lambda t: t[0] + t[2] * t[1])


def random_swarm(rng, agents=12, steps=9, axes=2, box=4.0):
    model = DoubleIntegrator(axes)
    x0 = np.hstack([rng.uniform(0, box, (agents, axes)), rng.normal(0, 0.4, (agents, axes))])
    u = rng.normal(0, 0.5, (agents, steps, axes))
    return model, discretize_zoh(model, 0.7, steps).simulate(x0, u), u


def substates(model, x, u, h, parts, t0=0.0):
    """Return states at finer instants, each step propagated from its own start."""
    plant, starts = LinearPlant(model), t0 + h * np.arange(u.shape[1])
    steps = [
        plant.propagate(x[:, k], u[:, k], t, h, parts)[:-1] for k, t in enumerate(starts.tolist())
    ]
    return np.moveaxis(np.concatenate([*steps, x[None, :, -1]]), 0, 1)


def parts(x, axes):
    x = np.moveaxis(x, 0, 1)
    return x[..., :axes], x[..., axes:], np.ones(x.shape[:2], bool)


def largest_error(pieces, fine):
    """Return the largest distance of cubic pieces from a path with finer instants."""
    count = (fine.shape[1] - 1) // pieces.shape[1]
    errors = [evaluate_bezier(pieces, j / count) - fine[:, j:-1:count] for j in range(count)]
    return np.linalg.norm(errors, axis=-1).max()


@pytest.mark.parametrize("axes", [2, 3])
def test_cubic_pieces_are_exact_for_a_double_integrator(rng, axes):
    model, x, u = random_swarm(rng, axes=axes)
    fine = substates(model, x, u, 0.7, 5)
    pieces = control_points(x[..., :axes], x[..., axes:], 0.7)
    assert largest_error(pieces, fine[..., :axes]) < 1e-12
    assert interpolation_error(model, x, u, 0.7) == 0.0


def test_interpolation_error_bound_holds_and_is_tight(rng):
    model = ClohessyWiltshire(1.1e-3)
    x0 = rng.normal(0, [1000] * 3 + [2.0] * 3, (6, 6))
    u = rng.normal(0, 1e-2, (6, 4, 3))
    x = discretize_zoh(model, 60.0, 4).simulate(x0, u)
    fine = substates(model, x, u, 60.0, 16)[..., :3]
    pieces = control_points(x[..., :3], x[..., 3:], 60.0)
    error = largest_error(pieces, fine)
    bound = interpolation_error_bound(model, x, u, 60.0)
    assert 0.5 * bound < error <= bound
    assert interpolation_error(model, x, u, 60.0, t0=7.0) == bound


ORBIT = Orbit.from_elements(7500e3, 0.1, 0.8)


def test_interpolation_error_bound_refuses_time_varying_models(rng):
    model = LinearizedModel(J2(ORBIT))
    with pytest.raises(ValueError, match="LinearizedModel is not time-invariant"):
        interpolation_error_bound(model, np.zeros((2, 6)), np.zeros((1, 3)), 1.0)


def test_interpolation_error_of_a_time_varying_model_is_measured(rng):
    model, start, h = LinearizedModel(J2(ORBIT)), 300.0, 20.0
    x0, u = rng.normal(0, [1000] * 3 + [2.0] * 3, (6, 6)), rng.normal(0, 1e-2, (6, 4, 3))
    x = discretize_zoh(model, h, 4, start).simulate(x0, u)
    fine = substates(model, x, u, h, 16, start)[..., :3]
    pieces = control_points(x[..., :3], x[..., 3:], h)
    error = largest_error(pieces, fine)
    assert interpolation_error(model, x, u, h, start) == pytest.approx(error, rel=2e-3)
    # The ends of the pieces need not be known, and absent agents have no error.
    x[:, 4] = np.nan
    x, u = np.vstack([x, np.full((1, 5, 6), np.nan)]), np.vstack([u, np.full((1, 4, 3), np.nan)])
    assert interpolation_error(model, x, u, h, start) == pytest.approx(error, rel=2e-3)


def test_sampled_interpolation_error_is_within_5_percent(rng):
    plant = InertialPlant(ORBIT)
    x0, u = rng.normal(0, [1000] * 3 + [2.0] * 3, (6, 6)), rng.normal(0, 1e-2, (6, 3))
    fine = np.moveaxis(plant.propagate(x0, u, 500.0, 120.0, 96), 0, 1)
    position, velocity = fine[..., :3], fine[..., 3:]
    pieces = control_points(position[:, ::8], velocity[:, ::8], 10.0)
    error = largest_error(pieces, position)
    found = sampled_interpolation_error(position[:, ::8], velocity[:, ::8], 10.0)
    assert found == pytest.approx(error, rel=0.05)
    position[2] = np.nan
    assert 0 < sampled_interpolation_error(position[:, ::8], velocity[:, ::8], 10.0) <= found
    with pytest.raises(ValueError, match="12 instants do not pair up into pieces of twice"):
        sampled_interpolation_error(position[:, :12], velocity[:, :12], 1.25)


@settings(deadline=None, max_examples=300)
@given(st.one_of(hulls, line))
@example(np.zeros((4, 2)))
@example(np.outer([1.0, 2.0, 3.0, 4.0], [0.1, 0.3]))
@example(np.outer([-1.0, 2.0, 3.0, 4.0], [0.1, 0.3, 0.7]))
def test_hull_distance_separates_and_its_point_is_in_the_hull(b):
    distance, nearest = hull_distance(b)
    scale = float(np.abs(b).max()) or 1.0
    if distance > 0:
        n = nearest / distance
        assert np.linalg.norm(n) == pytest.approx(1, abs=1e-14)
        assert (b @ n >= distance - 1e-12 * scale).all()
    # The point is in the hull: weights w ≥ 0 with Σ w = 1 and Σ w b = nearest.
    heavy = 1e3 * scale
    w, residual = nnls(np.vstack([b.T, np.full(4, heavy)]), np.append(nearest, heavy))
    assert residual <= 1e-7 * scale
    assert np.linalg.norm(w @ b) <= distance + 1e-7 * scale


def test_distances_of_many_hulls_are_those_of_each(rng):
    b = rng.normal(size=(3, 5, 4, 3)) + 0.8
    distance, nearest = hull_distance(b)
    assert distance.shape == (3, 5) and nearest.shape == (3, 5, 3)
    for i in np.ndindex(3, 5):
        one, point = hull_distance(b[i])
        assert one == distance[i] and (point == nearest[i]).all()


def test_a_hull_that_contains_the_origin_has_distance_zero():
    square = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]])
    corners = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])
    assert hull_distance(square)[0] == 0 and hull_distance(corners)[0] == 0
    assert hull_distance(corners + np.array([1.1, 0, 0]))[0] == pytest.approx(0.1)


def test_hulls_in_dimensions_other_than_2_and_3_are_refused():
    with pytest.raises(ValueError, match="2 or 3 axes, got 1"):
        hull_distance(np.zeros((4, 1)))


@pytest.mark.parametrize("axes", [2, 3])
def test_separation_is_the_minimum_over_pairs_and_time(rng, axes):
    _, x, _ = random_swarm(rng, agents=6, axes=axes, box=3.0)
    position, velocity, alive = parts(x, axes)
    found = separations(position, velocity, alive, 0.7)
    b = control_points(x[..., :axes], x[..., axes:], 0.7)
    t = np.linspace(0, 1, 201)
    for k in range(9):
        least = np.inf
        for i in range(6):
            for j in range(i):
                r = b[i, k] - b[j, k]
                path = evaluate_bezier(np.broadcast_to(r, (201, 4, axes)), t)
                size = np.linalg.norm(path, axis=1)
                best = t[int(np.argmin(size))]
                near = minimize_scalar(
                    lambda f, r=r: np.linalg.norm(evaluate_bezier(r, float(f))),
                    bounds=(max(best - 0.005, 0), min(best + 0.005, 1)),
                    method="bounded",
                    options={"xatol": 1e-10},
                )
                least = min(least, near.fun, size[0], size[-1])
        assert found.distance[k] == pytest.approx(least, rel=1e-9)
        i, j = found.pair[k]
        there = np.linalg.norm(evaluate_bezier(b[i, k] - b[j, k], float(found.fraction[k])))
        assert there == pytest.approx(found.distance[k], rel=1e-12)
    assert found.minimum.distance == found.distance.min()
    assert found.distance[found.minimum.piece] == found.minimum.distance
    samples = sampled_separations(position, alive)
    assert (found.distance <= np.minimum(samples[:-1], samples[1:])).all()


def test_a_collision_is_found_to_rounding_error():
    position = np.array([[[-0.7, 0.3], [1.0, 0.0]], [[0.9, -0.2], [-1.0, 0.0]]])
    meet = 0.375
    velocity = (position[1] - position[0])[None].repeat(2, axis=0)
    velocity[:, 1] = velocity[:, 0] * 0.5
    there = position[0, 0] + meet * velocity[0, 0]
    position[0, 1] = there - meet * velocity[0, 1]
    position[1, 1] = position[0, 1] + velocity[0, 1]
    found = separations(position, velocity, np.ones((2, 2), bool), 1.0).minimum
    assert found.distance < 1e-15 and found.fraction == pytest.approx(meet, abs=1e-12)


def test_coincident_agents_have_separation_zero(rng):
    _, x, _ = random_swarm(rng, agents=1)
    position, velocity, alive = parts(np.repeat(x, 2, axis=0), 2)
    assert (separations(position, velocity, alive, 0.7).distance == 0).all()


def test_lost_agents_count_until_they_are_lost(rng):
    _, x, _ = random_swarm(rng, agents=3)
    position, velocity, alive = parts(x, 2)
    alive[4:, 2] = False
    whole = separations(position, velocity, np.ones_like(alive), 0.7)
    found = separations(position, velocity, alive, 0.7)
    pair = separations(position[:, :2], velocity[:, :2], alive[:, :2], 0.7)
    assert_array_equal(found.distance[:4], whole.distance[:4])
    assert_array_equal(found.distance[4:], pair.distance[4:])
    position[5:, 2] = np.nan
    gone = separations(position, velocity, alive, 0.7)
    assert_array_equal(gone.distance, found.distance)
    alive[:, 1:] = False
    alone = separations(position, velocity, alive, 0.7)
    assert np.isinf(alone.distance).all() and alone.minimum.pair == (-1, -1)


def test_each_piece_may_have_its_own_duration(rng):
    _, x, _ = random_swarm(rng, steps=4)
    position, velocity, alive = parts(x, 2)
    one = separations(position, velocity, alive, 0.7)
    each = separations(position, velocity, alive, np.full(4, 0.7))
    assert_array_equal(one.distance, each.distance)


@given(hulls)
def test_hulls_are_separated_up_to_their_distance_and_no_farther(b):
    distance, _ = hull_distance(b)
    assert are_hulls_separated(b, float(distance) * (1 - 1e-14))
    assert not are_hulls_separated(b, float(distance) * (1 + 1e-14) + 1e-300)
    ball = np.linalg.norm(b.mean(axis=0)) - np.linalg.norm(b - b.mean(axis=0), axis=1).max()
    assert are_balls_separated(b, ball - 1e-9) and not are_balls_separated(b, ball + 1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_is_separated_from_what_is_not_a_number(d):
    b = np.full((4, d), 5.0)
    b[2, 0] = np.nan
    assert not are_hulls_separated(b, 1.0) and not are_balls_separated(b, 1.0)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.sampled_from([0.0, 1.0, 30.0]))
def test_nearest_of_each_group_is_that_of_dense_samples(seed, d, away):
    rng = np.random.default_rng(seed)
    pieces, group = (
        rng.normal(size=(20, 4, d)) + away * rng.normal(size=(20, 1, d)),
        np.arange(20) % 6,
    )
    pieces[:3] = pieces[:3, :1]  # at rest
    distance, fraction = closest_approaches(pieces, group)
    samples = [evaluate_bezier(pieces, t) for t in np.linspace(0, 1, 401).tolist()]
    dense = np.linalg.norm(samples, axis=2).min(axis=0)
    for g in range(6):
        own = np.flatnonzero(group == g)
        nearest = own[distance[own].argmin()]
        speed = 3 * np.linalg.norm(np.diff(pieces[own], axis=1), axis=2).max()
        least = dense[own].min()
        assert distance[nearest] * (1 - 1e-14) <= least <= distance[nearest] + speed / 800 + 1e-9
        there = evaluate_bezier(pieces[nearest], fraction[nearest])
        assert np.linalg.norm(there) == pytest.approx(distance[nearest], rel=1e-12)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]), st.booleans())
def test_distance_from_a_body_is_that_of_a_linear_program(seed, d, is_flat):
    rng = np.random.default_rng(seed)
    points, corners = rng.normal(size=(6, 4, d)), rng.normal(size=(2, 6, d))
    corners[1] = corners[1, :1]  # a point
    if is_flat:
        points[:, 2:] = points[:, :2]
        corners = np.round(corners)
    points += rng.uniform(0, 4) * np.eye(d)[0]
    body = np.arange(6) % 2
    distance, vector = body_distances(points, corners, body)
    for b, c, far, way in zip(points, corners[body], distance, vector, strict=True):
        # The nearest point of the hull of all differences, by least squares with weights ≥ 0.
        apart = (b[:, None] - c).reshape(-1, d)
        weights, _ = nnls(
            np.vstack([apart.T, np.full(len(apart), 1e4)]), np.append(np.zeros(d), 1e4)
        )
        other = np.linalg.norm(weights @ apart) / weights.sum()
        assert far <= other * (1 + 1e-12) + 1e-12 and other <= far + 1e-5
        assert np.linalg.norm(way) == pytest.approx(far, abs=1e-12)
        if far > 1e-9:
            assert (apart @ way / far).min() >= far - 1e-12
