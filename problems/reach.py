"""Lower bounds of the control that very many displacements take.

    minimize  max_j |u_j|   subject to  C u = b

Any λ bounds it from below by λᵀb / Σ_j |c_jᵀλ|. The multipliers of the control of least energy,
weighted by 1 / |c_jᵀλ| of the round before, come close to the best λ.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from problems.minimum_fuel import decouple_axes, reachability_matrix

MAX_ROUNDS = 15  # after which a bound is a few percent below the least control
MAX_NUMBERS = 30_000_000  # of all rounds together, above which there are fewer
CHUNK_NUMBERS = 2_000_000  # computed at a time
SMOOTHING = 0.01  # relative, of |c_jᵀλ|
MIN_CONDITION = 1e-12  # relative, below which a state counts as out of control


def bound_least_controls(
    steps: DiscreteModel, displacement: Float[Array, "many n"]
) -> Float[Array, " many"]:
    """Bound the least max|u| on any axis that produces each displacement from below [m/s²].

    Args:
        steps: Dynamics, the same for all; with too few steps to control every state, bounds are 0.
        displacement: x_f − Φ x₀ − (drift), a row for each.
    """
    C, count = reachability_matrix(steps), len(displacement)
    bound = np.zeros(count)
    for states, inputs in decouple_axes(steps):
        own = C[states][:, :, inputs].reshape(len(states), -1)
        rows, triangle = np.linalg.qr(own.T)
        size = np.abs(np.diag(triangle))
        if len(size) < len(states) or not size.min() > MIN_CONDITION * size.max():
            continue
        b = np.linalg.solve(triangle.T, displacement[:, states].T).T
        rounds = int(np.clip(MAX_NUMBERS // (count * len(rows)), 1, MAX_ROUNDS))
        for some in np.array_split(np.arange(count), count * len(rows) // CHUNK_NUMBERS + 1):
            bound[some] = np.maximum(bound[some], _bound(rows.T, b[some], rounds))
    return bound


def _bound(Q: Float[Array, "s N"], b: Float[Array, "some s"], rounds: int) -> Float[Array, " some"]:
    squares = (Q[:, None] * Q).reshape(-1, Q.shape[1]).T
    λ, bound = b, np.zeros(len(b))
    for _ in range(rounds):
        size = np.abs(λ @ Q)
        size[~(size.max(axis=1) > 0)] = 1.0  # where there is nothing to move
        bound = np.maximum(bound, (λ * b).sum(axis=1) / size.sum(axis=1))
        weight = 1 / (size + SMOOTHING * size.max(axis=1, keepdims=True))
        gram = (weight @ squares).reshape(len(b), len(Q), len(Q))
        λ = np.linalg.solve(gram, b[..., None])[..., 0]
    return bound
