"""Double integrator: a point mass under a controlled acceleration."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.model import LinearModel
from dynamics.symbols import Number


@checked
@dataclass(frozen=True)
class DoubleIntegrator(LinearModel):
    """r̈ = u in the plane or in space.

    Args:
        axes: Dimension of space, 2 or 3.
    """

    axes: Literal[2, 3] = 2
    is_time_invariant: ClassVar[bool] = True

    def A(self, t: Number) -> Float[Array, "n n"]:
        """State matrix."""
        return np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(self.axes))
