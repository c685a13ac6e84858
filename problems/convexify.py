"""Convexification of collision avoidance: half-spaces about nominal trajectories.

[Morgan2016, Sec. IV.A, eq. 38] for pieces of the trajectories instead of samples. Two agents
keep the distance over a piece where the convex hull of their relative control points lies
outside the circle of radius R. That implies the same for the continuous trajectory, and with
normals along the directions to the hulls, Propositions 4 to 6 hold unchanged.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import isclose
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from dynamics.doors import checked
from dynamics.inputs import InputError
from dynamics.model import ControlSamples, StateSamples
from dynamics.trajectory_geometry import hull_distance
from problems.half_spaces import HalfSpaces
from problems.path_separation import Separation

PassingSide = Literal["same", "opposite", "above", "below", "nominal"]

SEPARATION_TOLERANCE = 1e-6  # part of R that planned trajectories keep in addition


@checked
@dataclass(frozen=True, eq=False)
class AvoidanceHorizon:
    """Steps of collision avoidance, divided into pieces between the samples.

    Two vehicles may keep an ellipsoid instead of a ball: control points are scaled along the axes,
    so that it becomes a ball.

    Args:
        discrete_model: The next T_H steps.
        fine_model: The same time span, each step divided into equal pieces.
        clearance: R_col, the margin and the interpolation error of the pieces [m].
        scale: Factor of control points along each axis.
        samples_only: Control points are the samples alone [Morgan2016, eq. 38].
    """

    discrete_model: DiscreteModel
    fine_model: DiscreteModel
    clearance: Annotated[float, Gt(0)]
    scale: tuple[Annotated[float, Gt(0)], ...] | None = None
    samples_only: bool = False

    def __post_init__(self) -> None:
        """Check that there is a factor for each axis."""
        if self.scale is not None and len(self.scale) != self.discrete_model.axes:
            count = self.discrete_model.axes
            raise InputError("scale", f"must be a factor for each of {count} axes")
        steps, pieces = self.discrete_model, self.fine_model
        is_whole = len(steps) and len(pieces) % len(steps) == 0
        if not (is_whole and isclose(len(pieces) * pieces.dt, len(steps) * steps.dt)):
            wanted = f"must divide each of {len(steps)} steps of {steps.dt:g} s into equal pieces"
            raise InputError("fine_model", f"{wanted}, got {len(pieces)} of {pieces.dt:g} s")

    @property
    def array_sizes(self) -> dict[str, Any]:
        """Sizes of the axes of space, states and controls."""
        return {**self.discrete_model.array_sizes, "d": self.discrete_model.axes}

    def with_clearance(self, clearance: Annotated[float, Gt(0)]) -> "AvoidanceHorizon":
        """Return the horizon of a vehicle with another clearance."""
        if clearance == self.clearance:
            return self
        other = replace(self, clearance=clearance)
        other.__dict__["control_point_maps"] = self.control_point_maps  # the same for all
        return other

    @cached_property
    def pieces_per_step(self) -> int:
        """Number of pieces in a step."""
        return len(self.fine_model) // len(self.discrete_model)

    @property
    def steps(self) -> int:
        """Number of steps of the horizon, T_H."""
        return len(self.discrete_model)

    @cached_property
    def required_separation(self) -> float:
        """Distance of planned trajectories [m]."""
        return self.clearance * (1 + SEPARATION_TOLERANCE)

    @cached_property
    def control_point_maps(self) -> tuple[Array, Array, Array]:
        """P, Q, r of the control points c = P x[k] + Q u[k] + r, each (T_H, pieces, 4, d, ·)."""
        T, S, d, h = self.steps, self.pieces_per_step, self.discrete_model.axes, self.fine_model.dt
        n = 2 * d
        P, Q, r = np.zeros((T, S, 4, d, n)), np.zeros((T, S, 4, d, d)), np.zeros((T, S, 4, d))
        parts = self.fine_model.A, self.fine_model.B, self.fine_model.z[..., None]
        A, B, c = (part.reshape(T, S, *part.shape[1:]) for part in parts)
        third = np.concatenate([np.eye(d), np.eye(d) * h / 3], axis=1)
        back = np.concatenate([np.eye(d), -np.eye(d) * h / 3], axis=1)
        pick = np.stack([np.eye(d, n), third, back, np.eye(d, n)])
        begun = 2  # points of the state before a piece, the others are of the one after it
        if self.samples_only:
            pick, begun = np.stack([np.eye(d, n)] * 4), 0
        x, u, z = np.tile(np.eye(n), (T, 1, 1)), np.zeros((T, n, d)), np.zeros((T, n, 1))
        for s in range(S):
            after = A[:, s] @ x, A[:, s] @ u + B[:, s], A[:, s] @ z + c[:, s]
            for i in range(4):
                x_i, u_i, z_i = (x, u, z) if i < begun else after
                P[:, s, i], Q[:, s, i] = pick[i] @ x_i, pick[i] @ u_i
                r[:, s, i] = (pick[i] @ z_i)[..., 0]
            x, u, z = after
        if self.scale is None:
            return P, Q, r
        wide = np.array(self.scale)
        return P * wide[:, None], Q * wide[:, None], r * wide

    def scale_points(self, points: Float[Array, "*k d"]) -> Float[Array, "*k d"]:
        """Return positions as control points have them, scaled.

        Args:
            points: Positions [m].
        """
        return points if self.scale is None else points * np.array(self.scale)

    def unscale_points(self, points: Float[Array, "*k d"]) -> Float[Array, "*k d"]:
        """Return control points as positions [m].

        Args:
            points: Scaled positions.
        """
        return points if self.scale is None else points / np.array(self.scale)

    def control_points(
        self, x: StateSamples, u: ControlSamples
    ) -> Float[Array, "*agents pieces 4 d"]:
        """Compute scaled control points over the horizon; after its last control an agent coasts.

        Args:
            x: Positions [m] and velocities [m/s].
            u: Accelerations, held over each step [m/s²].

        Raises:
            InputError: There are fewer states than the steps need.
        """
        T, pieces, d = min(u.shape[-2], self.steps), len(self.fine_model), u.shape[-1]
        if x.shape[-2] <= T:
            raise InputError("x", f"must have {T + 1} instants for {T} steps, got {x.shape[-2]}")
        rest = self.steps - T
        still = np.zeros((*u.shape[:-2], rest, u.shape[-1]))
        after = self.discrete_model[T:].simulate(x[..., T, :], still)
        X = np.concatenate([x[..., :T, :], after[..., :-1, :]], axis=-2)
        U = np.concatenate([u[..., :T, :], still], axis=-2)
        on_both, constant = self._stacked_maps
        both = np.concatenate([X, U], axis=-1).reshape(-1, self.steps, X.shape[-1] + d)
        points = np.empty((len(both), *constant.shape))
        for k in range(self.steps):  # far faster than one sum by `np.einsum`
            points[:, k] = both[:, k] @ on_both[k] + constant[k]
        return points.reshape(*u.shape[:-2], pieces, 4, d)

    @cached_property
    def _stacked_maps(self) -> tuple[Array, Array]:
        """P and Q side by side, transposed, and r, of all control points of each step."""
        maps = self.control_point_maps
        P, Q, r = (part.reshape(self.steps, -1, *part.shape[4:]) for part in maps)
        return np.ascontiguousarray(np.concatenate([P, Q], axis=2).swapaxes(1, 2)), r


@checked
def convexify(
    horizon: AvoidanceHorizon,
    T: Annotated[int, Ge(1)],
    others: Float[Array, "others pieces 4 d"],
    normal: Float[Array, "others pieces d"],
    separation: Separation | None = None,
) -> HalfSpaces:
    """Constrain n·(P x + Q u + r − c̄) ≥ R for every movable control point [Morgan2016, eq. 64].

    The agent has T steps left, and coasts after them. The points c̄ are those of the others [m],
    the normals n are of `choose_normals`; by default the separation is that of the horizon.
    """
    P, Q, r = (part[:T] for part in horizon.control_point_maps)
    required = horizon.required_separation if separation is None else separation
    T, S, _, d, n = P.shape
    pieces, count = T * S, len(others)
    if normal.shape[1] < pieces:
        raise InputError("normal", f"must have {pieces} pieces, got {normal.shape[1]}")
    movable = np.any(Q != 0, axis=(3, 4))
    movable[1:] = True
    each, normal = movable.ravel(), np.ascontiguousarray(normal)[:, :pieces]
    away = np.ascontiguousarray(others)[:, :pieces] - r.reshape(pieces, 4, d)
    rhs = np.full(count, required, dtype=float)[:, None, None]
    rhs = rhs + np.einsum("opd,opid->opi", normal, away)
    along = np.repeat(normal, 4, axis=1)[:, each]
    on_x = np.einsum("ord,rdn->orn", along, P.reshape(-1, d, n)[each])
    on_u = np.einsum("ord,rdm->orm", along, Q.reshape(-1, d, d)[each])
    step = np.tile(np.repeat(np.arange(T), 4 * S)[each], count)
    rhs = rhs.reshape(count, 4 * pieces)[:, each].ravel()
    return HalfSpaces(step, on_x.reshape(-1, n), on_u.reshape(-1, d), rhs)


def convexify_end(
    horizon: AvoidanceHorizon,
    T: Annotated[int, Ge(1)],
    others: Float[Array, "others pieces 4 d"],
    normal: Float[Array, "others pieces d"],
    separation: Float[Array, " others"],
) -> HalfSpaces:
    """Constrain where an agent comes to rest, while others move on to the end of the horizon.

    Args:
        horizon: Avoidance horizon and its pieces.
        T: Steps after which the agent rests.
        others: Control points c̄ of the others [m].
        normal: Unit normals n of the half-spaces.
        separation: Required distances.
    """
    P, Q, r = (part[T - 1, -1, -1] for part in horizon.control_point_maps)
    later = slice(T * horizon.pieces_per_step, None)
    n = normal[:, later]
    farthest = np.einsum("opd,opid->opi", n, others[:, later]).max(axis=2)
    rhs = farthest + separation[:, None] - n @ r
    flat = n.reshape(-1, n.shape[2])
    return HalfSpaces(np.full(rhs.size, T - 1), flat @ P, flat @ Q, rhs.flatten())


@checked
def choose_normals(
    relative: Float[Array, "others pieces 4 d"], separation: Separation, side: PassingSide = "same"
) -> Float[Array, "others pieces d"]:
    """Choose the unit normals of the half-spaces, one a piece [Morgan2016, Fig. 2].

    Over a piece without conflict: from the other agent to the nominal trajectory, which then
    satisfies its own half-space. Two nominal trajectories in conflict have no such normals;
    theirs belong to a nominal trajectory that is displaced sideways at the closest approach,
    gradually before it, until it just passes.

    Args:
        relative: Control points of the nominal trajectory less those of the others [m].
        separation: Required distance, of all others or of each [m].
        side: Displacement in a conflict: to the side of the closest approach ("same"), to the
            opposite one, or, in space, above or below the plane of closest approach and motion;
            none, and so the normals as printed ("nominal").
    """
    distance, nearest = hull_distance(relative)
    displaced = relative
    required = np.broadcast_to(separation, len(relative))
    conflicts = np.flatnonzero(distance.min(axis=1) < required)
    if len(conflicts) and side != "nominal":
        displaced = relative.copy()
        for a in conflicts:
            hulls = relative[a], distance[a], nearest[a]
            displaced[a] += _passing_displacement(*hulls, float(required[a]), side)
        distance[conflicts], nearest[conflicts] = hull_distance(displaced[conflicts])
    inside = distance <= 0
    # Here even the displacement does not suffice.
    nearest[inside] = displaced[inside].mean(axis=-2)
    length = np.linalg.norm(nearest, axis=-1, keepdims=True)
    return np.asarray(nearest / np.maximum(length, 1e-300))


def _passing_displacement(
    relative: Array, distance: Array, nearest: Array, separation: float, side: PassingSide
) -> Float[Array, "pieces 4 d"]:
    p = int(np.argmin(distance))
    closest = float(distance[p])
    across = nearest[p] / closest if closest > 1e-6 * separation else _perpendicular(relative[p])
    displacement = (separation - closest) * across
    if side == "opposite":
        displacement = -(separation + closest) * across
    elif side != "same":
        up = _above(relative[p], across)
        displacement = (separation**2 - closest**2) ** 0.5 * (up if side == "above" else -up)
    return rise_before(p, len(relative)) * displacement


def across_motion(
    piece: Float[Array, "4 d"], nearest: Float[Array, " d"], side: PassingSide
) -> Float[Array, " d"]:
    """Return the unit vector to a side of an obstacle, across the motion past it.

    The piece is the nearest, and its vector from the obstacle is 0 inside [m]. Of several
    obstacles all are passed above, or all below.
    """
    size = float(np.linalg.norm(nearest))
    across = nearest / size if size > 0 else _perpendicular(piece)
    if side in ("above", "below"):
        up = _above(piece, across)
        across = up if up[2] >= 0 else -up
    return across if side in ("same", "above") else -across


def rise_before(p: int, pieces: int) -> Float[Array, "pieces 4 1"]:
    """Return factors of a displacement that has its size from piece p on, and some beyond.

    Control points stand at thirds of a piece; a constant control displaces quadratically.
    """
    time = np.arange(pieces)[:, None] + np.arange(4) / 3
    return np.asarray(1.2 * (np.minimum(1.0, time / (p + 0.5)) ** 2)[..., None])


def _above(piece: Float[Array, "4 d"], across: Float[Array, " d"]) -> Float[Array, " d"]:
    """Return the unit vector across the motion and another vector that is across it."""
    up = np.cross(across, piece[-1] - piece[0])
    size = float(np.linalg.norm(up))
    if size > 0:
        return np.asarray(up / size)
    return _perpendicular(np.tile(across, (4, 1)) * np.arange(4)[:, None])


def _perpendicular(piece: Float[Array, "4 d"]) -> Float[Array, " d"]:
    """Return a horizontal unit vector across the motion, to its right."""
    along = piece[-1] - piece[0]
    across = np.zeros_like(along)
    across[:2] = along[1], -along[0]
    if not across.any():
        across[0] = 1.0
    return np.asarray(across / np.linalg.norm(across))
