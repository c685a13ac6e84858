"""Forces on a spacecraft in inertial space: two-body gravity, J2 and drag."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.atmosphere import Atmosphere
from dynamics.bodies import (
    EARTH,
    EARTH_MU,
    FROM_MU,
    BodyRadius,
    Mu,
    Oblateness,
    complete_gravity,
    find_body,
)
from dynamics.doors import checked
from dynamics.orbit import OrbitStates, Scalars, Vectors


@checked
@dataclass(frozen=True)
class Forces:
    """Two-body gravity, J2, and drag where there is an atmosphere.

    States are inertial positions and velocities [m, m/s], ballistic coefficients
    B = C_D A/m [m²/kg].
    """

    mu: Mu = EARTH_MU  # gravitational parameter [m³/s²]
    k_J2: Oblateness = FROM_MU  # 3/2 J₂ μ R² [m⁵/s²]; of the body with this mu, if not given
    atmosphere: Atmosphere | None = None  # of the Earth
    body_radius: BodyRadius = FROM_MU  # at the equator [m]; of the body with this mu, if not given

    def __post_init__(self) -> None:
        """Complete the gravity, and refuse the Earth's air about another body."""
        complete_gravity(self)
        if self.atmosphere is not None and find_body(self.mu) is not EARTH:
            reason = f"the air is the Earth's, and mu is that of {find_body(self.mu).name}"
            raise ValueError(f"atmosphere: {reason}; None would do")

    def acceleration(self, state: OrbitStates, ballistic_coefficient: Scalars = 0.0) -> Vectors:
        """Return the acceleration of one spacecraft or of many [m/s²]."""
        gravity = self._gravity(state[..., :3], self.mu)
        if self.atmosphere is None:
            return gravity
        return np.asarray(gravity + self.atmosphere.drag_acceleration(state, ballistic_coefficient))

    def differential_acceleration(
        self,
        chief: Float[Array, " 6"],
        offset: OrbitStates,
        ballistic_coefficient: Scalars = 0.0,
        chief_ballistic_coefficient: float = 0.0,
    ) -> Vectors:
        """Return the accelerations of deputies minus that of the chief [m/s²].

        The difference of two accelerations would lose most digits of two-body gravity, which
        changes by 1e-4 of itself in a kilometer. Encke's form keeps all of them
        [Vallado2013, Sec. 8.3], with r the deputy's distance, R the chief's and d the offset:

            μ R/R³ − μ r/r³ = −μ/R³ (d − F r),  F = 1 − (1 + q)^(−3/2),  q = d·(d + 2R)/R²
        """
        R, d = chief[:3], offset[..., :3]
        R2 = float(R @ R)
        q = (d * (d + 2 * R)).sum(axis=-1, keepdims=True) / R2
        F = -np.expm1(-1.5 * np.log1p(q))
        gravity = -self.mu / R2**1.5 * (d - F * (R + d))
        gravity += self._gravity(R + d, 0.0) - self._gravity(R, 0.0)
        if self.atmosphere is None:
            return np.asarray(gravity)
        drag = self.atmosphere.drag_acceleration(chief + offset, ballistic_coefficient)
        chief_drag = self.atmosphere.drag_acceleration(chief, chief_ballistic_coefficient)
        return np.asarray(gravity + drag - chief_drag)

    def broadcast_ballistic_coefficients(
        self, ballistic_coefficient: Scalars | None, count: int
    ) -> Float[Array, " {count}"]:
        """Return a ballistic coefficient for each of so many agents, 0 without atmosphere."""
        self.validate_ballistic_coefficients(ballistic_coefficient)
        if self.atmosphere is None or ballistic_coefficient is None:
            return np.zeros(count)
        if np.shape(ballistic_coefficient) not in ((), (count,)):
            there = f"there are {count} agents and {np.size(ballistic_coefficient)} coefficients"
            reason = f"give one for all agents or one for each; {there}"
            raise ValueError(f"ballistic_coefficient: {reason}")
        return np.broadcast_to(np.asarray(ballistic_coefficient, dtype=float), (count,))

    def validate_ballistic_coefficients(self, ballistic_coefficient: Scalars | None) -> None:
        """Check that ballistic coefficients are there where, and only where, there is air."""
        given = np.asarray(0.0 if ballistic_coefficient is None else ballistic_coefficient)
        if ballistic_coefficient is None and self.atmosphere is not None:
            reason = "drag needs the ballistic coefficient C_D A/m of every agent and of the chief"
            raise ValueError(f"{reason}, in m²/kg: for instance 0.01 for 2.2 × 0.5 m² / 110 kg")
        if self.atmosphere is None and given.any():
            reason = "have no effect without an atmosphere: give one"
            raise ValueError(f"ballistic coefficients {reason}")
        if not (np.isfinite(given) & (given >= 0)).all():
            least = f"got {given.min()} m²/kg"
            raise ValueError(f"ballistic coefficients are finite and not negative, {least}")

    def _gravity(self, position: Array, mu: float) -> Array:
        # −∇ of −μ/r − k/r³ (1/3 − (Z/r)²), with Z along the axis of the body. Component by
        # component, because sums over a short last axis would take half of the time.
        X, Y, Z = position[..., 0], position[..., 1], position[..., 2]
        r2 = X * X + Y * Y + Z * Z
        r = np.sqrt(r2)
        oblateness = self.k_J2 / (r2 * r2 * r)
        strength = mu / (r2 * r) + oblateness * (1 - 5 * Z * Z / r2)
        gravity = -strength[..., None] * position
        gravity[..., 2] -= 2 * oblateness * Z
        return np.asarray(gravity)
