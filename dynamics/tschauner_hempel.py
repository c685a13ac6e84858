"""Tschauner–Hempel equations: relative motion about an ellipse [Tschauner1965].

Axes (LVLH): x radial, outward; y transverse, in the plane and perpendicular to x; z normal
(cross-track). Velocities are relative to the rotating axes.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.model import LinearModel, Matrices
from dynamics.orbit import Orbit, Scalars, Vectors
from dynamics.symbols import Numbers


@checked
@dataclass(frozen=True)
class TschaunerHempel(LinearModel):
    """Tschauner–Hempel equations about the ellipse that is osculating at time 0.

        ẍ =  2ωẏ + (ω² + 2μ/r³)x + αy + u_x
        ÿ = −2ωẋ + (ω² −  μ/r³)y − αx + u_y
        z̈ =            −(μ/r³)z       + u_z,     ω = h/r²,  α = ω̇ = −2 h v_x/r³

    Valid while the separation is small against the radius, at any eccentricity below 1,
    without J2. For e = 0 they are the Clohessy–Wiltshire equations.

    Args:
        orbit: Orbit of the chief; its k_J2 is set to 0.
    """

    orbit: Orbit
    axes: int = field(default=3, init=False, repr=False)

    def __post_init__(self) -> None:
        """Leave out the oblateness."""
        object.__setattr__(self, "orbit", replace(self.orbit, k_J2=0.0))

    def A(self, t: Scalars) -> Numbers[Array, "*k 6 6"]:
        """State matrix at one time or at many."""
        r, v_x, h = np.moveaxis(self.orbit.elements_at(t)[..., :3], -1, 0)
        omega, alpha, pull = h / r**2, -2 * h * v_x / r**3, self.orbit.mu / r**3
        A = np.zeros((*np.shape(r), 6, 6), np.asarray(r).dtype)
        A[..., :3, 3:] = np.eye(3)
        A[..., 3, 0], A[..., 3, 1], A[..., 3, 4] = omega**2 + 2 * pull, alpha, 2 * omega
        A[..., 4, 0], A[..., 4, 1], A[..., 4, 3] = -alpha, omega**2 - pull, -2 * omega
        A[..., 5, 2] = -pull
        return A

    def matrices(self, times: Numbers[Array, " k"]) -> Matrices:
        """Stack A, B and z at many times."""
        k = len(times)
        return self.A(times), np.repeat(self.B(0.0)[None], k, axis=0), np.zeros((k, 6))

    def bounded_velocity(self, position: Vectors, t: float = 0.0) -> Vectors:
        """Return the velocity of a closed orbit through a position [m/s].

            ẏ = −(ω + μ/rh) x + (v_x/r) y,  ẋ = ż = 0

        matches the chief's energy to first order, and so its period. About a circle it is
        ẏ = −2nx.

        Args:
            position: Relative to the chief [m].
            t: Time at that position [s].
        """
        r, v_x, h, *_ = self.orbit.elements_at(t)
        x, y, _ = np.moveaxis(position, -1, 0)
        velocity = np.zeros(position.shape)
        velocity[..., 1] = v_x / r * y - (h / r**2 + self.orbit.mu / (r * h)) * x
        return velocity
