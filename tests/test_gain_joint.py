"""Gains that share one trace: problem (5) of the paper as printed, in the 3n × 3n matrix A."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from gain_examples import pyramid, random_formation
from numpy.testing import assert_allclose
from scipy.linalg import null_space, orth

from problems.gain_design import GainMatrix, NoStabilizingGain, design_gains
from sato.formation.gains import list_gains

BLOCKS = np.zeros((3, 3, 3))  # [a −b 0; b a 0; 0 0 c] for a, b and c of 1 [Lusk2020, eq. 1]
BLOCKS[0, [0, 1], [0, 1]] = BLOCKS[1, 1, 0] = BLOCKS[2, 2, 2] = 1
BLOCKS[1, 0, 1] = -1


def printed_kernel(points):
    """Return N of [Lusk2020, eq. 4], of rank 5 where all heights are 0."""
    N = np.zeros((len(points), 3, 6))
    x, y, z = points.T
    N[:, 0, 0], N[:, 1, 0], N[:, 0, 1], N[:, 1, 1], N[:, 2, 2] = x, y, -y, x, z
    N[:, :, 3:] = np.eye(3)
    return N.reshape(-1, 6)


def solve_printed_problem(formation):
    """Solve (5) by a general solver, for a mean of −1 of the eigenvalues of Qᵀ A Q."""
    n, K = len(formation.points), orth(printed_kernel(formation.points))
    edges = np.argwhere(np.triu(formation.graph))
    A = np.zeros((len(edges), 3, n, 3, n, 3))  # with a, b or c of one edge, as in (3)
    for k, (i, j) in enumerate(edges):
        A[k, :, i, :, j], A[k, :, j, :, i] = BLOCKS, BLOCKS.transpose(0, 2, 1)
        A[k, :, i, :, i], A[k, :, j, :, j] = -BLOCKS, -BLOCKS.transpose(0, 2, 1)
    A = A.reshape(3 * len(edges), 3 * n, 3 * n)
    zero = np.concatenate([A @ K, A - A.transpose(0, 2, 1)], axis=2)  # A N = 0, A = Aᵀ
    allowed = null_space(zero.reshape(len(A), -1).T, rcond=1e-10)
    Q = null_space(K.T)
    B = -np.einsum("ap,kab,bq,kf->pqf", Q, A, Q, allowed, optimize=True)
    m, t, free = Q.shape[1], cp.Variable(), cp.Variable(allowed.shape[1])
    Z = cp.reshape(B.reshape(m * m, -1) @ free, (m, m), order="C")
    constraints = [(Z + Z.T) / 2 - t * np.eye(m) >> 0, np.trace(B) @ free == m]
    program = cp.Problem(cp.Maximize(t), constraints)
    return program.solve(solver=cp.SCS, eps=1e-6, max_iters=100_000)


def test_joint_gains_reach_the_optimum_of_the_printed_problem(rng):
    found = draw = 0
    while found < 30:
        draw += 1
        formation = random_formation(rng, int(rng.integers(4, 9)), rng.uniform(0.45, 0.9))
        if draw % 3 == 0:
            formation = replace(formation, points=formation.points * [1, 1, 0])
        best = solve_printed_problem(formation)
        try:
            gains = design_gains(formation, joint=True)
        except NoStabilizingGain:
            assert best <= 1e-5
            continue
        found += 1
        assert gains.convergence_rate == pytest.approx(best, rel=1e-3, abs=1e-5)
        assert gains.rate_xy == pytest.approx(gains.rate_z, rel=1e-9)
        assert gains.convergence_rate - 1e-5 <= best <= gains.joint_bound + 1e-5
        assert gains.joint_gap <= 5e-4


def test_joint_scaling_makes_the_pyramid_faster_by_18_percent():
    equal, joint = design_gains(pyramid()), design_gains(pyramid(), joint=True)
    assert equal.convergence_rate == pytest.approx(0.2957, abs=1e-4)
    assert joint.convergence_rate == pytest.approx(0.3499, abs=1e-4)
    assert equal.joint_bound == pytest.approx(joint.joint_bound, rel=1e-12)
    assert equal.joint_gap > 0.15 and joint.joint_gap <= 5e-4


def test_no_other_share_of_the_trace_is_faster(rng):
    joint = design_gains(random_formation(rng, 7, 0.7), joint=True)
    both = -2 * joint.xy.trace().real, -joint.z.trace()
    for share in rng.uniform(0.05, 0.95, 20):
        xy, z = share * sum(both) / both[0], (1 - share) * sum(both) / both[1]
        other = GainMatrix(
            joint.formation, xy * joint.xy, z * joint.z, "", xy * joint.bound_xy, z * joint.bound_z
        )
        assert other.convergence_rate < joint.convergence_rate
        assert other.joint_bound == pytest.approx(joint.joint_bound, rel=1e-9)
        assert_allclose(other.scaled_jointly().xy, joint.xy, rtol=1e-9)


def test_a_bound_of_no_direction_proves_nothing():
    gains = design_gains(pyramid(), joint=True)
    assert replace(gains, bound_xy=np.inf, bound_z=np.inf).joint_bound == np.inf
    assert gains.joint_bound < replace(gains, bound_z=np.inf).joint_bound < np.inf


def test_joint_gains_are_restored_from_files_and_lists(tmp_path):
    gains = design_gains(pyramid(), joint=True)
    gains.save(tmp_path / "gains.npz")
    listed = list_gains(gains).build(gains.formation)
    for again in (GainMatrix.load(tmp_path / "gains.npz"), listed):
        assert again.joint_bound == pytest.approx(gains.joint_bound, rel=1e-12)
        assert again.method == "admm, scaled jointly"
