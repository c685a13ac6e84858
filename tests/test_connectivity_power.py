"""Power iteration and consensus, against matrices, eigenvalues and limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from problems.interaction_graph import algebraic_connectivity, laplacian
from sato.connectivity.power_iteration import (
    iterate_power,
    lambda2_from_power,
    spectral_radius,
)
from sato.connectivity.settings import PowerIterationGains, complete_gains
from sato.connectivity.state import PowerIterates

ALL = np.ones((6, 6)) - np.eye(6)
PATH = np.eye(6, k=1) + np.eye(6, k=-1)
TEXTBOOK = complete_gains(PowerIterationGains(0.002), 6)._replace(
    filter_gain=200.0, proportional_gain=50.0, integral_gain=200.0
)


def some(seed, agents=6):
    """Draw a connected graph with unit weights."""
    rng = np.random.default_rng(seed)
    while True:
        links = np.triu(rng.random((agents, agents)) < 0.4, 1).astype(float)
        links += links.T
        if algebraic_connectivity(links).lambda2 > 1e-9:
            return links


def averaging(power):
    """Turn off the iteration, so that the averaged values are constant."""
    return power._replace(deflation_gain=0.0, iteration_gain=0.0, normalization_gain=0.0)


def begun(agents, rng):
    return PowerIterates(rng.standard_normal(agents), *rng.standard_normal((2, agents, 2)))


def matrix(links, power):
    """One exchange of (z, w), written as a matrix."""
    h, L, one = power.exchange_period, laplacian(links), np.eye(len(links))
    return np.block(
        [
            [
                (1 - h * power.filter_gain) * one - h * power.proportional_gain * L,
                h * power.integral_gain * L,
            ],
            [-h * power.integral_gain * L, one],
        ]
    )


def slowest(links, power):
    """Spectral radius of an exchange, but for the mean of w, which rests and acts on nothing."""
    size = np.sort(np.abs(np.linalg.eigvals(matrix(links, power))))
    at = np.argmin(np.abs(size - 1))
    assert size[at] == pytest.approx(1, abs=1e-9)
    return np.delete(size, at).max()


@pytest.mark.parametrize("links", [PATH, ALL, some(0), some(1)])
def test_exchanges_agree_with_their_matrix(links, rng):
    power, iterate = averaging(complete_gains(PowerIterationGains(0.002), 6)), begun(6, rng)
    x = np.vstack([iterate.average, iterate.integral])
    drawn = power.exchange_period * power.filter_gain * np.column_stack([iterate.v, iterate.v**2])
    for _ in range(20):
        x = matrix(links, power) @ x + np.vstack([drawn, np.zeros((6, 2))])
    iterate = iterate_power(iterate, links, links > 0, power, 20)
    assert np.vstack([iterate.average, iterate.integral]) == pytest.approx(x, abs=1e-12)


@pytest.mark.parametrize("period", [0.001, 0.002, 0.005])
@pytest.mark.parametrize("links", [PATH, ALL, some(2), some(3)])
def test_suited_gains_converge_to_the_averages(links, period, rng):
    power, iterate = averaging(complete_gains(PowerIterationGains(period), 6)), begun(6, rng)
    target = np.tile([iterate.v.mean(), (iterate.v**2).mean()], (6, 1))
    at_first = np.abs(iterate.average - target).max()
    rounds = int(np.log(1e-9) / np.log(slowest(links, power)))
    iterate = iterate_power(iterate, links, links > 0, power, rounds)
    assert np.abs(iterate.average - target).max() < 1e-7 * at_first


@given(st.integers(2, 12), st.integers(0, 2**32 - 1))
def test_no_graph_exceeds_the_spectral_radius(agents, seed):
    rng, links = np.random.default_rng(seed), some(seed, agents)
    period, scale = rng.choice([0.001, 0.002, 0.005]), rng.uniform(0.2, 3, 3)
    power = complete_gains(PowerIterationGains(period), agents)
    power = power._replace(
        filter_gain=power.filter_gain * scale[0],
        proportional_gain=power.proportional_gain * scale[1],
        integral_gain=power.integral_gain * scale[2],
    )
    # Between two of the eigenvalues that it looks at, 1/60 apart, it may be a little more.
    assert slowest(links, power) <= spectral_radius(power, agents) + 0.02


def test_complete_graph_attains_the_spectral_radius(rng):
    # Its eigenvalues are 0 and N, and with these gains N is the worst.
    assert slowest(ALL, TEXTBOOK) == pytest.approx(spectral_radius(TEXTBOOK, 6), rel=1e-12)
    # [[1 − 0.4 − 0.6, 2.4], [−2.4, 1]]: λ² − λ + 2.4² = 0.
    assert spectral_radius(TEXTBOOK, 6) == pytest.approx(2.4)


def weights(seed):
    """Draw weights with λ₂ and λ₃ well apart."""
    rng = np.random.default_rng(seed)
    while True:
        weight = some(rng.integers(1 << 30)) * np.triu(rng.uniform(0.2, 1, (6, 6)), 1)
        weight += weight.T
        found = algebraic_connectivity(weight)
        if found.lambda2 > 0.1 and found.lambda3 - found.lambda2 > 0.3:
            return weight, found


@pytest.mark.parametrize("seed", range(6))
def test_iteration_on_a_fixed_graph_finds_lambda2_and_its_vector(seed):
    weight, found = weights(seed)
    power, rng = complete_gains(PowerIterationGains(), 6), np.random.default_rng(seed)
    iterate = PowerIterates(rng.standard_normal(6), np.zeros((6, 2)), np.zeros((6, 2)))
    # At the rate e₂ (λ₃ − λ₂) ≥ 0.9/s, which takes long where it first comes near to v₃.
    iterate = iterate_power(iterate, weight, weight > 0, power, round(40 / power.exchange_period))
    assert lambda2_from_power(iterate, power) == pytest.approx(np.full(6, found.lambda2), rel=0.01)
    iterate = iterate_power(iterate, weight, weight > 0, power, round(60 / power.exchange_period))
    assert lambda2_from_power(iterate, power) == pytest.approx(np.full(6, found.lambda2), rel=1e-6)
    size = 6 * (1 - power.iteration_gain / power.normalization_gain * found.lambda2)
    assert (iterate.v**2).sum() == pytest.approx(size, rel=1e-6)
    felt = (iterate.v[:, None] - iterate.v) ** 2 / (6 * iterate.average[:, 1:])
    assert felt == pytest.approx(found.weight_gradient, abs=1e-6)
