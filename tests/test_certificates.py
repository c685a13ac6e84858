"""Certificates of transfers: no bound above a cost, no infeasibility of what is feasible."""

import ast
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from problems import cutting_planes
from problems.batches import solve_batches
from problems.certificates import (
    CERTIFICATE_TOLERANCE,
    OPTIMAL,
    RightHandSide,
    TransferProgram,
    certifies_infeasibility,
    certify_optimality,
)

seeds = st.integers(0, 2**32 - 1)
N, M, K, D = 15, 3, 4, 2


def random_transfer(rng):
    """Draw a program, controls within their bounds, and whether they keep the speed limit."""
    rows = np.linalg.qr(rng.normal(size=(N, M)))[0].T.copy()
    response = rng.normal(size=(K, D, N)) / 3
    for k in range(K):
        response[k, :, (k + 1) * N // (K + 1) :] = 0  # later controls do not change a speed
    shared = TransferProgram(rows, rng.uniform(0.5, 1.5, N), response)
    x = rng.uniform(-1, 1, N) * (rng.random(N) < 0.5)
    free = rng.normal(size=(K, D)) / 3

    def top_speed():
        return np.linalg.norm(free + response @ x, axis=1).max()

    free /= max(1.0, 1.02 * top_speed())
    x /= max(1.0, 1.02 * top_speed())
    return shared, RightHandSide(rows @ x, free), x, top_speed() <= 1


@settings(max_examples=60)
@given(seeds, st.floats(-3, 3))
def test_no_dual_bound_exceeds_a_feasible_cost(seed, power):
    rng = np.random.default_rng(seed)
    shared, rhs, x, is_feasible = random_transfer(rng)
    λ, p = 10**power * rng.normal(size=M), 10**power * rng.normal(size=(K, D))
    _, bound = certify_optimality(shared, rhs, x, λ, p)
    if is_feasible:
        assert bound <= shared.w @ np.abs(x) + 1e-9 * 10**power
        assert not certifies_infeasibility(shared, rhs, λ, p)


@settings(max_examples=40)
@given(seeds)
def test_optima_are_feasible_and_cost_no_more_than_feasible_points(seed):
    shared, rhs, x, is_feasible = random_transfer(np.random.default_rng(seed))
    found = solve_batches(shared, rhs.b[None], rhs.free_velocity[None], np.array([0, 1]), 1000)
    if is_feasible:
        assert found.status[0] == OPTIMAL
        assert shared.w @ np.abs(found.x[0]) <= (shared.w @ np.abs(x)) * (1 + 1e-7) + 1e-9
    if found.status[0] == OPTIMAL:
        assert np.abs(shared.rows @ found.x[0] - rhs.b).max() <= 2e-9
        speed = np.linalg.norm(rhs.free_velocity + shared.velocity_response @ found.x[0], axis=1)
        assert speed.max() <= 1 + 2 * CERTIFICATE_TOLERANCE


@pytest.mark.parametrize("wrong", ["equation", "control", "speed", "cost", "bound"])
def test_a_wrong_solution_is_not_certified(rng, wrong):
    # One dimension, one step: x = b, and the bound of λ = w is w |b|.
    shared = TransferProgram(np.ones((1, 1)), np.ones(1), np.ones((1, 1, 1)))
    b, free, x, λ = np.array([0.5]), np.array([[0.2]]), np.array([0.5]), np.ones(1)
    p = np.zeros((1, 1))
    assert certify_optimality(shared, RightHandSide(b, free), x, λ, p) == (OPTIMAL, 0.5)
    if wrong == "equation":
        b = b + 1e-7
    elif wrong == "control":
        b, x = b + 0.6, x + 0.6
    elif wrong == "speed":
        free = free + 0.3 + 1e-7
    elif wrong == "cost":
        x = -x
    else:
        λ = 0.9 * λ
    assert certify_optimality(shared, RightHandSide(b, free), x, λ, p)[0] != OPTIMAL


def test_a_change_of_any_of_its_files_recompiles_the_kernel():
    folder, known, todo = Path(cutting_planes.__file__).parent, set(), {"cutting_planes"}
    while todo:
        name = todo.pop()
        known.add(name)
        tree = ast.parse((folder / f"{name}.py").read_text())
        names = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        todo |= {n.removeprefix("problems.") for n in names if n.startswith("problems.")} - known
    assert known == set(cutting_planes.KERNEL_FILES)
