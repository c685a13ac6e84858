"""Alignment, against known motions, brute force and the general method."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from problems.alignment import Pose, align

seeds = st.integers(0, 10**6)


def turn(yaw):
    return np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])


@given(seeds)
def test_a_known_pose_is_recovered(seed):
    rng = np.random.default_rng(seed)
    k, yaw = rng.integers(2, 9), rng.uniform(-np.pi, np.pi)
    shape, r = rng.normal(size=(k, 3)), rng.normal(size=3)
    pose = align(shape, shape @ turn(yaw).T + r)
    assert np.exp(1j * pose.yaw) == pytest.approx(np.exp(1j * yaw), abs=1e-9)
    assert_allclose(pose.translation, r, atol=1e-9)


@given(seeds)
def test_the_placed_shape_does_not_depend_on_the_coordinate_frame(seed):
    rng = np.random.default_rng(seed)
    shape, seen = rng.normal(size=(2, 6, 3))
    yaw, r = rng.uniform(-np.pi, np.pi), 50 * rng.normal(size=3)
    here = align(shape, seen).transform(shape)
    there = align(shape, seen @ turn(yaw).T + r).transform(shape)
    assert_allclose(there, here @ turn(yaw).T + r, atol=1e-9)


@pytest.mark.parametrize("k", [2, 3, 10])
def test_no_other_rotation_or_translation_is_nearer(rng, k):
    shape, seen = rng.normal(size=(2, k, 3))

    def misfit(pose):
        return np.sum((seen - pose.transform(shape)) ** 2)

    pose = align(shape, seen)
    best, middle = misfit(pose), seen.mean(axis=0)
    for yaw in np.linspace(-np.pi, np.pi, 2001):
        assert misfit(Pose(yaw, middle - turn(yaw) @ shape.mean(axis=0))) >= best - 1e-12
    for step in 1e-3 * np.vstack([np.eye(3), -np.eye(3)]):
        assert misfit(Pose(pose.yaw, pose.translation + step)) > best


def test_the_rotation_is_that_of_the_singular_value_decomposition(rng):
    # [Arun1987] on the planar parts, as [Lusk2020] describes it.
    shape, seen = rng.normal(size=(2, 7, 3))
    s, w = (points[:, :2] - points[:, :2].mean(axis=0) for points in (shape, seen))
    U, _, Vt = np.linalg.svd(s.T @ w)
    R = Vt.T @ np.diag([1, np.linalg.det(Vt.T @ U.T)]) @ U.T
    assert_allclose(turn(align(shape, seen).yaw)[:2, :2], R, atol=1e-12)


def test_batches_equal_single_alignments_and_masked_points_may_be_nan(rng):
    n = 7
    shape, seen = rng.normal(size=(n, 3)), rng.normal(size=(n, n, 3))  # each in its own frame
    counts = (rng.random((n, n)) < 0.5) | np.eye(n, dtype=bool)
    seen[~counts] = np.nan
    together = align(shape, seen, counts)
    for i in range(n):
        alone = align(shape[counts[i]], seen[i, counts[i]])
        assert_allclose(together.transform(shape)[i], alone.transform(shape), atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 12.3, 1e4])
def test_points_on_one_vertical_get_the_yaw_zero(rng, offset):
    stack = np.array([[offset / 3, offset, z] for z in (0.1, 1.0, 2.5)])
    others = rng.normal(size=(3, 3)) + offset
    for shape, seen in [(stack, others), (others, stack), (stack, stack), (stack[:1], others[:1])]:
        pose = align(shape, seen)
        assert pose.yaw == 0
        assert_allclose(pose.transform(shape).mean(axis=0), seen.mean(axis=0), atol=1e-9)


def test_a_square_and_its_mirror_image_get_the_yaw_zero():
    square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    assert align(square, square * [1, -1, 1]).yaw == 0


def test_a_small_shape_far_from_the_origin_keeps_its_yaw(rng):
    shape = rng.normal(size=(5, 3))
    pose = align(shape, shape @ turn(1.0).T + [1e6, -1e6, 0])
    assert pose.yaw == pytest.approx(1.0, abs=1e-8)


def test_an_alignment_without_points_is_refused(rng):
    with pytest.raises(ValueError, match="at least one measured point"):
        align(np.zeros((0, 3)), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="at least one measured point"):
        align(*rng.normal(size=(2, 4, 3)), np.full(4, False))
