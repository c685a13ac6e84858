"""Who can see whom, and how well the swarm hangs together: weights, λ₂ and its gradient.

The weights of [Bernard2023, eq. 6–11] and their gradients, eq. 12–13, with what is misprinted
there put right: a robot's bearing as the other one has it is β_ji = −(ⁱR_j)ᵀ β_ij.
"""

from math import cos, pi, sin, sqrt
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

MULTIPLICITY_TOLERANCE = 1e-7  # eigenvalues of the Laplacian that are no farther apart count as one
DEFAULT_OPTICAL_AXIS = (1 / sqrt(2), 1 / sqrt(2), 0.0)


class Camera(NamedTuple):
    """Range and field of view of a robot's camera [Bernard2023, Table I]."""

    d_min: float = 1.0  # nearer, nothing is seen [m]
    d_near: float = 3.0  # D1: from here on, all is seen [m]
    d_far: float = 7.0  # D2: to here [m]
    d_max: float = 9.0  # farther, nothing [m]
    a_min: float = 0.4  # cosine from the optical axis below which nothing is seen
    a_max: float = 0.95  # and above which all is
    optical_axis: tuple[float, float, float] = (
        DEFAULT_OPTICAL_AXIS  # the optical axis in the body frame
    )


class InteractionGraph(NamedTuple):
    """Weights of the edges of one swarm, or of many."""

    weights: Float[Array, "*k n n"]  # A_ij, symmetric
    fov_weights: Float[Array, "*k n n"]  # f*_ij: how well i has j in its field of view
    range_weights: Float[Array, "*k n n"]  # γ_ij: how good the distance is


class AlgebraicConnectivity(NamedTuple):
    """The connectivity eigenvalue, and what it feels of every edge."""

    lambda2: Float[Array, "*k"]
    lambda3: Float[Array, "*k"]
    weight_gradient: Float[Array, "*k n n"]  # ∂λ₂/∂A_ij = (v₂ᵢ − v₂ⱼ)²


class Lambda2Gradient(NamedTuple):
    """How λ₂ changes with where the robots are, and look."""

    position: Float[Array, "*k n 3"]  # in the world frame [1/m]
    yaw: Float[Array, "*k n"]  # [1/rad]


@no_type_check
@numba.njit(cache=True)
def cosine_ramp(x, low, high):
    """From 0 at `low` to 1 at `high`, along half a cosine [Bernard2023, eq. 7]."""
    if x <= low:
        return 0.0
    return 1.0 if x >= high else (1 - cos(pi * (x - low) / (high - low))) / 2


@no_type_check
@numba.njit(cache=True)
def cosine_ramp_derivative(x, low, high):
    """The derivative of `rise`."""
    if x <= low or x >= high:
        return 0.0
    return pi / (2 * (high - low)) * sin(pi * (x - low) / (high - low))


@no_type_check
@numba.njit(cache=True)
def range_weight(d, sight):
    """γ and its derivative at a distance [Bernard2023, eq. 9]."""
    near, far = (
        cosine_ramp(d, sight.d_min, sight.d_near),
        1 - cosine_ramp(d, sight.d_far, sight.d_max),
    )
    steeper = cosine_ramp_derivative(d, sight.d_min, sight.d_near) * far
    return near * far, steeper - near * cosine_ramp_derivative(d, sight.d_far, sight.d_max)


@no_type_check
@numba.njit(cache=True)
def edge_weight(d, mine, theirs, yaw, sees_other, seen_by_other, sight, motion):
    """Weight of an edge, and its gradient, as one of its two robots computes them.

    Args:
        d: Distance of the two [m].
        mine: β_ij, bearing of the other one in this one's body frame, (3,).
        theirs: β_ji, bearing of this one in the other one's, (3,).
        yaw: ψ_ij = ψ_j − ψ_i, of the other one's frame in this one's [rad].
        sees: Whether this one has the other in sight; what it does not see has f* = 0.
        seen: Whether the other one has this one in sight.
        sight: The cameras.
        motion: Where the gradient goes, (4,): ∂A_ij/∂p_i in the body frame [1/m], ∂A_ij/∂ψ_i.

    Returns:
        A_ij, f*_ij and f*_ji [Bernard2023, eq. 6, 10–13].
    """
    o_x, o_y, o_z = sight.optical_axis
    motion[:] = 0.0
    if not (sees_other or seen_by_other) or d <= sight.d_min or d >= sight.d_max:
        return 0.0, 0.0, 0.0
    a = o_x * mine[0] + o_y * mine[1] + o_z * mine[2]
    b = o_x * theirs[0] + o_y * theirs[1] + o_z * theirs[2]
    f = cosine_ramp(a, sight.a_min, sight.a_max) if sees_other else 0.0
    g = cosine_ramp(b, sight.a_min, sight.a_max) if seen_by_other else 0.0
    gamma, steep = range_weight(d, sight)
    view = f + g - f * g
    rate_f = (
        gamma * (1 - g) * cosine_ramp_derivative(a, sight.a_min, sight.a_max) if sees_other else 0.0
    )
    rate_g = (
        gamma * (1 - f) * cosine_ramp_derivative(b, sight.a_min, sight.a_max)
        if seen_by_other
        else 0.0
    )
    # ⁱR_j P_ji o_C, with P = I − β βᵀ
    c, s = cos(yaw), sin(yaw)
    q_x, q_y, q_z = o_x - b * theirs[0], o_y - b * theirs[1], o_z - b * theirs[2]
    motion[0] = (rate_g * (c * q_x - s * q_y) - rate_f * (o_x - a * mine[0])) / d
    motion[1] = (rate_g * (s * q_x + c * q_y) - rate_f * (o_y - a * mine[1])) / d
    motion[2] = (rate_g * q_z - rate_f * (o_z - a * mine[2])) / d
    for k in range(3):
        motion[k] -= view * steep * mine[k]
    motion[3] = -rate_f * (o_y * mine[0] - o_x * mine[1])
    return gamma * view, f, g


def interaction_graph(
    position: Float[Array, "*k n 3"], yaw: Float[Array, "*k n"], sight: Camera
) -> InteractionGraph:
    """Weights of all edges [Bernard2023, eq. 6–11].

    Args:
        position: In the world frame [m].
        yaw: Of the body frames [rad].
        sight: The cameras.
    """
    *k, n, _ = position.shape
    found = np.zeros((3, *k, n, n))
    flat = found.reshape(3, -1, n, n)
    _fill_weights(position.reshape(-1, n, 3), yaw.reshape(-1, n), sight, flat)
    return InteractionGraph(*found)


@no_type_check
@numba.njit(cache=True)
def _fill_weights(position, yaw, sight, found):
    motion, mine, theirs = np.zeros(4), np.zeros(3), np.zeros(3)
    for k in range(len(position)):
        for i in range(position.shape[1]):
            for j in range(i):
                d = bearings(position[k], yaw[k], i, j, mine, theirs)
                turn = yaw[k, j] - yaw[k, i]
                weight, f, g = edge_weight(d, mine, theirs, turn, True, True, sight, motion)
                found[0, k, i, j] = found[0, k, j, i] = weight
                found[1, k, i, j], found[1, k, j, i] = f, g
                found[2, k, i, j] = found[2, k, j, i] = range_weight(d, sight)[0]


@no_type_check
@numba.njit(cache=True)
def bearings(position, yaw, i, j, mine, theirs):
    """Bearing of robot j in i's body frame, of i in j's, and their distance [m].

    Args:
        position: In the world frame, (n, 3) [m].
        yaw: Of the body frames, (n,) [rad].
        i: One robot.
        j: The other one.
        mine: Where β_ij goes, (3,).
        theirs: Where β_ji goes, (3,).
    """
    x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
    z = position[j, 2] - position[i, 2]
    d = sqrt(x * x + y * y + z * z)
    over = 1 / d if d > 0 else 0.0
    c, s = cos(yaw[i]), sin(yaw[i])
    mine[0], mine[1], mine[2] = (c * x + s * y) * over, (c * y - s * x) * over, z * over
    c, s = cos(yaw[j]), sin(yaw[j])
    theirs[0], theirs[1], theirs[2] = -(c * x + s * y) * over, (s * x - c * y) * over, -z * over
    return d


def laplacian(weight: Float[Array, "*k n n"]) -> Float[Array, "*k n n"]:
    """L = diag(Σ_j A_ij) − A."""
    n = weight.shape[-1]
    return np.asarray(weight.sum(axis=-1)[..., None] * np.eye(n) - weight)


def algebraic_connectivity(weight: Float[Array, "*k n n"]) -> AlgebraicConnectivity:
    """λ₂ of the Laplacian, and its derivatives with respect to the weights.

    Where λ₂ is not simple it has no gradient, and what an eigenvalue routine makes of one
    depends on the basis that it happens to choose. Then `felt` is the mean over the
    eigenvectors of λ₂: the derivative of the mean of those eigenvalues that coincide there,
    which is smooth and the same whichever basis was found.

    Args:
        weight: Weights of the edges, of at least two robots.
    """
    value, vector = np.linalg.eigh(laplacian(weight))
    same = np.abs(value[..., 1:] - value[..., 1:2]) <= MULTIPLICITY_TOLERANCE * np.maximum(
        1, value[..., 1:2]
    )
    apart = vector[..., :, None, 1:] - vector[..., None, :, 1:]
    felt = np.einsum("...ijm,...m->...ij", apart**2, same / same.sum(axis=-1, keepdims=True))
    third = value[..., 2] if value.shape[-1] > 2 else np.full_like(value[..., 1], np.inf)
    return AlgebraicConnectivity(value[..., 1], third, felt)


def lambda2_gradient(
    position: Float[Array, "*k n 3"], yaw: Float[Array, "*k n"], sight: Camera
) -> Lambda2Gradient:
    """The gradient of λ₂ [Bernard2023, eq. 4].

    Args:
        position: In the world frame [m].
        yaw: Of the body frames [rad].
        sight: The cameras.
    """
    *k, n, _ = position.shape
    felt = algebraic_connectivity(
        interaction_graph(position, yaw, sight).weights
    ).weight_gradient.reshape(-1, n, n)
    by_position, by_yaw = np.zeros((len(felt), n, 3)), np.zeros((len(felt), n))
    _accumulate_gradient(
        position.reshape(-1, n, 3), yaw.reshape(-1, n), sight, felt, by_position, by_yaw
    )
    return Lambda2Gradient(by_position.reshape(*k, n, 3), by_yaw.reshape(*k, n))


@no_type_check
@numba.njit(cache=True)
def _accumulate_gradient(position, yaw, sight, felt, by_position, by_yaw):
    motion, mine, theirs = np.zeros(4), np.zeros(3), np.zeros(3)
    for k in range(len(position)):
        for i in range(position.shape[1]):
            c, s = cos(yaw[k, i]), sin(yaw[k, i])
            for j in range(position.shape[1]):
                if j == i:
                    continue
                d = bearings(position[k], yaw[k], i, j, mine, theirs)
                edge_weight(d, mine, theirs, yaw[k, j] - yaw[k, i], True, True, sight, motion)
                by_position[k, i, 0] += felt[k, i, j] * (c * motion[0] - s * motion[1])
                by_position[k, i, 1] += felt[k, i, j] * (s * motion[0] + c * motion[1])
                by_position[k, i, 2] += felt[k, i, j] * motion[2]
                by_yaw[k, i] += felt[k, i, j] * motion[3]
