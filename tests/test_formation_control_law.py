"""Control law: equilibria, invariance to rotations, and the potential that it descends."""

import runpy
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from problems.alignment import compute_shape_error
from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.formation import control_law
from sato.formation.settings import ControlLaw
from sato.shapes.formation_library import load_formation, random_sparse_graph
from sato.shapes.random_points import sample_formation

STUDY = runpy.run_path(str(Path(__file__).parents[1] / "campaigns" / "distorted_law.py"))
simulate_distorted, SHAPE_TOLERANCE = STUDY["simulate_distorted"], STUDY["SHAPE_TOLERANCE"]


class Law(NamedTuple):
    """Numbers of the law, and whether it is that of the paper's code."""

    numbers: ControlLaw
    legacy: bool = False


OURS, EITHER = Law(ControlLaw()), Law(ControlLaw(upright=False))
LEGACY = Law(ControlLaw(upright=False), legacy=True)
LAWS = pytest.mark.parametrize("law", [OURS, EITHER, LEGACY], ids=["upright", "either", "legacy"])
FEW = settings(max_examples=15)
MIRROR = np.array([1.0, 1.0, -1.0])


def commands(position, gains, law):
    return STUDY["commands"](position, gains, *law)


@cache
def random_gains(seed, n=7, share=0.8):
    rng = np.random.default_rng(seed)
    points = sample_formation(n, (8.0, 8.0, 3.0), 1.5, rng)
    return design_gains(DesiredFormation(points, random_sparse_graph(points, share, rng)))


def yaw_rotation(yaw):
    return Rotation.from_rotvec([0, 0, yaw]).as_matrix()


def legacy_integral(length, desired, axes):
    """∫ r f(r) dr of the legacy size control from 0 to a length, in the plane (XY) or Z."""
    gain, slope, deadband = (
        getattr(control_law, f"LEGACY_{name}_{axes}") for name in ("GAIN", "SLOPE", "DEADBAND")
    )
    error = length - desired
    if abs(error) <= deadband:
        return 0.0
    begin = desired + np.copysign(deadband, error)
    node, weight = np.polynomial.legendre.leggauss(20)
    r = begin + (length - begin) * (node + 1) / 2
    return (length - begin) / 2 * weight @ (r * gain * np.arctan(slope * (r - desired)))


def size_integral(length, desired):
    """∫ r f(r) dr of the size control f = (r − p) / max(r, p)."""
    if length < desired:
        return (length**3 / 3 - desired * length**2 / 2) / desired
    return (length - desired) ** 2 / 2 - desired**2 / 6


def potential(position, gains, law):
    """Potential of the law, from the definition of its size control edge by edge."""
    points, graph = gains.formation.points, gains.formation.graph
    flat, height = position[:, 0] + 1j * position[:, 1], position[:, 2]
    V = -(flat.conj() @ gains.xy @ flat).real / 2 - height @ gains.z @ height / 2
    degree, numbers = graph.sum(axis=1), law.numbers
    for i, j in np.argwhere(np.triu(graph)):
        near, far = (np.linalg.norm(x[j, :2] - x[i, :2]) for x in (position, points))
        up, desired = (x[j, 2] - x[i, 2] for x in (position, points))
        if law.legacy:
            V += legacy_integral(near, far, "XY") + legacy_integral(abs(up), abs(desired), "Z")
            continue
        weight = numbers.size_rate / max(degree[i], degree[j])
        V += weight * size_integral(near, far)
        upright = (up - desired) ** 2 / 2
        V += weight * (upright if numbers.upright else size_integral(abs(up), abs(desired)))
    return numbers.gain * V


@LAWS
@FEW
@given(
    seed=st.integers(0, 5),
    yaw=st.floats(-np.pi, np.pi),
    shift=st.tuples(*[st.floats(-100, 100)] * 3),
)
def test_formation_at_any_position_and_heading_rests(law, seed, yaw, shift):
    gains = random_gains(seed)
    placed = gains.formation.points @ yaw_rotation(yaw).T + shift
    assert np.abs(commands(placed, gains, law)).max() <= 1e-11


@pytest.mark.parametrize(("law", "rests"), [(OURS, False), (EITHER, True), (LEGACY, True)])
def test_mirror_image_rests_unless_the_law_is_upright(law, rests):
    gains = random_gains(1)
    speed = np.abs(commands(gains.formation.points * MIRROR, gains, law)).max()
    assert speed <= 1e-12 if rests else speed > 0.1


@LAWS
@FEW
@given(seed=st.integers(0, 5), start=st.integers(0, 2**32 - 1))
def test_commands_are_minus_the_gradient_of_the_potential(law, seed, start):
    gains, rng, h = random_gains(seed), np.random.default_rng(start), 1e-5
    position = rng.uniform(0, 10, (7, 3))
    command = commands(position, gains, law)
    for direction in rng.standard_normal((4, 7, 3)):
        above, below = (potential(position + x * direction, gains, law) for x in (h, -h))
        assert (above - below) / (2 * h) == pytest.approx(-np.sum(command * direction), abs=1e-5)


@LAWS
def test_potential_decreases_with_scaled_and_turned_commands(law, rng):
    gains, position = random_gains(3), rng.uniform(0, 10, (7, 3))
    before = potential(position, gains, law)
    for _ in range(100):
        way = STUDY["draw_distortions"](7, 0.99 * np.pi / 2, rng)
        command = commands(position, gains, law)
        # Short enough that what is of second order is less than the fall.
        position = position + 1e-5 * (way @ command[..., None])[..., 0]
        after = potential(position, gains, law)
        assert after < before
        before = after


@pytest.mark.parametrize("seed", range(4))
def test_commands_turned_by_less_than_90_degrees_still_converge(seed):
    rng = np.random.default_rng(seed)
    found = simulate_distorted(*STUDY["draw_case"](rng), rng)
    assert found.error <= SHAPE_TOLERANCE and not found.is_inverted


@pytest.mark.parametrize("law", [OURS, EITHER], ids=["upright", "either"])
@pytest.mark.parametrize("name", ["Pentagonal Pyramid", "Triangular Prism", "Slanted Plane"])
def test_only_the_upright_law_leaves_the_mirror_image(law, name):
    gains = design_gains(load_formation(name))
    points = gains.formation.points
    noise = np.random.default_rng(4).normal(0, 0.05, points.shape)
    rng = np.random.default_rng(5)
    found = simulate_distorted(gains, points * MIRROR + noise, rng, law.numbers)
    assert found.error <= SHAPE_TOLERANCE
    assert found.is_inverted == (not law.numbers.upright)


def test_swarm_is_inverted_where_the_mirror_image_fits_better(rng):
    points = load_formation("Pentagonal Pyramid").points
    placed = points @ yaw_rotation(1.0).T + [3.0, 4.0, 5.0]
    noise = rng.normal(0, 0.05, points.shape)
    there = compute_shape_error(placed, points)
    assert there.error == pytest.approx(0, abs=1e-12) and not there.inverted
    assert not compute_shape_error(placed + noise, points).inverted
    assert compute_shape_error(placed * MIRROR + noise, points).inverted
    assert compute_shape_error(placed * MIRROR, points).error == pytest.approx(0, abs=1e-12)


def test_almost_flat_formation_is_never_inverted(rng):
    # Noise, or rounding where it is flat, decides which of the two fits better.
    for k in range(200):
        points = rng.uniform(0, 10, (9, 3)) * [1, 1, 0] + [0, 0, 1.3]
        points[0, 2] += 0.05 * (k % 2)
        assert not compute_shape_error(points + rng.normal(0, 0.04, points.shape), points).inverted
