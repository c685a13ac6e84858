"""Estimate of λ₂ by decentralized power iteration, for comparison.

[Yang2010] iterates towards the eigenvector and needs two averages over the swarm, which
proportional-integral consensus tracks [Freeman2006]. It is too slow where λ₃ is close to λ₂.
"""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.interaction_graph import laplacian
from sato.connectivity.settings import PowerIterationGains
from sato.connectivity.state import PowerIterates


def spectral_radius(gains: PowerIterationGains, agents: int) -> float:
    """Compute the largest spectral radius over all graphs of so many agents; stable below 1.

    *Consensus*: on a graph with Laplacian eigenvalue μ the errors of z and w follow
    z⁺ = z − h (g + K_P μ) z + h K_I μ w,  w⁺ = w − h K_I μ z. The eigenvalues of graphs with
    weights up to 1 lie between 0 and N. At μ = 0, w is constant, which is no error, for it acts
    through μ alone. *Iteration*: the mean of v̂ and its average z₁, with gain e₁; the largest
    eigenvalue, N e₂; and the size of v̂ and its average z₂ about their equilibrium, with gain
    e₃, where they are damped least, z₂ = 1.
    """
    h, g = gains.exchange_period, gains.filter_gain
    loops = [
        np.array([[1 - h * g]]),
        np.array([[1, -h * gains.deflation_gain], [h * g, 1 - h * g]]),
        np.array([[1 - h * gains.iteration_gain * agents]]),
        np.array([[1, -h * gains.normalization_gain], [2 * h * g, 1 - h * g]]),
    ]
    for mu in np.linspace(0, agents, 60 * agents + 1)[1:]:
        proportional, integral = h * gains.proportional_gain * mu, h * gains.integral_gain * mu
        loops.append(np.array([[1 - h * g - proportional, integral], [-integral, 1]]))
    return max(float(np.abs(np.linalg.eigvals(loop)).max()) for loop in loops)


def iterate_power(
    iterates: PowerIterates,
    weight: Float[Array, "n n"],  # A_ij as estimated by agent i
    hears: Bool[Array, "n n"],  # True where agent i hears agent j
    gains: PowerIterationGains,  # complete
    exchanges: int,
) -> PowerIterates:
    """Exchange iterates with all neighbors, synchronously.

    Args:
        iterates: Iterates of each agent.
        weight: A_ij as estimated by agent i.
        hears: True where agent i hears agent j.
        gains: Complete gains.
        exchanges: Number of exchanges.
    """
    v, mean, held = iterates
    h, L, neighbors = gains.exchange_period, laplacian(weight * hears), laplacian(1.0 * hears)
    for _ in range(exchanges):
        away = neighbors @ mean
        aim = np.stack([v, v**2], axis=1)
        v = v - h * (
            gains.deflation_gain * mean[:, 0]
            + gains.iteration_gain * (L @ v)
            + gains.normalization_gain * (mean[:, 1] - 1) * v
        )
        mean = mean + h * (
            gains.filter_gain * (aim - mean)
            - gains.proportional_gain * away
            + gains.integral_gain * (neighbors @ held)
        )
        held = held - h * gains.integral_gain * away
    return PowerIterates(v, mean, held)


def lambda2_from_power(iterates: PowerIterates, gains: PowerIterationGains) -> Float[Array, " n"]:
    """Estimate λ₂ from the mean size of the iterates."""
    share = gains.normalization_gain / gains.iteration_gain
    return np.asarray(share * (1 - iterates.average[:, 1]))
