"""Shape error: distance of a swarm from its formation, wherever and at any heading."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.alignment import align

MIRROR = np.array([1.0, 1.0, -1.0])


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
    """Align a formation, and its mirror image, with a swarm, and measure the distance.

    They may be translated, and rotated about the vertical, but not scaled.

    Args:
        position: Position of the holder of each point [m].
        points: Points of the formation [m].
    """
    return ShapeError(_rms_error(position, points), _rms_error(position, points * MIRROR))


def _rms_error(position: Array, points: Array) -> float:
    offset = position - align(points, position).transform(points)
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))
