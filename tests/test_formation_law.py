"""The law of one vehicle: what it leaves alone, how it turns, and the potential it descends."""

import runpy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.formation.control_law import ControlLaw, compute_velocity_command
from sato.formation.shape_error import compute_shape_error
from sato.shapes.formation_library import load_formation
from sato.shapes.graphs import random_sparse_graph
from sato.shapes.random_points import sample_formation

ROBUSTNESS = runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "study_law_robustness.py"))
commands, settle = ROBUSTNESS["commands"], ROBUSTNESS["simulate_distorted"]

OURS, EITHER = ControlLaw(), ControlLaw(upright=False)
PRINTED = ControlLaw(upright=False, legacy=True)
LAWS = pytest.mark.parametrize("law", [OURS, EITHER, PRINTED], ids=["upright", "either", "printed"])
FEW = settings(max_examples=15)
MIRROR = np.array([1.0, 1.0, -1.0])


@cache
def some(seed, n=7, share=0.8):
    rng = np.random.default_rng(seed)
    points = sample_formation(n, (8.0, 8.0, 3.0), 1.5, rng)
    return design_gains(DesiredFormation(points, random_sparse_graph(points, share, rng)))


def about_the_vertical(yaw):
    return Rotation.from_rotvec([0, 0, yaw]).as_matrix()


def until(length, law, should):
    """∫ r f(r) dr of the printed size control from nothing on, in the plane (xy) or upwards (z)."""
    size, bend, slack = law
    error = length - should
    if abs(error) <= slack:
        return 0.0
    begin = should + np.copysign(slack, error)
    node, weight = np.polynomial.legendre.leggauss(20)
    r = begin + (length - begin) * (node + 1) / 2
    return (length - begin) / 2 * weight @ (r * size * np.arctan(bend * (r - should)))


def stretched(length, should):
    """∫ r f(r) dr of the size control f = (r − p) / max(r, p)."""
    if length < should:
        return (length**3 / 3 - should * length**2 / 2) / should
    return (length - should) ** 2 / 2 - should**2 / 6


def potential(position, gains, law):
    """What the law descends, from the definition of its size control edge by edge."""
    shape, graph = gains.formation.points, gains.formation.graph
    flat, height = position[:, 0] + 1j * position[:, 1], position[:, 2]
    V = -(flat.conj() @ gains.xy @ flat).real / 2 - height @ gains.z @ height / 2
    degree = graph.sum(axis=1)
    for i, j in np.argwhere(np.triu(graph)):
        near, far = (np.linalg.norm(x[j, :2] - x[i, :2]) for x in (position, shape))
        up, should = (x[j, 2] - x[i, 2] for x in (position, shape))
        if law.legacy:
            V += until(near, (law.legacy_gain_xy, law.legacy_slope_xy, law.legacy_deadband_xy), far)
            V += until(
                abs(up), (law.legacy_gain_z, law.legacy_slope_z, law.legacy_deadband_z), abs(should)
            )
            continue
        weight = law.size_rate / max(degree[i], degree[j])
        V += weight * stretched(near, far)
        V += weight * ((up - should) ** 2 / 2 if law.upright else stretched(abs(up), abs(should)))
    return law.gain * V


@LAWS
@FEW
@given(
    seed=st.integers(0, 5),
    yaw=st.floats(-np.pi, np.pi),
    shift=st.tuples(*[st.floats(-100, 100)] * 3),
)
def test_who_is_in_the_shape_anywhere_and_at_any_heading_rests(law, seed, yaw, shift):
    gains = some(seed)
    placed = gains.formation.points @ about_the_vertical(yaw).T + shift
    assert np.abs(commands(placed, gains, law)).max() <= 1e-11


@LAWS
@FEW
@given(seed=st.integers(0, 5), wide=st.floats(0.1, 5), high=st.floats(-5, 5))
def test_without_size_control_the_shape_rests_at_any_size(law, seed, wide, high):
    gains = some(seed)
    free = law._replace(size_rate=0.0, legacy_gain_xy=0.0, legacy_gain_z=0.0)
    placed = gains.formation.points * [wide, wide, high]
    assert np.abs(commands(placed, gains, free)).max() <= 1e-12


@pytest.mark.parametrize(("law", "rests"), [(OURS, False), (EITHER, True), (PRINTED, True)])
def test_the_mirror_image_rests_only_where_either_will_do(law, rests):
    gains = some(1)
    speed = np.abs(commands(gains.formation.points * MIRROR, gains, law)).max()
    assert speed <= 1e-12 if rests else speed > 0.1


@LAWS
@FEW
@given(seed=st.integers(0, 5), start=st.integers(0, 2**32 - 1), yaw=st.floats(-np.pi, np.pi))
def test_who_sees_all_turned_wants_all_turned(law, seed, start, yaw):
    gains = some(seed)
    position = np.random.default_rng(start).uniform(0, 10, (7, 3))
    turn = about_the_vertical(yaw)
    turned = commands(position @ turn.T, gains, law)
    assert np.abs(turned - commands(position, gains, law) @ turn.T).max() <= 1e-12


@LAWS
@FEW
@given(seed=st.integers(0, 5), start=st.integers(0, 2**32 - 1))
def test_commands_are_the_steepest_way_down_the_potential(law, seed, start):
    gains, rng, h = some(seed), np.random.default_rng(start), 1e-5
    position = rng.uniform(0, 10, (7, 3))
    asked = commands(position, gains, law)
    for way in rng.standard_normal((4, 7, 3)):
        above, below = (potential(position + x * way, gains, law) for x in (h, -h))
        assert (above - below) / (2 * h) == pytest.approx(-np.sum(asked * way), abs=1e-5)


@LAWS
def test_the_potential_falls_also_where_commands_are_scaled_and_turned(law, rng):
    gains, position = some(3), rng.uniform(0, 10, (7, 3))
    before = potential(position, gains, law)
    for _ in range(100):
        way = ROBUSTNESS["draw_distortions"](7, 0.99 * np.pi / 2, rng)
        asked = commands(position, gains, law)
        # Short enough that what is of second order is less than the fall.
        position = position + 1e-5 * (way @ asked[..., None])[..., 0]
        after = potential(position, gains, law)
        assert after < before
        before = after


def test_only_neighbours_are_looked_at():
    gains = some(2)
    graph, points = gains.formation.graph, gains.formation.points
    sees = np.random.default_rng(2).uniform(-5, 5, (7, 3))
    weight, asked, again = np.ones(7), np.zeros(3), np.zeros(3)
    i = int(np.argmin(graph.sum(axis=1)))
    rank = np.flatnonzero(graph[i])
    compute_velocity_command(i, sees, rank, gains.xy[i], gains.z[i], points, weight, OURS, asked)
    sees[~graph[i]] = np.nan
    compute_velocity_command(i, sees, rank, gains.xy[i], gains.z[i], points, weight, OURS, again)
    assert np.array_equal(asked, again) and np.isfinite(asked).all()


@pytest.mark.parametrize("seed", range(4))
def test_scaled_and_turned_by_less_than_90_degrees_the_formation_still_forms(seed):
    rng = np.random.default_rng(seed)
    found = settle(*ROBUSTNESS["draw_case"](rng), rng)
    assert found.error <= ROBUSTNESS["SHAPE_TOLERANCE"] and not found.is_inverted


def test_turned_by_more_than_90_degrees_all_fly_apart():
    rng = np.random.default_rng(0)
    gains, start = ROBUSTNESS["draw_case"](rng)
    turn = about_the_vertical(np.deg2rad(100))
    position, before = start, compute_shape_error(start, gains.formation.points).error
    for _ in range(1000):
        position = position + 0.01 * commands(position, gains, OURS) @ turn.T
    assert compute_shape_error(position, gains.formation.points).error > before


@pytest.mark.parametrize("law", [OURS, EITHER], ids=["upright", "either"])
@pytest.mark.parametrize("name", ["Pentagonal Pyramid", "Triangular Prism", "Slanted Plane"])
def test_from_the_mirror_image_only_the_upright_law_comes_back(law, name):
    gains = design_gains(load_formation(name))
    points = gains.formation.points
    noise = np.random.default_rng(4).normal(0, 0.05, points.shape)
    found = settle(gains, points * MIRROR + noise, np.random.default_rng(5), law)
    assert found.error <= ROBUSTNESS["SHAPE_TOLERANCE"]
    assert found.is_inverted == (not law.upright)


def test_a_swarm_is_inverted_where_the_mirror_image_fits_better(rng):
    points = load_formation("Pentagonal Pyramid").points
    placed = points @ about_the_vertical(1.0).T + [3.0, 4.0, 5.0]
    noise = rng.normal(0, 0.05, points.shape)
    there = compute_shape_error(placed, points)
    assert there.error == pytest.approx(0, abs=1e-12) and not there.inverted
    assert not compute_shape_error(placed + noise, points).inverted
    assert compute_shape_error(placed * MIRROR + noise, points).inverted
    assert compute_shape_error(placed * MIRROR, points).error == pytest.approx(0, abs=1e-12)


def test_what_is_all_but_flat_is_not_inverted(rng):
    # Which of the two fits better is up to the noise, or to rounding where it is flat.
    for k in range(200):
        points = rng.uniform(0, 10, (9, 3)) * [1, 1, 0] + [0, 0, 1.3]
        points[0, 2] += 0.05 * (k % 2)
        assert not compute_shape_error(points + rng.normal(0, 0.04, points.shape), points).inverted


def test_the_error_of_a_shape_is_what_the_best_of_many_poses_leaves(rng):
    points = load_formation("Triangular Prism").points
    seen = points + rng.normal(0, 0.3, points.shape)
    mean = seen.mean(axis=0) - points.mean(axis=0)
    about = points - points.mean(axis=0)
    turns = (about @ about_the_vertical(yaw).T for yaw in np.linspace(-np.pi, np.pi, 20001))
    away = (seen - points.mean(axis=0) - mean - turned for turned in turns)
    least = min(np.sqrt((d**2).sum(axis=1).mean()) for d in away)
    assert compute_shape_error(seen, points).error == pytest.approx(least, abs=1e-6)
