"""Bounds of the control that very many displacements take, from below and from above.

    minimize  max_k ‖u_k‖_r   subject to  Σ_k C_k u_k = b

Any λ bounds it from below by λᵀb / Σ_k ‖C_kᵀλ‖ in the dual norm. The multipliers of the control of
least energy, weighted by 1 / ‖C_kᵀλ‖ of the round before, come close to the best λ; that control
itself comes close to the optimum, and bounds it from above.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from problems.limit import Limit, Norm, vector_norm
from problems.minimum_fuel import decouple_axes, reachability_matrix

MAX_ROUNDS = 15  # after which a bound is a few percent below the least control
MAX_NUMBERS = 30_000_000  # of all rounds together, above which there are fewer
CHUNK_NUMBERS = 2_000_000  # computed at a time
SMOOTHING = 0.01  # relative, of |c_jᵀλ|
MIN_CONDITION = 1e-12  # relative, below which a state counts as out of control


def bound_least_controls(
    steps: DiscreteModel, displacement: Float[Array, "many n"], limit: Limit
) -> tuple[Float[Array, " many"], Float[Array, " many"]]:
    """Bound the least size L, ‖u / s‖_r ≤ L, of the controls of each displacement [m/s²].

    A displacement is x_f − Φ x₀ − (drift). With too few steps to control every state, bounds are 0
    and infinite. Of the limit, norm r and shares s matter, not its size.
    """
    C, count = reachability_matrix(steps) * limit.shares, len(displacement)
    lower, upper = np.zeros((2, count))
    groups = decouple_axes(steps)
    if limit.norm != "inf":  # axes share the limit
        states, inputs = (np.concatenate(part) for part in zip(*groups, strict=True))
        groups = [(states, inputs)]
    for states, inputs in groups:
        own = C[states][:, :, inputs].reshape(len(states), -1)
        rows, triangle = np.linalg.qr(own.T)
        size = np.abs(np.diag(triangle))
        if len(size) < len(states) or not size.min() > MIN_CONDITION * size.max():
            upper[:] = np.inf
            continue
        b = np.linalg.solve(triangle.T, displacement[:, states].T).T
        Q = rows.T.reshape(len(b[0]), len(steps), -1)
        if limit.norm == "inf":
            Q = Q.reshape(len(Q), -1, 1)  # each axis by itself
        rounds = int(np.clip(MAX_NUMBERS // (count * len(rows)), 1, MAX_ROUNDS))
        for some in np.array_split(np.arange(count), count * len(rows) // CHUNK_NUMBERS + 1):
            below, above = _bound(Q, b[some], rounds, limit.norm)
            lower[some] = np.maximum(lower[some], below)
            upper[some] = np.maximum(upper[some], above)
    return lower, upper


def _bound(
    Q: Float[Array, "s T m"], b: Float[Array, "some s"], rounds: int, norm: Norm
) -> tuple[Float[Array, " some"], Float[Array, " some"]]:
    dual: Norm = "inf" if norm == 1 else 2  # of a single axis all norms are the same
    s, T, _ = Q.shape
    squares = np.einsum("ikm,jkm->kij", Q, Q).reshape(T, s * s)
    λ, lower, upper = b, np.zeros(len(b)), np.full(len(b), np.inf)
    weight = np.ones((len(b), T))
    for _ in range(rounds):
        v = np.tensordot(λ, Q, 1)
        upper = np.minimum(upper, (weight * vector_norm(v, norm)).max(axis=1))
        size = vector_norm(v, dual)
        size[~(size.max(axis=1) > 0)] = 1.0  # where there is nothing to move
        lower = np.maximum(lower, (λ * b).sum(axis=1) / size.sum(axis=1))
        # By a power of 2, which changes no digit: λ would grow with each round.
        size = np.ldexp(size, -np.frexp(size.max(axis=1, keepdims=True))[1])
        weight = 1 / (size + SMOOTHING * size.max(axis=1, keepdims=True))
        gram = (weight @ squares).reshape(len(b), s, s)
        λ = np.linalg.solve(gram, b[..., None])[..., 0]
    return lower, upper
