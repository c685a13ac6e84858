"""What proofs are worth: no bound above a cost, no proof against what can be done."""

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


def programme(rng):
    """Coefficients, controls inside the box, and the question that they are an answer to."""
    rows = np.linalg.qr(rng.normal(size=(N, M)))[0].T.copy()
    push = rng.normal(size=(K, D, N)) / 3
    for k in range(K):
        push[k, :, (k + 1) * N // (K + 1) :] = 0  # what is burnt later changes no speed
    shared = TransferProgram(rows, rng.uniform(0.5, 1.5, N), push)
    x = rng.uniform(-1, 1, N) * (rng.random(N) < 0.5)
    free = rng.normal(size=(K, D)) / 3
    free /= max(1.0, 1.02 * np.linalg.norm(free + shared.velocity_response @ x, axis=1).max())
    x /= max(1.0, 1.02 * np.linalg.norm(free + shared.velocity_response @ x, axis=1).max())
    inside = np.linalg.norm(free + shared.velocity_response @ x, axis=1).max() <= 1
    return shared, RightHandSide(rows @ x, free), x, inside


def best(shared, question):
    return solve_batches(
        shared, question.b[None], question.free_velocity[None], np.array([0, 1]), 1000
    )


@settings(max_examples=60)
@given(seeds, st.floats(-3, 3))
def test_no_bound_is_above_a_cost_that_is_paid(seed, power):
    rng = np.random.default_rng(seed)
    shared, question, x, inside = programme(rng)
    λ, p = 10**power * rng.normal(size=M), 10**power * rng.normal(size=(K, D))
    _, bound = certify_optimality(shared, question, x, λ, p)
    if inside:
        assert bound <= shared.w @ np.abs(x) + 1e-9 * 10**power
        assert not certifies_infeasibility(shared, question, λ, p)


@settings(max_examples=40)
@given(seeds)
def test_what_is_found_costs_no_more_than_what_is_known(seed):
    shared, question, x, inside = programme(np.random.default_rng(seed))
    found = best(shared, question)
    if inside:
        assert found.status[0] == OPTIMAL
        assert shared.w @ np.abs(found.x[0]) <= (shared.w @ np.abs(x)) * (1 + 1e-7) + 1e-9
    if found.status[0] == OPTIMAL:
        assert np.abs(shared.rows @ found.x[0] - question.b).max() <= 2e-9
        speed = np.linalg.norm(
            question.free_velocity + shared.velocity_response @ found.x[0], axis=1
        )
        assert speed.max() <= 1 + 2 * CERTIFICATE_TOLERANCE


@pytest.mark.parametrize("spoilt", ["answer", "box", "speed", "price", "bound"])
def test_an_answer_that_is_spoilt_is_not_proven(rng, spoilt):
    # Along a line, one step of it: x = b, and the bound of λ = w is w |b|.
    shared = TransferProgram(np.ones((1, 1)), np.ones(1), np.ones((1, 1, 1)))
    b, free, x, λ = np.array([0.5]), np.array([[0.2]]), np.array([0.5]), np.ones(1)
    p = np.zeros((1, 1))
    assert certify_optimality(shared, RightHandSide(b, free), x, λ, p) == (OPTIMAL, 0.5)
    if spoilt == "answer":
        b = b + 1e-7
    elif spoilt == "box":
        b, x = b + 0.6, x + 0.6
    elif spoilt == "speed":
        free = free + 0.3 + 1e-7
    elif spoilt == "price":
        x = -x
    else:
        λ = 0.9 * λ
    assert certify_optimality(shared, RightHandSide(b, free), x, λ, p)[0] != OPTIMAL


def test_the_kernel_is_compiled_anew_when_any_of_its_files_changes():
    folder, known, todo = Path(cutting_planes.__file__).parent, set(), {"cutting_planes"}
    while todo:
        name = todo.pop()
        known.add(name)
        tree = ast.parse((folder / f"{name}.py").read_text())
        names = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        todo |= {n.removeprefix("problems.") for n in names if n.startswith("problems.")} - known
    assert known == set(cutting_planes.KERNEL_FILES)
