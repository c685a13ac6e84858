"""Alignment of a shape with measured points, in closed form, and the distance that remains."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.doors import MAY_BE_NAN, checked
from dynamics.inputs import InputError
from dynamics.vehicle import rotate_by_yaw


@checked
@dataclass(frozen=True, eq=False)
class Pose:
    """Rotation about the vertical followed by a translation: p ↦ R p + r."""

    yaw: Float[Array, "*swarm"] | float  # of R, counterclockwise seen from above [rad]
    translation: Float[Array, "*swarm 3"]  # r, image of the origin [m]

    def transform(self, points: Float[Array, "*#swarm k 3"]) -> Float[Array, "*swarm k 3"]:
        """Apply the pose to points [m]."""
        turned = rotate_by_yaw(points, np.asarray(self.yaw)[..., None])
        return np.asarray(turned + self.translation[..., None, :])


@checked
def align(
    shape: Float[Array, "*#swarm k 3"],
    measured: Annotated[Float[Array, "*#swarm k 3"], MAY_BE_NAN],
    mask: Bool[Array, "*#swarm k"] | None = None,
) -> Pose:
    """Find the pose that brings a shape nearest to measured points.

        minimize Σ ‖measured − (R shape + r)‖²  over yaw rotations R and translations r

    [Lusk2020, eq. 13], in closed form after [Arun1987]: r maps mean to mean. With the
    horizontal parts about their means as complex numbers s and w, R rotates by the angle of
    Σ s̄ w. A reflection is impossible, which the general method must exclude. The placed
    shape does not depend on the coordinate frame of the measurements.

    Where Σ s̄ w is zero every yaw is optimal, and 0 is returned: where the points of either
    lie on one vertical, and for example for a square and its mirror image.

    Args:
        shape: Points of the shape [m]; leading axes for several alignments at once.
        measured: Measured positions of the agents at these points [m].
        mask: True for points to use, all by default; the others may be NaN. For a swarm: its
            graph with a True diagonal, one row per agent.

    Returns:
        Pose of the shape in the coordinate frame of the measurements.

    Raises:
        ValueError: The mask leaves no point.
    """
    if mask is None:
        mask = np.full(np.broadcast_shapes(shape.shape, measured.shape)[:-1], True)
    if not np.all(mask.any(axis=-1)):
        raise ValueError("mask: at least one measured point is needed, got none")
    p, s, about_p = _center(shape, mask)
    q, w, about_q = _center(measured, mask)
    if not np.isfinite(about_q).all():
        raise InputError("measured", "must be finite where the mask is True")
    inner = (s.conj() * w).sum(axis=-1)
    # Below this, the inner product is rounding of large coordinates and has no direction.
    sizes = [np.linalg.norm(z, axis=-1) for z in (p, w, s, q)]
    rounding = 8 * np.finfo(float).eps * (sizes[0] * sizes[1] + sizes[2] * sizes[3])
    yaw = np.where(np.abs(inner) > rounding, np.angle(inner), 0.0)
    return Pose(yaw, (about_q - rotate_by_yaw(about_p, yaw[..., None]))[..., 0, :])


class ShapeError(NamedTuple):
    """Root mean square distance of a swarm from its aligned formation [m]."""

    upright: float
    mirrored: float  # from the mirror image, upside down

    @property
    def inverted(self) -> bool:
        """True where the mirror image fits twice as well, so never where it is almost flat."""
        return 2 * self.mirrored < self.upright

    @property
    def error(self) -> float:
        """Distance from the formation or its mirror image, see `inverted` [m]."""
        return self.mirrored if self.inverted else self.upright


def compute_shape_error(
    position: Float[Array, "points 3"], points: Float[Array, "points 3"]
) -> ShapeError:
    """Measure the distance of the holders of points from a formation, or its mirror image.

    Both are aligned: translated, and rotated about the vertical, but not scaled.
    """
    return ShapeError(_rms_error(position, points), _rms_error(position, points * [1.0, 1.0, -1.0]))


def _rms_error(position: Array, points: Array) -> float:
    offset = position - align(points, position).transform(points)
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))


def _center(points: Array, mask: Array) -> tuple[Array, Array, Array]:
    # Horizontal parts, the same about their mean, and the mean, (…, 1, 3).
    used = np.where(mask[..., None], points, 0.0)
    mean = used.sum(axis=-2, keepdims=True) / mask.sum(axis=-1)[..., None, None]
    flat, centered = (part[..., 0] + 1j * part[..., 1] for part in (used, used - mean))
    return flat, mask * centered, mean
