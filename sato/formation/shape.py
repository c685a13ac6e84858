"""How well a swarm has taken up a shape, as seen from outside."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.alignment import align

FLIP = np.array([1.0, 1.0, -1.0])


class Likeness(NamedTuple):
    """A swarm beside its shape."""

    error: float  # root mean square distance from the shape, laid where it fits best [m]
    inverted: bool  # whether its mirror image, upside down, fits better


def likeness(position: Float[Array, "points 3"], shape: Float[Array, "points 3"]) -> Likeness:
    """Lay a shape, or its mirror image, over those who hold its points.

    It may be shifted and turned about the vertical, not scaled.

    Args:
        position: Of who holds each point [m].
        shape: The points [m].
    """
    upright, flipped = (_error(position, shape * way) for way in (np.ones(3), FLIP))
    return Likeness(min(upright, flipped), flipped < upright)


def _error(position: Array, shape: Array) -> float:
    away = position - align(shape, position).place(shape)
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))
