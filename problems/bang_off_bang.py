"""Least ℓ₁ fuel of a double integrator in closed form, for very many displacements.

    minimize  Σ_j w_j |u_j|   subject to  Σ_j u_j = β,  Σ_j j u_j = μ,  |u_j| ≤ 1,  j = 0 … N−1

The dual has two variables: its optimal |λ₁ + λ₂ j| exceeds weights that are concave in j, such as
equal ones, at the first and the last steps alone. So the control is at its limit in a burn at the
start and one at the end, and zero between [Athans1966]. β is the sum of the two burns, and μ is a
piecewise linear function of the last one, which at whole steps is quadratic, and is inverted
here. Every answer is verified: a transfer by its residual and, for equal weights, by a dual bound,
an unreachable displacement by a direction in which it is farther than any control moves. There is
one such pair of burns for each displacement, which is the optimum for all concave weights.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from problems.limit import Bound

OnAxes = Float[Array, "*programs m"]  # of displacements, along each axis
TOLERANCE = 1e-9  # relative, of residuals and gaps
ROUNDING = 1e-13  # relative, of moments and weights
UNREACHABLE_MARGIN = 1e-13  # relative, by which a displacement is beyond all controls


class Burns(NamedTuple):
    """Burns at the start and at the end, each with its sign, in steps of full control."""

    first: Float[Array, "*programs"]
    last: Float[Array, "*programs"]
    is_reachable: Bool[Array, "*programs"]
    is_certified: Bool[Array, "*programs"]  # True where verified; else nothing is known

    @property
    def length(self) -> Float[Array, "*programs"]:
        """Steps of full control of both burns, which is the fuel."""
        return np.asarray(np.abs(self.first) + np.abs(self.last))

    def controls(self, steps: int) -> Float[Array, "*programs T"]:
        """Return the share of full control in each step, from −1 to 1."""
        k = np.arange(steps)
        first, last = self.first[..., None], self.last[..., None]
        u: Array = np.sign(first) * np.clip(np.abs(first) - k, 0.0, 1.0)
        u += np.sign(last) * np.clip(np.abs(last) - k[::-1], 0.0, 1.0)
        return u


def is_concave(weight: Float[Array, " T"]) -> bool:
    """Return True for weights of the steps for which there is this closed form."""
    return bool(np.diff(weight, 2).max(initial=0.0) <= ROUNDING)


def solve_burns(
    position: OnAxes, velocity: OnAxes, steps: DiscreteModel, max_control: Bound
) -> Burns:
    """Compute the burns of least fuel on every axis, for displacements from the free motion."""
    N, dt = len(steps), steps.dt
    β = velocity / (np.asarray(max_control) * dt)
    μ = (N - 0.5) * β - position / (np.asarray(max_control) * dt**2)
    # By symmetry β ≥ 0, and more is burned at the start than at the end.
    sign = np.where(β < 0, -1.0, 1.0)
    β, μ = sign * β, sign * μ
    is_late = 2 * μ > (N - 1) * β
    μ = np.where(is_late, (N - 1) * β - μ, μ)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        last = _find_last_burn(β, μ, N)
        is_reachable, is_certified = _verify(β, μ, last, N)
    first = β - last
    at_start, at_end = sign * np.where(is_late, last, first), sign * np.where(is_late, first, last)
    return Burns(at_start, at_end, is_reachable, is_certified)


def _moment(burn: Array) -> Array:
    """Return Σ j u_j of a burn at the start."""
    whole = np.floor(burn)
    return np.asarray(whole * burn - whole * (whole + 1) / 2)


def _find_last_burn(β: Array, μ: Array, N: int) -> Array:
    """Return the burn at the end; −∞ where there is none."""
    rounding = ROUNDING * (np.abs(μ) + N * β)
    whole, p, missing = np.floor(β), N - β, μ - _moment(β)
    part, slope = β - whole, N - 1 - whole
    # Where μ is more than by a burn at the start alone, some of it is made at the end. With i
    # whole steps there μ is more by i p; it grows by a slope that is one more after `part`.
    i = np.floor(missing / p)
    rest = missing - i * p
    shared = i + np.fmin(rest / slope, (rest + part) / (slope + 1))
    # Where it is less, both burns are longer, and opposite: by i steps each, it is less by
    # i (p − i); it falls by a slope that is one less after 1 − `part`, for as long as it falls.
    root = np.sqrt(np.maximum(p**2 + 4 * missing, 0.0))
    i = np.minimum(np.floor(-2 * missing / (p + root)), np.maximum((slope - 1) // 2, 0.0))
    rest, slope, part = -missing - i * (p - i), slope - 2 * i, 1 - part
    rest = np.where(np.abs(rest - part * slope) <= rounding, part * slope, rest)
    opposite = i + np.fmax(rest / slope, (rest - part) / (slope - 1))
    opposite = np.where((slope <= 0) | ~(opposite < np.inf), np.inf, opposite)
    # Both burns together take all steps at most, which rounding must not exceed.
    opposite = np.where(2 * opposite <= p + TOLERANCE * N, np.minimum(opposite, p / 2), opposite)
    return np.where(np.abs(missing) <= rounding, 0.0, np.where(missing > 0, shared, -opposite))


def _verify(β: Array, μ: Array, last: Array, N: int) -> tuple[Array, Array]:
    """Return True for what is reachable, and for what is verified, by a bound or a direction."""
    first, size = β - last, np.abs(last)
    length, has_opposite = first + size, last < 0
    end = size * (N - 1) - _moment(size)
    moment = _moment(first) + np.where(has_opposite, -end, end)
    is_met = np.abs(moment - μ) <= TOLERANCE * (1 + np.abs(μ))
    is_met &= (first >= 0) & (length <= N * (1 + ROUNDING))  # else the burns overlap
    # λ₁ + λ₂ j is 1 at the last step of the first burn and −1 at the first of the last one.
    a, c = (np.maximum(np.ceil(burn - TOLERANCE) - 1, 0.0) for burn in (first, size))
    gap = N - 1 - a - c
    bound = (1 + 2 * a / gap) * β - (2 * μ + a * (a + 1) + c * (c + 1)) / gap
    bound = np.where(has_opposite, bound, β)
    is_optimal = is_met & (np.abs(length - bound) <= TOLERANCE * (1 + length))
    # Σ (z − j) u_j is at most Σ |z − j|, and Σ u_j at most N.
    z = np.clip(np.floor((N + β) / 2), 0, N - 1)
    beyond = z * β - μ - (z * (z + 1) + (N - 1 - z) * (N - z)) / 2
    margin = UNREACHABLE_MARGIN * (z * β + np.abs(μ) + N * N)
    is_beyond = (beyond > margin) | (β > N * (1 + UNREACHABLE_MARGIN))
    is_optimal &= ((gap >= 1) | ~has_opposite) & ~is_beyond
    return is_optimal, is_optimal | is_beyond
