"""Closed form of the least fuel of double integrators: laws, and the simplex method beside it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems import bang_off_bang, minimum_fuel
from problems.auction_cost import compute_transfer_costs, solve_transfer
from problems.bang_off_bang import is_concave, solve_burns
from problems.limit import LIMIT_TOLERANCE
from problems.minimum_fuel import reachability_matrix, solve_minimum_fuel
from problems.transfer import TransferProblem, tie_break_weights

KINDS = "anything", "limits", "two burns", "ends"


def draw_controls(rng, kind, count, N):
    """Draw controls of 2 axes in [−1, 1], many of them at the edge of reach."""
    u = rng.uniform(-1, 1, (count, N, 2)) * rng.random((count, 1, 1))
    if kind == "limits":
        u = rng.choice([-1.0, 0.0, 1.0], (count, N, 2))
    elif kind == "two burns":
        first = rng.integers(0, N + 1, (count, 1, 2))
        last, k = rng.integers(0, N - first + 1), np.arange(N)[:, None]
        u = np.where(k < first, 1.0, 0.0) + np.where(k >= N - last, rng.choice([-1.0, 1.0]), 0.0)
    elif kind == "ends":
        u[:, 1:-1] = 0.0
    return u


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40) | st.just(300), st.sampled_from(KINDS))
def test_burns_are_the_optima_of_the_simplex_method(seed, N, kind):
    rng = np.random.default_rng(seed)
    steps = discretize_zoh(DoubleIntegrator(2), rng.uniform(0.1, 2), N)
    U, weight = rng.uniform(0.05, 3.0, 2), tie_break_weights(N, 1e-3)
    u = draw_controls(rng, kind, 40, N) * U
    b = np.einsum("nkm,qkm->qn", reachability_matrix(steps), u)
    b *= np.where(rng.random((40, 1)) < 0.3, rng.uniform(0.5, 2, (40, 1)), 1.0)
    burns = solve_burns(b[:, :2], b[:, 2:], steps, U)
    assert burns.is_certified.all()
    own, is_reachable = minimum_fuel._solve_by_simplex(steps, b, U, weight, 40)
    assert_array_equal(burns.is_reachable.all(axis=1), is_reachable)
    found = np.swapaxes(burns.controls(N), 1, 2)[is_reachable]
    assert_allclose(found, (own / U)[is_reachable], atol=1e-6)
    assert_allclose(burns.length[is_reachable], np.abs(found).sum(axis=1), atol=1e-9)


@pytest.mark.parametrize("N", [1, 2, 100, 1000])
@pytest.mark.parametrize("beyond", [1e-14, 1e-12, 1e-10, 1e-9, 1e-8])
def test_no_burn_at_the_edge_of_reach_exceeds_the_limit(N, beyond):
    steps, U, dt = discretize_zoh(DoubleIntegrator(2), 0.5, N), 0.1, 0.5
    full = np.ones(N)
    for u in (full, -full, np.where(np.arange(N) < N // 3, 1.0, -1.0)):
        moved = U * np.array([dt**2 * ((N - 0.5 - np.arange(N)) * u).sum(), dt * u.sum()])
        b = np.zeros((2, 4))
        b[:, ::2] = moved * np.array([[1 - beyond], [1 + beyond]])
        found = solve_minimum_fuel(steps, b, U, np.ones(N))
        assert np.isfinite(found.fuel[0])
        assert np.nanmax(np.abs(found.u)) <= U * (1 + LIMIT_TOLERANCE)
        transfer = TransferProblem(steps, U)
        cost = compute_transfer_costs(transfer, np.zeros((1, 4)), b)
        assert cost.is_reachable[0].tolist() == np.isfinite(found.fuel).tolist()
        if beyond >= 1e-9:
            assert np.isinf(found.fuel[1])


@pytest.mark.parametrize("N", [80, 500])
def test_agents_that_rest_at_targets_are_priced_in_closed_form(rng, N):
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, N)
    place = rng.uniform(-1000, 1000, (500, 2))
    near = place * (1 + 2.2e-16 * rng.integers(-4, 5, (500, 2)))
    burns = solve_burns(near - place, np.zeros((500, 2)), steps, 1e-4)
    assert burns.is_certified.all() and burns.length.max() < 1e-6


def test_an_uncertified_pair_changes_no_bit_of_other_costs(rng, monkeypatch):
    steps, right = discretize_zoh(DoubleIntegrator(2), 1.0, 20), bang_off_bang._verify
    start, targets = rng.normal(0, [3.0, 3.0, 0.2, 0.2], (2, 5, 4))
    transfer = TransferProblem(steps, 0.2, 0.8)
    before = compute_transfer_costs(transfer, start, targets)

    def doubt(β, μ, last, N):
        is_reachable, is_certified = right(β, μ, last, N)
        if β.ndim == 3 or len(β) == 1:  # of all pairs, and of the one that is solved by itself
            is_certified[(0,) * (β.ndim - 1)] = False
        return is_reachable, is_certified

    monkeypatch.setattr(bang_off_bang, "_verify", doubt)
    after = compute_transfer_costs(transfer, start, targets)
    for one, other in zip(before, after, strict=True):
        assert_array_equal(one.ravel()[1:], other.ravel()[1:])
    assert after.cost[0, 0] == pytest.approx(before.cost[0, 0], rel=1e-9)


@pytest.mark.parametrize("wrong", [1 - 1e-6, 1 + 1e-6])
def test_wrong_burns_are_found_out_and_solved_again(rng, monkeypatch, wrong):
    steps, right = discretize_zoh(DoubleIntegrator(2), 1.0, 20), bang_off_bang._find_last_burn
    u = np.concatenate([draw_controls(rng, kind, 20, 20) for kind in KINDS])
    b = 0.1 * np.einsum("nkm,qkm->qn", reachability_matrix(steps), u)
    b[::3] *= 1.5
    expected = solve_minimum_fuel(steps, b, 0.1, np.ones(20))
    monkeypatch.setattr(bang_off_bang, "_find_last_burn", lambda *own: wrong * right(*own))
    burns = solve_burns(b[:, :2], b[:, 2:], steps, 0.1)
    # What is beyond reach is verified without the burns.
    assert 0 < (burns.is_certified & ~burns.is_reachable).sum()
    moved = np.minimum(np.abs(burns.first), np.abs(burns.last)) > 0.01  # the shorter is found
    assert not (burns.is_certified & burns.is_reachable & moved).any()
    assert_allclose(solve_minimum_fuel(steps, b, 0.1, np.ones(20)).fuel, expected.fuel, rtol=1e-9)


def test_only_double_integrators_have_burns():
    steps = discretize_zoh(DoubleIntegrator(3), 0.7, 5)
    assert steps.is_double_integrator
    pushed = DiscreteModel(steps.A, steps.B, steps.z + 0.1, steps.dt)
    assert pushed.is_double_integrator
    assert not discretize_zoh(ClohessyWiltshire(1e-3), 60.0, 5).is_double_integrator
    for name in "AB":
        changed = {"A": steps.A.copy(), "B": steps.B.copy()}
        changed[name][3, 0, 0] *= 1 + 1e-9
        assert not DiscreteModel(**changed, z=steps.z, dt=steps.dt).is_double_integrator


def test_weights_are_concave_or_are_left_to_the_simplex_method(rng):
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 12)
    assert is_concave(np.ones(12)) and is_concave(tie_break_weights(12, 0.1))
    weight = 1 + 0.1 * np.abs(np.linspace(-1, 1, 12))
    assert not is_concave(weight)
    b = np.array([[2.4, 0.0, 0.4, 0.0]])
    u = solve_minimum_fuel(steps, b, 0.1, weight).u
    assert u[0, 4:8, 0].min() > 0.09  # cheapest in the middle
    assert_allclose(np.einsum("nkm,qkm->qn", reachability_matrix(steps), u), b, atol=1e-9)


@settings(deadline=None, max_examples=20)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([1, 2, "inf"]),
    st.sampled_from([0.0, 0.02]),
    st.sampled_from([1, 2, 3, 15]),
    st.sampled_from([2, 3]),
)
def test_prices_are_exact_where_their_burns_keep_all_limits(seed, norm, push, T, d):
    rng = np.random.default_rng(seed)
    steps = discretize_zoh(DoubleIntegrator(d), 1.0, T)
    steps = DiscreteModel(steps.A, steps.B, steps.z + push * np.eye(2 * d)[d], steps.dt)
    start = rng.normal(0, np.repeat([3.0, 0.3], d), (6, 2 * d))
    u = rng.uniform(-0.2, 0.2, (6, T, d))
    targets = steps.simulate(rng.permutation(start), u)[:, -1]
    control_norm = "inf" if rng.random() < 0.7 else 2
    U = 0.2 if rng.random() < 0.5 else rng.uniform(0.15, 0.25, d)
    transfer = TransferProblem(steps, U, 0.7, 1, control_norm, speed_norm=norm)
    costs = compute_transfer_costs(transfer, start, targets)
    for i, j in np.ndindex(6, 6):
        free = steps.simulate(start[i], np.zeros((T, d)))[-1]
        u = solve_minimum_fuel(steps, (targets[j] - free)[None], U, np.ones(T)).u
        if not costs.is_reachable[i, j]:
            assert np.isnan(u).all()
            continue
        is_kept = not transfer.control_limit.is_exceeded(u).any()
        is_kept &= not transfer.is_too_fast(steps.simulate(start[[i]], u)).any()
        assert costs.is_exact[i, j] == is_kept
        if is_kept:
            exact = solve_transfer(transfer, start[i], targets[j])
            assert costs.cost[i, j] == pytest.approx(exact.fuel, rel=1e-6, abs=1e-9)
