"""Double integrator: a point mass under a controlled acceleration."""

from dataclasses import dataclass
from typing import ClassVar

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

    Raises:
        ValueError: It is another one.
    """

    axes: int = 2
    is_time_invariant: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Check the dimension."""
        if self.axes not in (2, 3):
            raise ValueError(f"axes: a double integrator has 2 or 3 axes, got {self.axes}")

    def A(self, t: Number) -> Float[Array, "n n"]:
        """State matrix."""
        return np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(self.axes))
