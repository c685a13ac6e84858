"""Interaction graph of mutual visibility: edge weights, λ₂ and its gradient.

The weights of [Bernard2023, eq. 6–11] and their gradients, eq. 12–13, with a misprint
corrected: the bearing in the other agent's body frame is β_ji = −(ⁱR_j)ᵀ β_ij.
"""

from math import cos, pi, sin, sqrt
from typing import Annotated, NamedTuple, no_type_check

import numba
import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Key, Length

MULTIPLICITY_TOLERANCE = 1e-7  # eigenvalues within this distance count as one
Positions = Float[Array, "*k n 3"]
Yaws = Float[Array, "*k n"]
DEFAULT_OPTICAL_AXIS = (1 / sqrt(2), 1 / sqrt(2), 0.0)


class Camera(NamedTuple):
    """Range and field of view of an agent's camera [Bernard2023, Table I]."""

    d_min: Annotated[Length, Ge(0), "distance below which nothing is visible"] = 1.0
    d_near: Annotated[Length, Gt(0), "distance D1 from which on the weight is full"] = 3.0
    d_far: Annotated[Length, Gt(0), "distance D2 up to which the weight is full"] = 7.0
    d_max: Annotated[Length, Gt(0), "distance beyond which nothing is visible"] = 9.0
    a_min: Annotated[float, Ge(-1), "cosine to the axis below which nothing is visible"] = 0.4
    a_max: Annotated[float, Gt(-1), "cosine to the axis above which the weight is full"] = 0.95
    optical_axis: Annotated[tuple[float, ...], Key("axis"), "optical axis in the body frame"] = (
        DEFAULT_OPTICAL_AXIS
    )


class InteractionGraph(NamedTuple):
    """Edge weights of one swarm or of several."""

    weights: Float[Array, "*k n n"]  # A_ij, symmetric
    fov_weights: Float[Array, "*k n n"]  # f*_ij, of j in the field of view of i
    range_weights: Float[Array, "*k n n"]  # γ_ij, of the distance


class AlgebraicConnectivity(NamedTuple):
    """Algebraic connectivity and its derivative by the edge weights."""

    lambda2: Float[Array, "*k"]
    lambda3: Float[Array, "*k"]
    weight_gradient: Float[Array, "*k n n"]  # ∂λ₂/∂A_ij = (v₂ᵢ − v₂ⱼ)²


class Lambda2Gradient(NamedTuple):
    """Gradient of λ₂ with respect to positions and yaws."""

    position: Positions  # in the world frame [1/m]
    yaw: Yaws  # [1/rad]


@no_type_check
@numba.njit(cache=True)
def cosine_ramp(x, low, high):
    """Rise from 0 at `low` to 1 at `high` along half a cosine [Bernard2023, eq. 7].

    Returns:
        The value and its derivative.
    """
    if x <= low or x >= high:
        return (0.0 if x <= low else 1.0), 0.0
    phase = pi * (x - low) / (high - low)
    return (1 - cos(phase)) / 2, pi / (2 * (high - low)) * sin(phase)


@no_type_check
@numba.njit(cache=True)
def range_weight(d, camera):
    """Compute γ and its derivative at a distance [Bernard2023, eq. 9]."""
    near, rise = cosine_ramp(d, camera.d_min, camera.d_near)
    beyond, fall = cosine_ramp(d, camera.d_far, camera.d_max)
    return near * (1 - beyond), rise * (1 - beyond) - near * fall


@no_type_check
@numba.njit(cache=True)
def edge_weight(d, own, other, yaw, sees_other, seen_by_other, camera, gradient):
    """Compute the weight of edge i–j and its gradient, from quantities known to agent i.

    Args:
        d: Distance of the two agents [m].
        own: β_ij, bearing of j in the body frame of i, (3,).
        other: β_ji, bearing of i in the body frame of j, (3,).
        yaw: ψ_ij = ψ_j − ψ_i, yaw of j relative to i [rad].
        sees_other: True where i sees j; otherwise f*_ij = 0.
        seen_by_other: True where j sees i; otherwise f*_ji = 0.
        camera: Camera of every agent.
        gradient: Output, (4,): ∂A_ij/∂p_i in the body frame of i [1/m] and ∂A_ij/∂ψ_i [1/rad].

    Returns:
        A_ij, f*_ij and f*_ji [Bernard2023, eq. 6, 10–13].
    """
    o_x, o_y, o_z = camera.optical_axis
    gradient[:] = 0.0
    if not (sees_other or seen_by_other) or d <= camera.d_min or d >= camera.d_max:
        return 0.0, 0.0, 0.0
    a = o_x * own[0] + o_y * own[1] + o_z * own[2]
    b = o_x * other[0] + o_y * other[1] + o_z * other[2]
    f, f_slope = cosine_ramp(a, camera.a_min, camera.a_max) if sees_other else (0.0, 0.0)
    g, g_slope = cosine_ramp(b, camera.a_min, camera.a_max) if seen_by_other else (0.0, 0.0)
    gamma, range_slope = range_weight(d, camera)
    view = f + g - f * g
    rate_f, rate_g = gamma * (1 - g) * f_slope, gamma * (1 - f) * g_slope
    # ⁱR_j P_ji o_C, with P = I − β βᵀ
    c, s = cos(yaw), sin(yaw)
    q_x, q_y, q_z = o_x - b * other[0], o_y - b * other[1], o_z - b * other[2]
    gradient[0] = (rate_g * (c * q_x - s * q_y) - rate_f * (o_x - a * own[0])) / d
    gradient[1] = (rate_g * (s * q_x + c * q_y) - rate_f * (o_y - a * own[1])) / d
    gradient[2] = (rate_g * q_z - rate_f * (o_z - a * own[2])) / d
    for k in range(3):
        gradient[k] -= view * range_slope * own[k]
    gradient[3] = -rate_f * (o_y * own[0] - o_x * own[1])
    return gamma * view, f, g


def interaction_graph(position: Positions, yaw: Yaws, camera: Camera) -> InteractionGraph:
    """Compute the weights of all edges [Bernard2023, eq. 6–11].

    Args:
        position: Positions in the world frame [m].
        yaw: Yaws of the body frames [rad].
        camera: Camera of every agent.
    """
    *k, n, _ = position.shape
    weights = np.zeros((3, *k, n, n))
    flat = weights.reshape(3, -1, n, n)
    _fill_weights(position.reshape(-1, n, 3), yaw.reshape(-1, n), camera, flat)
    return InteractionGraph(*weights)


@no_type_check
@numba.njit(cache=True)
def _fill_weights(position, yaw, camera, weights):
    gradient, own, other = np.zeros(4), np.zeros(3), np.zeros(3)
    for k in range(len(position)):
        for i in range(position.shape[1]):
            for j in range(i):
                d = bearings(position[k], yaw[k], i, j, own, other)
                turn = yaw[k, j] - yaw[k, i]
                weight, f, g = edge_weight(d, own, other, turn, True, True, camera, gradient)
                weights[0, k, i, j] = weights[0, k, j, i] = weight
                weights[1, k, i, j], weights[1, k, j, i] = f, g
                weights[2, k, i, j] = weights[2, k, j, i] = range_weight(d, camera)[0]


@no_type_check
@numba.njit(cache=True)
def bearings(position, yaw, i, j, own, other):
    """Compute both bearings of agents i and j, and return their distance [m].

    Args:
        position: Positions in the world frame, (n, 3) [m].
        yaw: Yaws of the body frames, (n,) [rad].
        i: Index of one agent.
        j: Index of the other agent.
        own: Output β_ij, bearing of j in the body frame of i, (3,).
        other: Output β_ji, bearing of i in the body frame of j, (3,).
    """
    x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
    z = position[j, 2] - position[i, 2]
    d = sqrt(x * x + y * y + z * z)
    scale = 1 / d if d > 0 else 0.0
    c, s = cos(yaw[i]), sin(yaw[i])
    own[0], own[1], own[2] = (c * x + s * y) * scale, (c * y - s * x) * scale, z * scale
    c, s = cos(yaw[j]), sin(yaw[j])
    other[0], other[1], other[2] = -(c * x + s * y) * scale, (s * x - c * y) * scale, -z * scale
    return d


def laplacian(weight: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    """Build the Laplacian L = diag(Σ_j A_ij) − A."""
    n = weight.shape[-1]
    return np.asarray(weight.sum(axis=-1)[..., None] * np.eye(n) - weight)


def algebraic_connectivity(weight: Float[Array, "*k n n"]) -> AlgebraicConnectivity:
    """Compute λ₂ of the Laplacian and its derivatives with respect to the weights.

    A multiple λ₂ has no gradient, and the result would depend on the basis of its
    eigenvectors. There `weight_gradient` is the mean over these eigenvectors: the derivative
    of the mean of the coinciding eigenvalues, which is smooth and independent of the basis.

    Args:
        weight: Edge weights of at least two agents.
    """
    value, vector = np.linalg.eigh(laplacian(weight))
    second = value[..., 1:2]
    equal = np.abs(value[..., 1:] - second) <= MULTIPLICITY_TOLERANCE * np.maximum(1, second)
    diff = vector[..., :, None, 1:] - vector[..., None, :, 1:]
    shares = equal / equal.sum(axis=-1, keepdims=True)
    weight_gradient = np.einsum("...ijm,...m->...ij", diff**2, shares)
    third = value[..., 2] if value.shape[-1] > 2 else np.full_like(value[..., 1], np.inf)
    return AlgebraicConnectivity(value[..., 1], third, weight_gradient)


def lambda2_gradient(position: Positions, yaw: Yaws, camera: Camera) -> Lambda2Gradient:
    """Compute the gradient of λ₂ [Bernard2023, eq. 4].

    Args:
        position: Positions in the world frame [m].
        yaw: Yaws of the body frames [rad].
        camera: Camera of every agent.
    """
    *k, n, _ = position.shape
    weights = interaction_graph(position, yaw, camera).weights
    by_weight = algebraic_connectivity(weights).weight_gradient.reshape(-1, n, n)
    flat = position.reshape(-1, n, 3), yaw.reshape(-1, n)
    by_position, by_yaw = np.zeros((len(by_weight), n, 3)), np.zeros((len(by_weight), n))
    _accumulate_gradient(*flat, camera, by_weight, by_position, by_yaw)
    return Lambda2Gradient(by_position.reshape(*k, n, 3), by_yaw.reshape(*k, n))


@no_type_check
@numba.njit(cache=True)
def _accumulate_gradient(position, yaw, camera, by_weight, by_position, by_yaw):
    gradient, own, other = np.zeros(4), np.zeros(3), np.zeros(3)
    for k in range(len(position)):
        for i in range(position.shape[1]):
            c, s = cos(yaw[k, i]), sin(yaw[k, i])
            for j in range(position.shape[1]):
                if j == i:
                    continue
                d = bearings(position[k], yaw[k], i, j, own, other)
                turn = yaw[k, j] - yaw[k, i]
                edge_weight(d, own, other, turn, True, True, camera, gradient)
                by_position[k, i, 0] += by_weight[k, i, j] * (c * gradient[0] - s * gradient[1])
                by_position[k, i, 1] += by_weight[k, i, j] * (s * gradient[0] + c * gradient[1])
                by_position[k, i, 2] += by_weight[k, i, j] * gradient[2]
                by_yaw[k, i] += by_weight[k, i, j] * gradient[3]
