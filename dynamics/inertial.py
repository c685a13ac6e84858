"""The truth: spacecraft in inertial space, under two bodies, J2, drag and their thrust.

It shares no equation with the relative motion of `dynamics.j2`, so that each is a second
opinion on the other.
"""

from dataclasses import dataclass
from functools import cached_property
from math import inf

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.atmosphere import Atmosphere
from dynamics.coordinate_frames import LVLH, inertial_state, orbit_axes, to_polar_nodal
from dynamics.forces import Forces
from dynamics.orbit import Orbit
from dynamics.plant import Plant, is_present, validate_propagation
from dynamics.propagation import integrate_orbits

CHECKPOINT_INTERVAL = 60.0  # the chief's state is kept at multiples of this [s]
FIRST_STEP = 60.0  # tried first; in low orbit it keeps well within what follows [s]
RTOL = 1e-13  # allowed in a step, of the chief's state and of offsets from it,
OFFSET_ATOL = np.repeat([1e-10, 1e-13], 3)  # and besides, of an offset [m, m/s]


@dataclass(frozen=True, eq=False)
class InertialPlant(Plant):
    """Vehicles and their chief in inertial space, integrated together.

    The chief flies as they do, without thrust. What is integrated are the offsets from
    it, so that nothing is lost to the size of the Earth. Thrust keeps its direction in
    the chief's frame during a flight.

    Args:
        orbit: The chief's at time 0, and the Earth's gravity.
        ballistic: Coefficient C_D A/m of all vehicles or of each, where there is air [m²/kg].
        chief_ballistic: That of the chief.
        atmosphere: None is no drag.

    Raises:
        ValueError: There is drag without ballistic coefficients, or the other way round.
    """

    chief_orbit: Orbit
    ballistic_coefficient: float | Float[Array, " agents"] | None = None
    chief_ballistic_coefficient: float = 0.0  # [m²/kg]
    atmosphere: Atmosphere | None = None

    def __post_init__(self) -> None:
        """Refuse half a drag."""
        self._forces.validate_ballistic_coefficients(self.ballistic_coefficient)
        self._forces.validate_ballistic_coefficients(self.chief_ballistic_coefficient)

    def propagate(
        self,
        x: Float[Array, "agents n"],
        u: Float[Array, "agents m"],
        t: float,
        dt: float,
        substeps: int = 1,
    ) -> Float[Array, "{substeps}+1 agents n"]:
        """States at equal instants from t to t + dt, the first of them x itself.

        Raises:
            ValueError: The states or the inputs are not what this plant flies.
            Impact: A vehicle or the chief meets the Earth.
        """
        validate_propagation(x, u, dt, substeps, axes=3)
        air = self._forces.broadcast_ballistic_coefficients(self.ballistic_coefficient, len(x))
        here = np.flatnonzero(is_present(x))
        chief = self._chief_state(t)
        offset = self._lvlh(chief).to_offset(x[here])
        instants = np.linspace(0, dt, substeps + 1)[1:]
        air = None if air is None else air[here]
        flown = self._integrate(np.vstack([chief, offset]), t, instants, here, u[here], air)
        result = np.full((substeps + 1, *x.shape), np.nan)
        result[0] = x
        result[1:, here] = self._lvlh(flown[:, 0]).from_offset(flown[:, 1:])
        return result

    def chief_elements(self, t: float) -> Float[Array, " 6"]:
        """The six numbers of the chief's orbit at a time."""
        return to_polar_nodal(self._chief_state(t))

    def _chief_state(self, t: float) -> Array:
        """The chief's inertial state, always by way of the same instants."""
        if not 0 <= t < inf:
            raise ValueError(f"the chief's orbit is known from time 0 on, got t = {t} s")
        knots, count = self._checkpoints, int(t // CHECKPOINT_INTERVAL)
        while len(knots) <= count:
            knots.append(
                self._propagate_chief(
                    knots[-1], CHECKPOINT_INTERVAL * (len(knots) - 1), CHECKPOINT_INTERVAL
                )
            )
        left = t - CHECKPOINT_INTERVAL * count
        return (
            self._propagate_chief(knots[count], CHECKPOINT_INTERVAL * count, left)
            if left > 0
            else knots[count]
        )

    def _propagate_chief(self, chief: Array, t: float, dt: float) -> Array:
        nobody = np.array([], dtype=int)
        flown = self._integrate(chief[None], t, np.array([dt]), nobody, np.zeros((0, 3)), None)
        return np.asarray(flown[0, 0])

    def _lvlh(self, chief: Array) -> LVLH:
        return LVLH.from_state(
            chief, self._forces.acceleration(chief, self._chief_drag_coefficient)
        )

    def _integrate(
        self,
        start: Array,
        t: float,
        times: Array,
        here: Array,
        push: Array,
        air: Array | None,
    ) -> Array:
        """The chief and the offsets of those who are here, at times after t."""
        size = np.linalg.norm(start[0].reshape(2, 3), axis=1).repeat(3)
        offsets = np.tile(OFFSET_ATOL / np.sqrt(len(start)), (len(here), 1))
        allowed = np.vstack([RTOL * size, offsets])

        def rate(t: float, y: Array) -> Array:
            now = y.reshape(-1, 6)
            chief, offset = now[0], now[1:]
            moved = np.empty_like(now)
            moved[:, :3] = now[:, 3:]
            moved[0, 3:] = self._forces.acceleration(chief, self._chief_drag_coefficient)
            if len(here):
                pull = self._forces.differential_acceleration(
                    chief, offset, air, self.chief_ballistic_coefficient
                )
                moved[1:, 3:] = pull + push @ orbit_axes(chief)
            return moved.ravel()

        def radii(y: Array) -> Array:
            now = y.reshape(-1, 6)[:, :3]
            now = np.vstack([now[:1], now[0] + now[1:]])
            return np.asarray(np.linalg.norm(now, axis=1))

        flown = integrate_orbits(
            rate,
            start.ravel(),
            times,
            rtol=RTOL,
            atol=allowed.ravel(),
            radii=radii,
            agents=np.concatenate([[-1], here]),
            t0=t,
            first_step=min(float(times[-1]), FIRST_STEP),
        )
        return flown.reshape(len(times), -1, 6)

    @cached_property
    def _forces(self) -> Forces:
        return Forces(self.chief_orbit.mu, self.chief_orbit.k_J2, self.atmosphere)

    @cached_property
    def _chief_drag_coefficient(self) -> float | None:
        return None if self.atmosphere is None else self.chief_ballistic_coefficient

    @cached_property
    def _checkpoints(self) -> list[Array]:
        # Grows as later times are asked for; what it holds depends on nothing else.
        return [inertial_state(np.array(self.chief_orbit.initial_elements))]
