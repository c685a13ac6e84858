"""Obstacles: their distances against sampling and programs, and what is no obstacle."""

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sato
from dynamics.convex_hulls import body_distances
from problems.obstacle_paths import ObstaclePaths, is_path_clear, measure_gaps, support_obstacles
from sato.obstacles import polytope_about_ball
from sato.scp.routes import find_route

SIDES = (
    sato.Polytope(points=[[0.0, 0.0], [2.0, 0.0], [0.0, 1.0]]),
    sato.Polytope(normals=[[1.0, 0.0], [-1.0, 1.0], [0.0, -2.0]], offsets=[1.0, 1.0, 1.0]),
    sato.Box((-1.0, 0.0), (1.0, 0.5)),
    sato.Ellipsoid((0.5, 0.0), (2.0, 0.5)),
    sato.Sphere((1.0, 1.0), 0.7),
    sato.Box((-1.0, 0.0, 0.0), (1.0, 0.5, 2.0)),
    sato.Ellipsoid((0.5, 0.0, 1.0), (2.0, 0.5, 1.0)),
    sato.Sphere((1.0, 1.0, 0.0), 0.7),
)


def surface(obstacle, count=4000):
    """Points of the obstacle in all directions from its middle."""
    rng = np.random.default_rng(0)
    way = rng.normal(size=(count, obstacle.axes))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    low, high = np.zeros(count), np.full(count, 10.0)
    for _ in range(60):
        middle = (low + high) / 2
        inside = obstacle.distances(obstacle.place + middle[:, None] * way) == 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return obstacle.place + low[:, None] * way


@pytest.mark.parametrize("obstacle", SIDES, ids=lambda one: f"{one.kind}{one.axes}")
def test_nearest_points_are_no_farther_than_any_of_the_surface(rng, obstacle):
    points, about = rng.normal(0, 3, (30, obstacle.axes)), surface(obstacle)
    away = obstacle.distances(points)
    sampled = np.linalg.norm(points[:, None] - about, axis=2).min(axis=1)
    outside = away > 0
    assert (away <= sampled + 1e-9)[outside].all()
    np.testing.assert_allclose(away[outside], sampled[outside], atol=0.15)
    assert (obstacle.distances(obstacle.nearest(points)) < 1e-6).all()


@pytest.mark.parametrize("obstacle", SIDES, ids=lambda one: f"{one.kind}{one.axes}")
def test_planned_body_contains_the_obstacle_and_is_hardly_larger(rng, obstacle):
    way = rng.normal(size=(200, obstacle.axes))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    planned = (obstacle.corners @ way.T).max(axis=0) + obstacle.thickness
    real = ((surface(obstacle) - obstacle.place) @ way.T).max(axis=0)
    assert (planned >= real - 1e-9).all()
    assert (planned <= 1.12 * real + 0.1).all()


@pytest.mark.parametrize("obstacle", SIDES, ids=lambda one: f"{one.kind}{one.axes}")
def test_scaled_space_has_the_scaled_points(rng, obstacle):
    factors = tuple(rng.uniform(0.5, 2.0, obstacle.axes).tolist())
    scaled, points = obstacle.scaled(factors), surface(obstacle, 50)
    assert (scaled.distances(points * factors) < 1e-6).all()
    outside = obstacle.place + 1.01 * (points - obstacle.place)
    is_out = obstacle.distances(outside) > 0
    assert (scaled.distances(outside * factors) > 0)[is_out].all()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), axes=st.sampled_from([2, 3]))
def test_distance_from_a_body_is_that_of_the_program(seed, axes):
    rng = np.random.default_rng(seed)
    path, corners = rng.normal(size=(1, 4, axes)), rng.normal(size=(1, 7, axes))
    path = path + rng.normal(0, 3, axes)
    (found,), (vector,) = body_distances(path, corners, np.zeros(1, dtype=int))
    a, b = cp.Variable(4, nonneg=True), cp.Variable(7, nonneg=True)
    between = path[0].T @ a - corners[0].T @ b
    program = cp.Problem(cp.Minimize(cp.norm(between)), [cp.sum(a) == 1, cp.sum(b) == 1])
    assert found == pytest.approx(program.solve(solver="CLARABEL"), abs=1e-5)
    if found > 0:  # and it is proven by the plane across it
        n = vector / found
        assert (path[0] @ n).min() - (corners[0] @ n).max() >= found * (1 - 1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), axes=st.sampled_from([2, 3]))
def test_path_beyond_its_half_spaces_is_clear_of_the_whole_obstacle(seed, axes):
    rng = np.random.default_rng(seed)
    corners = 0.5 * rng.normal(size=(1, 6, axes))
    body = ObstaclePaths(np.zeros((1, 3, 4, axes)), corners, np.array([0.4]), np.zeros((1, axes)))
    nominal = rng.normal(size=(3, 4, axes)) * 0.3 + rng.normal(0, 2, axes)
    support, normal = support_obstacles(nominal, body)
    path = nominal + rng.normal(0, 0.3, nominal.shape)
    room = np.einsum("pd,pcd->pc", normal[0], path - support[0]).min(axis=1)
    path += normal[0][:, None] * np.maximum(0.4 - room, 0.0)[:, None, None] * (1 + 1e-9)
    assert is_path_clear(path, body._replace(clearance=np.array([0.4 * (1 - 1e-9)])))
    if measure_gaps(nominal[None], body)[0].min() >= 0.4 * (1 + 1e-6):
        own = np.einsum("pd,pcd->pc", normal[0], nominal - support[0])
        assert own.min() >= 0.4 * (1 - 1e-9)  # a clear nominal satisfies its own


def test_ball_is_within_its_polytope():
    for axes, most in ((2, 1.01), (3, 1.03)):
        corners = polytope_about_ball(axes)
        assert np.linalg.norm(corners, axis=1).max() < most
        way = np.random.default_rng(0).normal(size=(500, axes))
        assert ((corners @ way.T).max(axis=0) >= np.linalg.norm(way, axis=1)).all()


def test_route_leads_around_and_is_hardly_longer_than_the_shortest():
    place, d = np.zeros((1, 1, 1, 2)), 2
    ball = ObstaclePaths(
        place + np.zeros((1, 1, 4, d)), np.zeros((1, 1, d)), np.ones(1), np.zeros((1, d))
    )
    way = find_route(np.array([-2.0, 0.0]), np.array([2.0, 0.0]), ball)
    shortest = 2 * (3**0.5) + np.pi / 3  # two tangents and an arc
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert shortest <= length <= 1.02 * shortest
    room = np.array([[0.0, 3.0], [0.0, -3.0], [3.0, 0.0], [-3.0, 0.0]])
    wall = np.array([[[-4.0, 0], [4.0, 0]]] * 2 + [[[0, -4.0], [0, 4.0]]] * 2)
    paths = np.repeat(room[:, None, None], 4, axis=2)
    closed = ObstaclePaths(paths, wall, np.full(4, 0.5), np.zeros((4, 2)))
    assert find_route(np.zeros(2), np.array([9.0, 0.0]), closed) is None


def test_faces_are_where_their_inequalities_say():
    twice = sato.Polytope(normals=0.5 * np.vstack([np.eye(2), -np.eye(2)]), offsets=[1, 1, 1, 1])
    assert twice.distances(np.array([[5.0, 0.0]])) == pytest.approx(3.0)


class Late(sato.Sphere):
    """Moves as its speed does not say."""

    def place_at(self, time):
        return np.array([2.0, time])


class Hollow(sato.Sphere):
    """Has corners that are no numbers."""

    @property
    def corners(self):
        return np.full((1, 2), np.nan)


class Flat(sato.Sphere):
    """Has a number as its nearest points."""

    def nearest(self, points):
        return 0.0


class Away(sato.Sphere):
    """Has its nearest points where it is not."""

    def nearest(self, points):
        return super().nearest(points) + np.array([0.0, 0.5])


class Behind(sato.Sphere):
    """Has the points that are farthest from others as its nearest."""

    def nearest(self, points):
        return 2 * self.place - super().nearest(points)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sato.Polytope(points=[[0, 0], [1, 0], [2, 0]]), "no volume"),
        (lambda: Behind((3, 4), 0.5), "Behind.nearest gives for .* is 1 m farther than another"),
        (lambda: sato.Polytope(points=[[0, 0], [4, 0], [0, 4], [1, 1]]), "point 3 is within"),
        (lambda: sato.Polytope(normals=[[1, 0], [0, 1]], offsets=[1, 1]), "unbounded"),
        (lambda: sato.Polytope(normals=[[1, 0], [-1, 0], [0, 1]], offsets=[1, -2, 1]), "no volume"),
        (lambda: sato.Polytope(), "needs points_m, or normals"),
        (lambda: sato.Ellipsoid((0, 0), (1, -1)), "must be greater than 0, got -1"),
        (lambda: sato.Box((0, 0), (1, 0)), "must be less than high_m"),
        (lambda: sato.Sphere((0, 0), 1.0, velocity=(1, 0, 0)), "has 3 entries"),
        (lambda: sato.Sphere((0,), 1.0), "space has 2 or 3"),
        (lambda: Late((0, 0), 1.0), "Late.place_at is not asked for: velocity_m_s"),
        (lambda: Hollow((0, 0), 1.0), "Hollow.corners: must be finite"),
        (lambda: sato.obstacles.Obstacle(), "needs place, corners, nearest and scaled"),
        (lambda: Away((3, 4), 1.0), "Away.nearest gives for .* 0.5 m outside of the corners"),
        (lambda: Flat((0, 0), 1.0).nearest(np.zeros((3, 2))), "must be an array of shape"),
    ],
)
def test_what_is_no_convex_body_is_refused(make, message):
    with pytest.raises(sato.InputError, match=message):
        make()
