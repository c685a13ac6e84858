"""Atmosphere of exponential density that rotates with the Earth, and its drag."""

from dataclasses import dataclass
from math import inf
from typing import Annotated

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.bodies import EARTH_RADIUS, EARTH_ROTATION
from dynamics.doors import checked
from dynamics.inputs import InputError
from dynamics.orbit import OrbitStates, Scalars, Vectors
from dynamics.units import AngularRate, Length, Unit

LEAST_ALTITUDE = 2e3  # of a reference but the ground; fewer meters are kilometers [m]
MAX_HEIGHTS = 100  # of the scale height, within which densities are finite
# Altitude [km], density there [kg/m³] and scale height above it [km]: those rows of
# [Vallado2013, table 8-4] at which spacecraft stay in orbit.
DENSITY_TABLE = (
    (150, 2.070e-9, 22.523),
    (180, 5.464e-10, 29.740),
    (200, 2.789e-10, 37.105),
    (250, 7.248e-11, 45.546),
    (300, 2.418e-11, 53.628),
    (350, 9.518e-12, 53.298),
    (400, 3.725e-12, 58.515),
    (450, 1.585e-12, 60.828),
    (500, 6.967e-13, 63.822),
    (600, 1.454e-13, 71.835),
    (700, 3.614e-14, 88.667),
    (800, 1.170e-14, 124.64),
    (900, 5.245e-15, 181.05),
    (1000, 3.019e-15, 268.00),
)


@checked
@dataclass(frozen=True)
class Atmosphere:
    """Exponential atmosphere: density ρ₀ exp(−(h − h₀)/H) at altitude h above a sphere.

    The defaults hold from 500 to 600 km at moderate solar activity. With solar activity the
    real density varies by a factor of several in both directions.
    """

    reference_density: Annotated[float, Unit("kg_m3"), Ge(0)] = 6.967e-13  # ρ₀ [kg/m³]
    reference_altitude: Length = 500e3  # h₀ [m]
    scale_height: Annotated[Length, Ge(1e3)] = 63.822e3  # H [m]
    rotation_rate: AngularRate = EARTH_ROTATION  # about the Earth's axis [rad/s]

    def __post_init__(self) -> None:
        """Check that densities are finite."""
        if abs(self.reference_altitude) > MAX_HEIGHTS * self.scale_height:
            wanted = f"at most {MAX_HEIGHTS} scale_height of {self.scale_height} m"
            got = f"got {self.reference_altitude} m"
            raise ValueError(f"reference_altitude must be {wanted}, {got}")
        if 0 < self.reference_altitude < LEAST_ALTITUDE:
            given = f"{self.reference_altitude:g}"
            meant = f"altitudes are in meters: {given} km are {given}e3 m"
            raise InputError("reference_altitude", f"is {given} m, and air is thin there; {meant}")

    @classmethod
    def from_altitude(cls, altitude: Length) -> "Atmosphere":
        """Take the row of [Vallado2013, table 8-4] for an altitude [m], from 150 km on."""
        below = [row for row in DENSITY_TABLE if row[0] * 1e3 <= altitude]
        if not below:
            reason = f"the table begins at {DENSITY_TABLE[0][0]} km, and no spacecraft can stay"
            got = f"got {altitude / 1e3:.4g} km; altitudes are in meters"
            raise ValueError(f"altitude: {reason} in orbit below, {got}")
        height, density, scale = below[-1]
        return cls(density, height * 1e3, scale * 1e3)

    def density_at(self, position: Float[Array, "*k 3"]) -> Float[Array, "*k"]:
        """Return the density [kg/m³] at positions in inertial axes [m], outside of the Earth."""
        r = np.sqrt((position * position).sum(axis=-1))
        if r.min(initial=inf) < EARTH_RADIUS / 2:
            raise ValueError("position: is inside the Earth, from whose center it is to be taken")
        above = r - (EARTH_RADIUS + self.reference_altitude)
        return np.asarray(self.reference_density * np.exp(-above / self.scale_height))

    def drag_acceleration(
        self, state: OrbitStates, ballistic_coefficient: Annotated[Scalars, Ge(0)]
    ) -> Vectors:
        """Return −½ ρ B |v| v, with v the velocity relative to the rotating air [m/s²].

        States are inertial positions and velocities [m, m/s], and B = C_D A/m [m²/kg].
        """
        position, relative = state[..., :3], state[..., 3:].copy()
        relative[..., 0] += self.rotation_rate * position[..., 1]
        relative[..., 1] -= self.rotation_rate * position[..., 0]
        speed = np.sqrt((relative * relative).sum(axis=-1))
        strength = -0.5 * ballistic_coefficient * self.density_at(position) * speed
        return np.asarray(strength[..., None] * relative)
