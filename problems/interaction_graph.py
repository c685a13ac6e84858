"""Interaction graph of mutual visibility: edge weights, λ₂ and its gradient.

The weights of [Bernard2023, eq. 6–11] and their gradients, eq. 12–13, with a misprint
corrected: the bearing in the other agent's body frame is β_ji = −(ⁱR_j)ᵀ β_ij.
"""

from collections.abc import Callable
from math import pi, sqrt
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.inputs import InputError, check_symmetric
from dynamics.units import Key, Length
from dynamics.vehicle import rotate_by_yaw, vector_lengths

MULTIPLICITY_TOLERANCE = 1e-7  # eigenvalues within this distance count as one
if TYPE_CHECKING:
    Numbers = Any  # of the same kind as what is given
else:
    Numbers = Float[Array, "..."] | float
Positions = Float[Array, "*k n 3"]
Yaws = Float[Array, "*k n"]
Weights = Float[Array, "*k n n"] | Bool[Array, "*k n n"]  # of edges, or True for them
DEFAULT_OPTICAL_AXIS = (1 / sqrt(2), 1 / sqrt(2), 0.0)


@checked
class Camera(NamedTuple):
    """Range and field of view of an agent's camera [Bernard2023, Table I]."""

    d_min: Annotated[Length, Ge(0), "distance below which nothing is visible"] = 1.0
    d_near: Annotated[Length, Gt(0), "distance D1 from which on the weight is full"] = 3.0
    d_far: Annotated[Length, Gt(0), "distance D2 up to which the weight is full"] = 7.0
    d_max: Annotated[Length, Gt(0), "distance beyond which nothing is visible"] = 9.0
    a_min: Annotated[float, Ge(-1), "cosine to the axis below which nothing is visible"] = 0.4
    a_max: Annotated[float, Gt(-1), Le(1), "cosine to the axis above which the weight is full"] = (
        0.95
    )
    optical_axis: Annotated[tuple[float, ...], Key("axis"), "optical axis in the body frame"] = (
        DEFAULT_OPTICAL_AXIS
    )


class EdgeWeights(NamedTuple):
    """Weights of edges i–j, as agent i computes them."""

    weights: Float[Array, "*k"]  # A_ij
    fov_weights: Float[Array, "*k"]  # f*_ij, of j in the field of view of i
    range_weights: Float[Array, "*k"]  # γ_ij, of the distance
    gradients: Float[Array, "*k 4"]  # ∂A_ij/∂p_i in the body frame of i [1/m], ∂A_ij/∂ψ_i [1/rad]


class AlgebraicConnectivity(NamedTuple):
    """Algebraic connectivity and its derivative by the edge weights."""

    lambda2: Float[Array, "*k"]
    lambda3: Float[Array, "*k"]
    weight_gradient: Float[Array, "*k n n"]  # ∂λ₂/∂A_ij = (v₂ᵢ − v₂ⱼ)²


class Lambda2Gradient(NamedTuple):
    """Gradient of λ₂ with respect to positions and yaws."""

    position: Positions  # in the world frame [1/m]
    yaw: Yaws  # [1/rad]


@checked
def cosine_ramp(x: Numbers, low: float, high: float) -> Numbers:
    """Rise from 0 at `low` to 1 at `high` along half a cosine [Bernard2023, eq. 7]."""
    return (1 - np.cos(_ramp_phase(x, low, high))) / 2


def cosine_ramp_and_slope(x: Numbers, low: float, high: float) -> tuple[Numbers, Numbers]:
    """Compute `cosine_ramp` and its derivative."""
    phase = _ramp_phase(x, low, high)
    slope = pi / (2 * (high - low)) * np.sin(phase)
    return (1 - np.cos(phase)) / 2, np.where((low < x) & (x < high), slope, 0.0)


def _ramp_phase(x: Numbers, low: float, high: float) -> Numbers:
    if not low < high:
        raise InputError("high", f"must be above {low}, where the ramp begins, got {high}")
    return pi * (np.minimum(np.maximum(x, low), high) - low) / (high - low)


@checked
def range_weight(d: Numbers, camera: Camera) -> Numbers:
    """Compute γ at a distance [Bernard2023, eq. 9]."""
    near = cosine_ramp(d, camera.d_min, camera.d_near)
    return near * (1 - cosine_ramp(d, camera.d_far, camera.d_max))


def range_weight_and_slope(d: Numbers, camera: Camera) -> tuple[Numbers, Numbers]:
    """Compute γ and its derivative."""
    near, rise = cosine_ramp_and_slope(d, camera.d_min, camera.d_near)
    beyond, fall = cosine_ramp_and_slope(d, camera.d_far, camera.d_max)
    return near * (1 - beyond), rise * (1 - beyond) - near * fall


def edge_weights(
    d: Float[Array, "*k"],
    own: Float[Array, "*k 3"],
    other: Float[Array, "*k 3"],
    yaw: Float[Array, "*k"],
    camera: Camera,
    sees: Bool[Array, "*k"] | bool = True,
    is_seen: Bool[Array, "*k"] | bool = True,
) -> EdgeWeights:
    """Compute weights of edges i–j from quantities known to agent i [Bernard2023, eq. 6, 10–13].

    The bearings β_ij and β_ji are in the body frames of i and of j, the yaw is ψ_j − ψ_i [rad].
    Where i does not see j, f*_ij = 0, and likewise for j.
    """
    axis = np.array(camera.optical_axis)
    is_near = (camera.d_min < d) & (d < camera.d_max)
    both = np.stack([own, other])
    cosine = np.vecdot(both, axis)
    # An end out of view counts as seen at a_min, where its weight and its slope are 0.
    seen = np.where([is_near & sees, is_near & is_seen], cosine, camera.a_min)
    (f, g), (f_slope, g_slope) = cosine_ramp_and_slope(seen, camera.a_min, camera.a_max)
    gamma, range_slope = range_weight_and_slope(d, camera)
    view = f + g - f * g
    rate_f, rate_g = gamma * (1 - g) * f_slope, gamma * (1 - f) * g_slope
    # P o_C of both bearings, with P = I − β βᵀ; that of the other in the frame of i
    across_own, across_other = axis - cosine[..., None] * both
    across_other = rotate_by_yaw(across_other, yaw)
    turn = rate_g[..., None] * across_other - rate_f[..., None] * across_own
    apart = np.where(is_near, d, 1.0)[..., None]
    by_position = turn / apart - (view * range_slope)[..., None] * own
    by_yaw = -rate_f * (axis[1] * own[..., 0] - axis[0] * own[..., 1])
    gradients = np.concatenate([by_position, by_yaw[..., None]], axis=-1)
    return EdgeWeights(gamma * view, f, gamma, gradients)


@checked
def interaction_graph(position: Positions, yaw: Yaws, camera: Camera) -> EdgeWeights:
    """Compute the weights of all edges of swarms in the world frame [Bernard2023, eq. 6–13]."""
    distance, bearing = bearings(position, yaw)
    turn = yaw[..., None, :] - yaw[..., None]
    return edge_weights(distance, bearing, bearing.swapaxes(-3, -2), turn, camera)


def bearings(
    position: Positions, yaw: Yaws
) -> tuple[Float[Array, "*k n n"], Float[Array, "*k n n 3"]]:
    """Compute the distance of agents i and j [m], and β_ij in the body frame of i."""
    gap = position[..., None, :, :] - position[..., None, :]
    distance = vector_lengths(gap)
    scale = 1 / np.where(distance > 0, distance, np.inf)
    return distance, rotate_by_yaw(gap, -yaw[..., None]) * scale[..., None]


@checked
def laplacian(weight: Weights) -> Float[Array, "*k n n"]:
    """Build the Laplacian L = diag(Σ_j A_ij) − A."""
    return _laplacian(weight, weight.sum(axis=-1))


@checked
def algebraic_connectivity(
    weight: Weights, members: Bool[Array, "*k n"] | None = None
) -> AlgebraicConnectivity:
    """Compute λ₂ of the Laplacian and its derivatives with respect to the weights.

    A multiple λ₂ has no gradient, and the result would depend on the basis of its
    eigenvectors. There `weight_gradient` is the mean over these eigenvectors: the derivative
    of the mean of the coinciding eigenvalues, which is smooth and independent of the basis.

    Weights are not negative, or True for edges. λ₂ of one agent is infinite.
    """
    check_symmetric("weight", weight)
    if (weight < 0).any():
        raise InputError("weight", "must not be negative; the weights are no Laplacian")
    is_member = np.ones(weight.shape[:-1], dtype=bool) if members is None else members
    value, vector = np.linalg.eigh(_pad_laplacian(weight, is_member))
    value, second, third = _select_eigenvalues(value, is_member)
    second = second[..., None]
    limit = second + MULTIPLICITY_TOLERANCE * np.maximum(1, second)
    equal = np.where(np.isfinite(second), value[..., 1:] <= limit, False)
    shares = equal / np.maximum(equal.sum(axis=-1, keepdims=True), 1)
    gradient = _weight_gradient(vector[..., 1:], shares, is_member)
    return AlgebraicConnectivity(second[..., 0], third, gradient)


@checked
def spectral_slope(
    weight: Float[Array, "*k n n"],
    slope: Callable[[Float[Array, "*k n-1"]], Float[Array, "*k n-1"]],
    members: Bool[Array, "*k n"],
) -> tuple[Float[Array, "*k"], Float[Array, "*k n n"]]:
    """Compute λ₂, and Σ_k V′(λ_k) ∂λ_k/∂A_ij over k ≥ 2 for a function V of eigenvalues.

    The sum is smooth where V is, also where eigenvalues meet, as it does not depend on the basis of
    their eigenvectors [Lewis1996].

    The slope V′ is 0 at infinity, where λ₂ of one agent is.
    """
    value, vector = np.linalg.eigh(_pad_laplacian(weight, members))
    value, second, _ = _select_eigenvalues(value, members)
    return second, _weight_gradient(vector[..., 1:], slope(value[..., 1:]), members)


def _weight_gradient(
    vector: Float[Array, "*k n m"], shares: Float[Array, "*k m"], members: Bool[Array, "*k n"]
) -> Float[Array, "*k n n"]:
    # Σ_k s_k (v_ki − v_kj)²
    product = (vector * shares[..., None, :]) @ vector.swapaxes(-1, -2)
    square = np.diagonal(product, axis1=-2, axis2=-1)
    gradient = square[..., None] + square[..., None, :] - 2 * product
    if not members.all():
        gradient = np.where(members[..., None] & members[..., None, :], gradient, 0.0)
    return np.asarray(gradient)


def connectivity_eigenvalues(
    weight: Float[Array, "*k n n"], members: Bool[Array, "*k n"]
) -> tuple[Float[Array, "*k"], Float[Array, "*k"]]:
    """Compute λ₂ and λ₃ as `algebraic_connectivity`, without the gradient."""
    return _select_eigenvalues(np.linalg.eigvalsh(_pad_laplacian(weight, members)), members)[1:]


def _pad_laplacian(weight: Weights, members: Bool[Array, "*k n"]) -> Float[Array, "*k n n"]:
    if members.all():
        return _laplacian(weight, weight.sum(axis=-1, dtype=float))
    # Eigenvalues of n agents are at most n times a weight; those of others are put beyond them.
    beyond = 2.0 * weight.shape[-1] * max(1.0, weight.max(initial=0.0))
    among = np.where(members[..., None] & members[..., None, :], weight, 0.0)
    return _laplacian(among, np.where(members, among.sum(axis=-1), beyond))


def _laplacian(weight: Weights, degree: Float[Array, "*k n"]) -> Float[Array, "*k n n"]:
    L = -np.asarray(weight, dtype=float)
    diagonal = np.einsum("...ii->...i", L)  # a view
    diagonal += degree
    return L


def _select_eigenvalues(
    value: Float[Array, "*k n"], members: Bool[Array, "*k n"]
) -> tuple[Float[Array, "*k n"], Float[Array, "*k"], Float[Array, "*k"]]:
    """Return the eigenvalues of members, infinite beyond, and λ₂ and λ₃ of them."""
    n = value.shape[-1]
    if not members.all():
        value = np.where(np.arange(n) < members.sum(axis=-1)[..., None], value, np.inf)
    absent = np.full(value.shape[:-1], np.inf)
    return value, value[..., 1] if n > 1 else absent, value[..., 2] if n > 2 else absent


@checked
def lambda2_gradient(position: Positions, yaw: Yaws, camera: Camera) -> Lambda2Gradient:
    """Compute the gradient of λ₂ [Bernard2023, eq. 4]."""
    edges = interaction_graph(position, yaw, camera)
    by_weight = algebraic_connectivity(edges.weights).weight_gradient
    gradient = (by_weight[..., None] * edges.gradients).sum(axis=-2)
    return Lambda2Gradient(rotate_by_yaw(gradient[..., :3], yaw), gradient[..., 3])
