"""Gradients where λ₂ = λ₃: as printed, and as the mean over the eigenvectors.

Robots stand evenly on circles, all turned alike, where symmetry makes λ₂ double. The printed
gradient takes an eigenvector, and any is as good as another.
"""

from math import pi
from typing import NamedTuple

import numpy as np
import typer
from bernard2023_equations import AXIS, SIGHT, N, matvec, rotation
from jaxtyping import Float
from numpy import ndarray as Array

from problems.interaction_graph import (
    algebraic_connectivity,
    interaction_graph,
    laplacian,
)

BASES_PER_RING = 20  # tried for each ring
STEP_LENGTH = 1e-6  # along a gradient


class RingStatistics(NamedTuple):
    """Statistics of the rings. Rates are shares of the expected increase of λ₂."""

    rings: int  # where λ₂ is double
    spread: float  # printed less mean over the mean: the largest over bases, median over rings
    printed: list[float]  # rate along it
    mean: list[float]
    basis_dependence: float  # ∂λ₂/∂A of the mean, at most, by the basis


def draw_ring(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw the positions and yaws of a ring."""
    at = 2 * pi / N * np.arange(N)
    spot = np.stack([np.cos(at), np.sin(at), np.zeros(N)], axis=-1)
    inwards = at + pi - np.arctan2(AXIS[1], AXIS[0])
    return rng.uniform(5, 7) * spot, inwards + rng.choice([-1, 1]) * rng.uniform(0.1, 0.7)


def ascend_gradient(
    position: Array, yaw: Array, lambda2_gradient: Array
) -> tuple[Float[Array, "n 4"], float]:
    """Return the gradient by [Bernard2023, eq. 5] in the world frame, and the rate along it."""
    edges = interaction_graph(position, yaw, SIGHT)
    way = (lambda2_gradient[..., None] * edges.gradients).sum(axis=1)
    way[:, :3] = matvec(rotation(yaw), way[:, :3])
    size = float(np.linalg.norm(way))
    step = STEP_LENGTH / size * way
    here = algebraic_connectivity(edges.weights).lambda2
    there = algebraic_connectivity(
        interaction_graph(position + step[:, :3], yaw + step[:, 3], SIGHT).weights
    ).lambda2
    return way, float(there - here) / (STEP_LENGTH * size)


def measure_rings(count: int, rng: np.random.Generator) -> RingStatistics:
    """Measure the rates on random rings."""
    spread, printed, ours, altered = [], [], [], 0.0
    for _ in range(count):
        position, yaw = draw_ring(rng)
        weight = interaction_graph(position, yaw, SIGHT).weights
        known = algebraic_connectivity(weight)
        if known.lambda3 - known.lambda2 > 1e-9:
            continue
        mean, rate = ascend_gradient(position, yaw, known.weight_gradient)
        ours.append(rate)
        basis, off = np.linalg.eigh(laplacian(weight))[1][:, 1:3], []
        for angle in rng.uniform(-pi, pi, BASES_PER_RING):
            c, s = np.cos(angle), np.sin(angle)
            v = basis @ np.array([[c, -s], [s, c]])
            apart = (v[:, None] - v[None]) ** 2
            way, rate = ascend_gradient(position, yaw, apart[..., 0])
            printed.append(rate)
            off.append(np.linalg.norm(way - mean) / np.linalg.norm(mean))
            altered = max(altered, float(np.abs(apart.mean(axis=-1) - known.weight_gradient).max()))
        spread.append(max(off))
    return RingStatistics(len(ours), float(np.median(spread)), printed, ours, altered)


def main(rings: int = 200, seed: int = 2023) -> None:
    """Print the shares of the rate expected, least and largest."""
    seen = measure_rings(rings, np.random.default_rng(seed))
    for name, rates in (("printed", seen.printed), ("mean", seen.mean)):
        print(f"{name}: {min(rates):.3f} to {max(rates):.3f}")


if __name__ == "__main__":
    typer.run(main)
