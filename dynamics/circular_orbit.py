"""Relative motion about a circular orbit: Clohessy–Wiltshire and Schweighart–Sedwick.

Axes (LVLH): x radial, outward; y transverse (along-track); z normal (cross-track).
Velocities are relative to the rotating axes.
"""

from abc import abstractmethod
from dataclasses import dataclass
from math import cos, inf, sin, sqrt
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Gt
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.bodies import (
    EARTH_MU,
    FROM_MU,
    BodyRadius,
    Mu,
    Oblateness,
    complete_gravity,
    find_body,
)
from dynamics.doors import check_methods, checked
from dynamics.model import LinearModel
from dynamics.orbit import K_J2, Orbit, Vectors, validate_inclination
from dynamics.symbols import Number
from dynamics.units import Angle, AngularRate, Length


@check_methods
class CircularOrbitModel(LinearModel):
    """Linear model of relative motion about a circular orbit.

        ẍ =  2aẏ + bx + u_x
        ÿ = −2aẋ      + u_y
        z̈ = −q²z      + u_z

    Let w² = 4a² − b. Without control, D = ẏ + 2ax is constant, and the in-plane motion is
    an ellipse with semi-axes in the ratio w : 2a, traversed at the rate w, about a center
    that drifts along the orbit at −(b/w²) D. The orbit is closed in the plane if and
    only if D = 0, and as a whole where q = w too, as for Clohessy–Wiltshire.
    """

    axes: int = 3
    is_time_invariant: ClassVar[bool] = True

    @property
    @abstractmethod
    def _coefficients(self) -> tuple[float, float, float]:
        """a, b and q of the equations."""

    @property
    def rotation_rate(self) -> float:
        """a: rate of rotation of the LVLH axes [rad/s]."""
        return self._coefficients[0]

    @property
    def radial_gradient(self) -> float:
        """b: gravity gradient and centrifugal term along the radius [1/s²]."""
        return self._coefficients[1]

    @property
    def cross_track_rate(self) -> float:
        """q: rate of the cross-track oscillation [rad/s]."""
        return self._coefficients[2]

    @property
    def in_plane_rate(self) -> float:
        """w: rate of the in-plane motion [rad/s]."""
        return sqrt(4 * self.rotation_rate**2 - self.radial_gradient)

    def A(self, t: Number) -> Float[Array, "6 6"]:
        """State matrix."""
        a, b, q = self._coefficients
        K = np.diag([b, 0, -(q**2)])
        C = np.array([[0, 2 * a, 0], [-2 * a, 0, 0], [0, 0, 0]])
        return np.block([[np.zeros((3, 3)), np.eye(3)], [K, C]])

    def bounded_velocity(self, position: Vectors, t: float = 0.0) -> Vectors:
        """Return the velocity of an orbit that is closed in the plane through a position [m/s].

        ẏ = −2ax cancels the along-track drift; ẋ = ż = 0.

        Args:
            position: Relative to the chief [m].
            t: Time; without effect, as the model is time-invariant [s].
        """
        velocity = np.zeros(position.shape)
        velocity[..., 1] = -2 * self.rotation_rate * position[..., 0]
        return velocity

    def centered_velocity(self, position: Vectors, t: float = 0.0) -> Vectors:
        """Return the velocity of an orbit closed in the plane and centered on the chief [m/s].

        ẋ = w²y / 2a and ẏ = −2ax put the center of the ellipse at the chief; ż = 0.

        Args:
            position: Relative to the chief [m].
            t: Time; without effect, as the model is time-invariant [s].
        """
        velocity = self.bounded_velocity(position)
        velocity[..., 0] = self.in_plane_rate**2 / (2 * self.rotation_rate) * position[..., 1]
        return velocity


@checked
@dataclass(frozen=True)
class ClohessyWiltshire(CircularOrbitModel):
    """Clohessy–Wiltshire equations [Clohessy1960].

        ẍ =  3n²x + 2nẏ + u_x
        ÿ =        −2nẋ + u_y
        z̈ = −n²z        + u_z

    Valid while the separation is small against the radius of the orbit. Errors from J2, the
    eccentricity and second-order terms add up: see `campaigns/linear-models.toml`.

    Args:
        n: Mean motion of the chief [rad/s].
    """

    n: Annotated[AngularRate, Gt(0)]

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "ClohessyWiltshire":
        """Take a circle with the mean motion of the orbit at time 0."""
        return cls(orbit.mean_motion)

    @property
    def _coefficients(self) -> tuple[float, float, float]:
        return self.n, 3 * self.n**2, self.n


@checked
@dataclass(frozen=True)
class SchweighartSedwick(CircularOrbitModel):
    """Clohessy–Wiltshire equations with the J2 gradient averaged over the orbit [Schweighart2002].

        ẍ =  2ncẏ + (5c² − 2)n²x + u_x
        ÿ = −2ncẋ                + u_y
        z̈ = −k_z²z               + u_z

        s = k_J2 (1 + 3 cos 2i) / (4μr²),  c = √(1 + s),  k_z = nc + n k_J2 cos²i / (μr²)

    The LVLH axes turn at the mean rate nc; k_z is the mean rate of the chief's argument of
    latitude, which the drift of the node is part of.

    Valid while the separation is small against the radius of a nearly circular orbit, and,
    in cross-track, between orbits of one inclination. Nodes of orbits of different
    inclination drift apart, and the amplitude of z grows slowly: [Schweighart2002] has a
    term 2lq cos(qt + φ) in z̈, which depends on the chief's latitude and is left out here.

    Args:
        radius: Radius of the chief's orbit [m].
        inclination: Inclination of the chief's orbit [rad].
        mu: Gravitational parameter [m³/s²].
        k_J2: 3/2 J₂ μ R² [m⁵/s²]; 0 gives Clohessy–Wiltshire. By default that of the body with
            this mu.
        body_radius: Radius R at the equator [m], by default that of the body with this mu.

    Raises:
        ValueError: A value is out of its range, or J2 is no small part of gravity.
    """

    radius: Length
    inclination: Angle
    mu: Mu = EARTH_MU
    k_J2: Oblateness = FROM_MU
    body_radius: BodyRadius = FROM_MU

    def __post_init__(self) -> None:
        """Complete the gravity; check the orbit, and that J2 is a small perturbation."""
        validate_inclination(self.inclination)
        complete_gravity(self)
        if not self.body_radius < self.radius < inf:
            least = f"{find_body(self.mu).name}'s, {self.body_radius / 1e3:.0f} km"
            reason = f"must be above {least}, measured from the center and in meters"
            raise ValueError(f"radius: {reason}, got {self.radius} m")
        if not abs(self._j2_ratio) < 0.1:
            found = f"{self.mu} m³/s² and {self.k_J2} m⁵/s²"
            earth = f"of the Earth they are {EARTH_MU:.4g} and {K_J2:.4g}"
            raise ValueError(f"k_J2: must be a small part of gravity, got {found}; {earth}")

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "SchweighartSedwick":
        """Take the circle with the orbit's energy under the averaged J2.

        Its rates are the orbit's mean rates to about 1e-5 where the eccentricity is of the
        order of J2. With the osculating semi-major axis, which J2 moves by kilometers in
        each orbit, they would be wrong by up to 3e-3; in cross-track that is 20 m an orbit
        for each km. In the plane both are equally good, since the periodic terms that the
        average omits dominate there.
        """
        gravity = mu, k, _ = orbit.mu, orbit.k_J2, orbit.body_radius
        first = cls(orbit.semi_major_axis, orbit.inclination, *gravity)
        Z2 = (sin(orbit.inclination) * sin(orbit.arg_latitude)) ** 2
        energy = -mu / (2 * orbit.semi_major_axis) - k / orbit.r**3 * (1 / 3 - Z2)
        # A circle at the rate nc has −μ/2r + μs/6r; the first estimate of s is good enough.
        return cls(-mu / (2 * energy) * (1 - first.s / 3), orbit.inclination, *gravity)

    @property
    def n(self) -> float:
        """Mean motion of the circle without J2 [rad/s]."""
        return sqrt(self.mu / self.radius**3)

    @property
    def s(self) -> float:
        """Strength of J2 averaged over the orbit, a small number."""
        return self._j2_ratio * (1 + 3 * cos(2 * self.inclination)) / 4

    @property
    def c(self) -> float:
        """Ratio of the rotation rate of the axes to n."""
        return sqrt(1 + self.s)

    @property
    def _coefficients(self) -> tuple[float, float, float]:
        n, c = self.n, self.c
        k_z = n * (c + self._j2_ratio * cos(self.inclination) ** 2)
        return n * c, (5 * c**2 - 2) * n**2, k_z

    @property
    def _j2_ratio(self) -> float:
        return self.k_J2 / (self.mu * self.radius**2)
