"""What pulls at a spacecraft in inertial space: the Earth, its oblateness, its air."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.atmosphere import Atmosphere
from dynamics.orbit import EARTH_MU, K_J2


@dataclass(frozen=True)
class Forces:
    """Two bodies, J2, and drag where there is an atmosphere.

    States are inertial positions and velocities [m, m/s], ballistic coefficients
    B = C_D A/m [m²/kg].
    """

    mu: float = EARTH_MU  # gravitational parameter [m³/s²]
    k_J2: float = K_J2  # 3/2 J₂ μ R², the strength of the oblateness [m⁵/s²]
    atmosphere: Atmosphere | None = None

    def acceleration(
        self,
        state: Float[Array, "*k 6"],
        ballistic_coefficient: float | Float[Array, "*#k"] | None = None,
    ) -> Float[Array, "*k 3"]:
        """Acceleration of one vehicle or of many [m/s²]."""
        pull = self._gravity(state[..., :3], self.mu)
        return np.asarray(
            pull
            if ballistic_coefficient is None
            else pull + self._drag(state, ballistic_coefficient)
        )

    def differential_acceleration(
        self,
        chief: Float[Array, " 6"],
        offset: Float[Array, "*k 6"],
        ballistic_coefficient: float | Float[Array, "*#k"] | None = None,
        chief_ballistic_coefficient: float = 0.0,
    ) -> Float[Array, "*k 3"]:
        """By how much more vehicles accelerate than the chief [m/s²].

        Subtracting two accelerations would leave a few digits of two bodies' pull, which
        differs by a ten-thousandth in a kilometre. Encke's form keeps them all
        [Vallado2013, Sec. 8.3], with r the vehicle's distance and R the chief's:

            μ R/R³ − μ r/r³ = −μ/R³ (d − F r),  F = 1 − (1 + q)^(−3/2),  q = d·(d + 2R)/R²

        Args:
            chief: Inertial state of the chief.
            offset: How the vehicles' states differ from it.
            ballistic: Of the vehicles, or None to leave out drag.
            chief_ballistic: Of the chief.
        """
        R, d = chief[:3], offset[..., :3]
        R2 = float(R @ R)
        q = (d * (d + 2 * R)).sum(axis=-1, keepdims=True) / R2
        F = -np.expm1(-1.5 * np.log1p(q))
        pull = -self.mu / R2**1.5 * (d - F * (R + d))
        pull += self._gravity(R + d, 0.0) - self._gravity(R, 0.0)
        if ballistic_coefficient is None:
            return np.asarray(pull)
        drag = self._drag(chief + offset, ballistic_coefficient)
        return np.asarray(pull + drag - self._drag(chief, chief_ballistic_coefficient))

    def broadcast_ballistic_coefficients(
        self, ballistic: float | Float[Array, " each"] | None, count: int
    ) -> Float[Array, " {count}"] | None:
        """A ballistic coefficient for each of so many vehicles, or None where there is no air.

        Raises:
            ValueError: `check` refuses them, or there are more or fewer than vehicles.
        """
        self.validate_ballistic_coefficients(ballistic)
        if self.atmosphere is None or ballistic is None:
            return None
        if np.shape(ballistic) not in ((), (count,)):
            raise ValueError(
                "give one ballistic coefficient for all or one for every vehicle: there are "
                f"{count} vehicles and {np.size(ballistic)} coefficients"
            )
        return np.broadcast_to(np.asarray(ballistic, dtype=float), (count,))

    def validate_ballistic_coefficients(self, ballistic: float | Float[Array, "*k"] | None) -> None:
        """Refuse an atmosphere without ballistic coefficients, and the other way round.

        Raises:
            ValueError: One is there without the other, or a coefficient is negative.
        """
        if self.atmosphere is not None and ballistic is None:
            raise ValueError(
                "drag needs the ballistic coefficient C_D A/m of every vehicle, in m²/kg: for "
                "instance 0.01 for 2.2 × 0.5 m² / 110 kg; without an atmosphere there is no drag"
            )
        if self.atmosphere is None and np.any(np.asarray(0.0 if ballistic is None else ballistic)):
            raise ValueError(
                "ballistic coefficients do nothing without an atmosphere: give one, such as "
                "Atmosphere() for 500 to 600 km or Atmosphere.near(altitude)"
            )
        if (
            ballistic is not None
            and not (np.isfinite(ballistic) & (np.asarray(ballistic) >= 0)).all()
        ):
            raise ValueError(
                f"ballistic coefficients are finite and not negative, got {np.min(ballistic)} m²/kg"
            )

    def _gravity(self, position: Array, mu: float) -> Array:
        # −∇ of −μ/r − k/r³ (1/3 − (Z/r)²), with Z along the Earth's axis; axis by axis, for
        # sums over a short last axis would take half of the time.
        X, Y, Z = position[..., 0], position[..., 1], position[..., 2]
        r2 = X * X + Y * Y + Z * Z
        r = np.sqrt(r2)
        bulge = self.k_J2 / (r2 * r2 * r)
        strength = mu / (r2 * r) + bulge * (1 - 5 * Z * Z / r2)
        pull = -strength[..., None] * position
        pull[..., 2] -= 2 * bulge * Z
        return np.asarray(pull)

    def _drag(self, state: Array, ballistic: float | Array) -> Array:
        if self.atmosphere is None:
            return np.zeros(3)
        return self.atmosphere.drag_acceleration(state[..., :3], state[..., 3:], ballistic)
