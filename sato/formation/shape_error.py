"""How well a swarm has taken up a shape, as seen from outside."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.alignment import align

MIRROR = np.array([1.0, 1.0, -1.0])


class ShapeError(NamedTuple):
    """A swarm beside its shape: root mean square distances, laid where it fits best [m]."""

    upright: float
    mirrored: float  # from its mirror image, upside down

    @property
    def inverted(self) -> bool:
        """Whether it is upside down: that fits twice as well, so not where it is all but flat."""
        return 2 * self.mirrored < self.upright

    @property
    def error(self) -> float:
        """From whichever of the two it is [m]."""
        return self.mirrored if self.inverted else self.upright


def compute_shape_error(
    position: Float[Array, "points 3"], shape: Float[Array, "points 3"]
) -> ShapeError:
    """Lay a shape, and its mirror image, over those who hold its points.

    It may be shifted and turned about the vertical, not scaled.

    Args:
        position: Of who holds each point [m].
        shape: The points [m].
    """
    return ShapeError(_rms_error(position, shape), _rms_error(position, shape * MIRROR))


def _rms_error(position: Array, shape: Array) -> float:
    away = position - align(shape, position).transform(shape)
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))
