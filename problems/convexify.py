"""From nominal paths to half-spaces: the convexification of Sec. IV.A [Morgan2016, eq. 38].

The distance is kept by pieces of path and not at samples. Two agents are apart over a
piece when the hull of their relative control points is outside the circle of radius R.
That implies the same for the continuous path, and with the normals chosen as the
directions to the hulls, Propositions 4 to 6 hold for it word for word.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from dynamics.trajectory_geometry import hull_distance
from problems.avoidance import HalfSpaces

PassingSide = Literal["same", "opposite", "above", "below"]

SEPARATION_TOLERANCE = 1e-6  # part of R by which paths are planned to be further apart than asked


@dataclass(frozen=True, eq=False)
class AvoidanceHorizon:
    """The steps for which collisions are looked for, cut into pieces between the samples."""

    discrete_model: DiscreteModel  # the steps to come, at least as many as the horizon has
    fine_model: DiscreteModel  # the same time in steps a whole number of times shorter
    collision_radius: float  # R_col, with what the pieces could miss [m]

    @cached_property
    def pieces_per_step(self) -> int:
        """Pieces in a step."""
        return len(self.fine_model) // len(self.discrete_model)

    @property
    def steps(self) -> int:
        """T_H."""
        return len(self.discrete_model)

    @cached_property
    def required_separation(self) -> float:
        """The distance that paths are planned to keep [m]."""
        return self.collision_radius * (1 + SEPARATION_TOLERANCE)

    @cached_property
    def control_point_maps(self) -> tuple[Array, Array, Array]:
        """P, Q, r: control points c = P x[k] + Q u[k] + r, as (T_H, pieces, 4, d, ·)."""
        T, S, d, h = self.steps, self.pieces_per_step, self.discrete_model.axes, self.fine_model.dt
        n = 2 * d
        P, Q, r = np.zeros((T, S, 4, d, n)), np.zeros((T, S, 4, d, d)), np.zeros((T, S, 4, d))
        third = np.concatenate([np.eye(d), np.eye(d) * h / 3], axis=1)
        back = np.concatenate([np.eye(d), -np.eye(d) * h / 3], axis=1)
        pick = np.stack([np.eye(d, n), third, back, np.eye(d, n)])
        for k in range(T):
            x, u, z = np.eye(n), np.zeros((n, d)), np.zeros(n)
            for s in range(S):
                A, B, c = (
                    m[k * S + s] for m in (self.fine_model.A, self.fine_model.B, self.fine_model.z)
                )
                after = A @ x, A @ u + B, A @ z + c
                for i in range(4):
                    x_i, u_i, z_i = (x, u, z) if i < 2 else after
                    P[k, s, i], Q[k, s, i], r[k, s, i] = pick[i] @ x_i, pick[i] @ u_i, pick[i] @ z_i
                x, u, z = after
        return P, Q, r

    def control_points(
        self, x: Float[Array, "*agents instants n"], u: Float[Array, "*agents T m"]
    ) -> Float[Array, "*agents pieces 4 d"]:
        """Control points over the horizon; after its last step an agent drifts."""
        P, Q, r = self.control_point_maps
        T = min(u.shape[-2], self.steps)
        rest = self.steps - T
        still = np.zeros((*u.shape[:-2], rest, u.shape[-1]))
        after = self.discrete_model[T:].simulate(x[..., T, :], still)
        X = np.concatenate([x[..., :T, :], after[..., :-1, :]], axis=-2)
        U = np.concatenate([u[..., :T, :], still], axis=-2)
        points = (
            np.einsum("ksidn,...kn->...ksid", P, X) + np.einsum("ksidm,...km->...ksid", Q, U) + r
        )
        return np.asarray(points).reshape(*points.shape[:-4], -1, 4, self.discrete_model.axes)


def are_hulls_separated(
    relative: Float[Array, "*pairs 4 d"], radius: float
) -> Bool[Array, "*pairs"]:
    """Whether the hull of the control points stays outside the circle."""
    outside = are_balls_separated(relative, radius)
    near = ~outside
    if near.any():
        outside[near] = hull_distance(relative[near])[0] >= radius
    return outside


def are_balls_separated(
    relative: Float[Array, "*pairs 4 d"], radius: float
) -> Bool[Array, "*pairs"]:
    """Whether a ball about the control points stays outside the circle: quickly, and enough."""
    flat = np.ascontiguousarray(relative).reshape(-1, *relative.shape[-2:])
    return np.asarray(_are_balls_separated(flat, radius)).reshape(relative.shape[:-2])


@numba.njit(cache=True)
@no_type_check
def _are_balls_separated(relative, radius):
    count, _, d = relative.shape
    outside = np.empty(count, np.bool_)
    middle = np.empty(d)
    for q in range(count):
        away = 0.0
        for a in range(d):
            middle[a] = (
                relative[q, 0, a] + relative[q, 1, a] + relative[q, 2, a] + relative[q, 3, a]
            ) / 4
            away += middle[a] ** 2
        spread = 0.0
        for i in range(4):
            size = 0.0
            for a in range(d):
                size += (relative[q, i, a] - middle[a]) ** 2
            spread = max(spread, size)
        outside[q] = np.sqrt(away) - np.sqrt(spread) >= radius
    return outside


def convexify(
    horizon: AvoidanceHorizon,
    T: int,
    others: Float[Array, "others pieces 4 d"],
    normal: Float[Array, "others pieces d"],
) -> HalfSpaces:
    """n·(c − c̄) ≥ R for every control point c that an agent can still move [Morgan2016, eq. 64].

    Args:
        horizon: How far to look, and how paths are cut.
        T: Steps that the agent has left; after them it drifts.
        others: Paths to keep clear of [m].
        normal: Directions to keep to, see `normals`.
    """
    P, Q, r = horizon.control_point_maps
    d, S = r.shape[-1], r.shape[1]
    T = min(T, len(P))
    n = normal.reshape(len(others), len(P), S, d)[:, :T]
    theirs = others.reshape(len(others), len(P), S, 4, d)[:, :T]
    on_state = np.einsum("aksd,ksidn->aksin", n, P[:T])
    on_control = np.einsum("aksd,ksidm->aksim", n, Q[:T])
    least = horizon.required_separation + np.einsum("aksd,aksid->aksi", n, theirs - r[:T])
    step = np.broadcast_to(np.arange(T)[:, None, None], least.shape[1:])
    movable = (step > 0) | np.any(Q[:T] != 0, axis=(3, 4))
    rows = np.broadcast_to(movable, least.shape).ravel()
    return HalfSpaces(
        np.broadcast_to(step, least.shape).ravel()[rows],
        on_state.reshape(-1, 2 * d)[rows],
        on_control.reshape(-1, d)[rows],
        least.ravel()[rows],
    )


def choose_normals(
    relative: Float[Array, "above pieces 4 d"], separation: float, side: PassingSide = "same"
) -> Float[Array, "above pieces d"]:
    """Directions of the half-spaces, a unit vector a piece [Morgan2016, Fig. 2].

    Over a piece that is clear: from the other agent to the nominal, which then satisfies
    its own half-space. Two nominals that collide have no such directions, so theirs are
    read off a nominal that is pushed aside at the closest approach, more and more as it
    gets there, until it just passes.

    Args:
        relative: Control points of the nominal less those of the others [m].
        keep: Distance to keep [m].
        way: Where to push a colliding nominal: to the side on which it passes already, to the
            other, or, in space, over or under the plane of the miss and the motion.
    """
    distance, nearest = hull_distance(relative)
    pushed = relative
    collides = np.flatnonzero(distance.min(axis=1) < separation)
    if len(collides):
        pushed = relative.copy()
        for a in collides:
            pushed[a] += _passing_displacement(
                relative[a], distance[a], nearest[a], separation, side
            )
        distance, nearest = hull_distance(pushed)
    inside = distance <= 0
    nearest[inside] = pushed[inside].mean(axis=-2)  # only where even the push is in vain
    length = np.linalg.norm(nearest, axis=-1, keepdims=True)
    return np.asarray(nearest / np.maximum(length, 1e-300))


def _passing_displacement(
    relative: Array, distance: Array, nearest: Array, keep: float, way: PassingSide
) -> Float[Array, "pieces 4 d"]:
    p = int(np.argmin(distance))
    miss = float(distance[p])
    aside = nearest[p] / miss if miss > 1e-6 * keep else _perpendicular(relative[p])
    push = (keep - miss) * aside
    if way == "opposite":
        push = -(keep + miss) * aside
    elif way != "same":
        up = np.cross(aside, relative[p, -1] - relative[p, 0])
        size = float(np.linalg.norm(up))
        up = (
            up / size
            if size > 0
            else _perpendicular(np.tile(aside, (4, 1)) * np.arange(4)[:, None])
        )
        push = (keep**2 - miss**2) ** 0.5 * (up if way == "above" else -up)
    # Control points stand at thirds of a piece; the push grows as the reach of a control.
    time = np.arange(len(relative))[:, None] + np.arange(4) / 3
    ramp = np.minimum(1.0, time / (p + 0.5)) ** 2
    return np.asarray(1.2 * ramp[..., None] * push)


def _perpendicular(piece: Float[Array, "4 d"]) -> Float[Array, " d"]:
    """A unit vector across the motion: to its right in the plane, and as near it in space."""
    along = piece[-1] - piece[0]
    across = np.zeros_like(along)
    across[:2] = along[1], -along[0]
    if not across.any():
        across[0] = 1.0
    return np.asarray(across / np.linalg.norm(across))
