"""Where a shape lies, and how it is turned, to be nearest to what is seen."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class Pose:
    """A turn about the vertical, then a shift: p ↦ R p + r. One, or one for each of many."""

    yaw: Float[Array, "*swarm"] | float  # of R, counterclockwise seen from above [rad]
    translation: Float[Array, "*swarm 3"]  # where the origin comes to lie [m]

    def transform(self, points: Float[Array, "*#swarm k 3"]) -> Float[Array, "*swarm k 3"]:
        """Where the points come to lie [m]."""
        placed: Array = _rotate(points, np.asarray(self.yaw)) + self.translation[..., None, :]
        return placed


def align(
    shape: Float[Array, "*#swarm k 3"],
    measured: Float[Array, "*#swarm k 3"],
    mask: Bool[Array, "*#swarm k"] | None = None,
) -> Pose:
    """The pose that brings a shape nearest to what is seen, point by point.

        minimise Σ ‖seen − (R shape + r)‖²  over turns R about the vertical and shifts r

    as in [Lusk2020, eq. 13] and, in closed form, [Arun1987]: r takes mean to mean, and with
    the planar parts about their means as complex numbers s and w, R is the turn by the angle
    of Σ s̄ w. A reflection cannot come out, which the general method must exclude. In whatever
    frame the points are seen, the shape is placed among them alike.

    Where Σ s̄ w is zero every yaw is as good, and 0 is taken: where the points of either lie on
    one vertical, and in cases like a square and its mirror image.

    Args:
        shape: Points of the shape [m]; leading axes are for many at once.
        seen: Where those who hold these points are seen [m].
        counts: Which points count, all if not given; what does not may be NaN. A swarm's
            are its graph with each vehicle's own point, a row for each vehicle.

    Returns:
        The pose of the shape in the frame of what is seen.

    Raises:
        ValueError: There is no point that counts.
    """
    if mask is None:
        mask = np.full(np.broadcast_shapes(shape.shape, measured.shape)[:-1], True)
    if not np.all(mask.any(axis=-1)):
        raise ValueError(
            "a shape is aligned by at least one point that is seen, and none counts here; "
            "count at least the vehicle's own"
        )
    p, s, about_p = _center(shape, mask)
    q, w, about_q = _center(measured, mask)
    inner = (s.conj() * w).sum(axis=-1)
    # As large comes from the rounding of large coordinates alone, and is no direction.
    rounding = 8 * np.finfo(float).eps * (_norm(p) * _norm(w) + _norm(s) * _norm(q))
    yaw = np.where(np.abs(inner) > rounding, np.angle(inner), 0.0)
    return Pose(yaw, (about_q - _rotate(about_p, yaw))[..., 0, :])


def _rotate(points: Array, yaw: Array) -> Array:
    c, s = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack(np.broadcast_arrays(c * x - s * y, s * x + c * y, z), axis=-1)


def _center(points: Array, counts: Array) -> tuple[Array, Array, Array]:
    # Planar parts as they are and about their mean, and the mean, (…, 1, 3).
    known = np.where(counts[..., None], points, 0.0)
    mean = known.sum(axis=-2, keepdims=True) / counts.sum(axis=-1)[..., None, None]
    return _to_complex(known), counts * _to_complex(known - mean), mean


def _to_complex(points: Array) -> Array:
    flat: Array = points[..., 0] + 1j * points[..., 1]
    return flat


def _norm(z: Array) -> Any:
    return np.linalg.norm(z, axis=-1)
