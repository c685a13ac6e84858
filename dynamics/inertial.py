"""Plant in inertial space: two-body gravity, J2, drag and thrust.

It shares no equation with the relative motion of `dynamics.j2`, so that each verifies the
other.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.atmosphere import Atmosphere
from dynamics.coordinate_frames import LVLH, inertial_state, orbit_axes, to_polar_nodal
from dynamics.doors import checked
from dynamics.forces import Forces
from dynamics.inputs import InputError
from dynamics.model import Controls, States
from dynamics.orbit import MAX_TIME, Orbit
from dynamics.plant import Plant, Samples, is_present, validate_propagation
from dynamics.propagation import integrate_orbits
from dynamics.units import Unit

CHECKPOINT_INTERVAL = 60.0  # the chief's state is cached at multiples of this [s]
FIRST_STEP = 60.0  # first step to try, small enough for low orbits [s]
AREA_PER_MASS = Unit("m2_kg")
RTOL = 1e-13  # of a step, for the chief's state and for offsets from it, and in addition
OFFSET_ATOL = np.repeat([1e-10, 1e-13], 3)  # for offsets [m, m/s]


@checked
@dataclass(frozen=True, eq=False)
class InertialPlant(Plant):
    """Agents and their chief in inertial space, integrated together.

    The chief moves under the same forces, without thrust. The offsets of the agents from it
    are integrated, so that no digits are lost to the radius of the orbit. Thrust is constant
    in LVLH axes while it is held.

    Args:
        chief_orbit: Orbit of the chief at time 0, with the gravity of the body.
        ballistic_coefficient: C_D A/m of all agents or of each [m²/kg].
        chief_ballistic_coefficient: That of the chief [m²/kg].
        atmosphere: None is no drag.

    Raises:
        ValueError: An atmosphere without both ballistic coefficients, or nonzero ones
            without an atmosphere, or an atmosphere about another body than the Earth.
    """

    chief_orbit: Orbit = field()  # required: without this, the default of `Plant` would hold
    ballistic_coefficient: Annotated[float | Float[Array, " agents"] | None, AREA_PER_MASS] = None
    chief_ballistic_coefficient: Annotated[float | None, AREA_PER_MASS] = None
    atmosphere: Atmosphere | None = None

    def __post_init__(self) -> None:
        """Check the ballistic coefficients."""
        self._forces.validate_ballistic_coefficients(self.ballistic_coefficient)
        self._forces.validate_ballistic_coefficients(self.chief_ballistic_coefficient)

    def propagate(self, x: States, u: Controls, t: float, dt: float, substeps: int = 1) -> Samples:
        """Return the states at equal instants from t to t + dt, the first of them x itself.

        Raises:
            ValueError: Shapes, controls or times do not fit this plant.
            Impact: An agent or the chief hits the body.
        """
        validate_propagation(x, u, dt, substeps, axes=3)
        drag = self._forces.broadcast_ballistic_coefficients(self.ballistic_coefficient, len(x))
        present = np.flatnonzero(is_present(x))
        chief = self._chief_state(t)
        start = np.vstack([chief, self._lvlh(chief).to_offset(x[present])])
        instants = np.linspace(0, dt, substeps + 1)[1:]
        path = self._integrate(start, t, instants, present, u[present], drag[present])
        states = np.full((substeps + 1, *x.shape), np.nan)
        states[0] = x
        states[1:, present] = self._lvlh(path[:, 0]).from_offset(path[:, 1:])
        return states

    def chief_elements(self, t: float) -> Float[Array, " 6"]:
        """Return r [m], v_x [m/s], h [m²/s], Ω, i and θ [rad] of the chief."""
        return to_polar_nodal(self._chief_state(t))

    def _chief_state(self, t: float) -> Array:
        # Always by way of the same checkpoints, so that a time has one state, bit for bit.
        if not 0 <= t <= MAX_TIME:
            known = f"the chief's orbit is known from time 0 on, to {MAX_TIME:.0e} s"
            raise InputError("t", f"{known}, got t = {t} s")
        states, count = self._checkpoints, int(t // CHECKPOINT_INTERVAL)
        while len(states) <= count:
            start = CHECKPOINT_INTERVAL * (len(states) - 1)
            states.append(self._propagate_chief(states[-1], start, CHECKPOINT_INTERVAL))
        start, chief = CHECKPOINT_INTERVAL * count, states[count]
        return self._propagate_chief(chief, start, t - start) if t > start else chief

    def _propagate_chief(self, chief: Array, t: float, dt: float) -> Array:
        none = np.array([], dtype=int)
        path = self._integrate(chief[None], t, np.array([dt]), none, np.zeros((0, 3)), np.zeros(0))
        return np.asarray(path[0, 0])

    def _lvlh(self, chief: Array) -> LVLH:
        return LVLH.from_state(chief, self._forces.acceleration(chief, self._chief_drag))

    def _integrate(
        self, start: Array, t: float, times: Array, present: Array, thrust: Array, drag: Array
    ) -> Array:
        """Return the chief's state and the offsets of present agents at times after t."""
        scale = np.linalg.norm(start[0].reshape(2, 3), axis=1).repeat(3)
        offset_atol = np.tile(OFFSET_ATOL / np.sqrt(len(start)), (len(present), 1))
        atol = np.vstack([RTOL * scale, offset_atol])

        def rate(t: float, y: Array) -> Array:
            now = y.reshape(-1, 6)
            chief, offset = now[0], now[1:]
            change = np.empty_like(now)
            change[:, :3] = now[:, 3:]
            change[0, 3:] = self._forces.acceleration(chief, self._chief_drag)
            if len(present):
                drags = drag, self._chief_drag
                acceleration = self._forces.differential_acceleration(chief, offset, *drags)
                change[1:, 3:] = acceleration + thrust @ orbit_axes(chief)
            return change.ravel()

        def radii(y: Array) -> Array:
            now = y.reshape(-1, 6)[:, :3]
            now = np.vstack([now[:1], now[0] + now[1:]])
            return np.asarray(np.linalg.norm(now, axis=1))

        y, agents = start.ravel(), np.concatenate([[-1], present])
        tolerances, first_step = (RTOL, atol.ravel()), min(float(times[-1]), FIRST_STEP)
        path = integrate_orbits(
            rate, y, times, *tolerances, radii, agents, self._forces, t, first_step
        )
        return path.reshape(len(times), -1, 6)

    @cached_property
    def _forces(self) -> Forces:
        orbit = self.chief_orbit
        return Forces(orbit.mu, orbit.k_J2, self.atmosphere, orbit.body_radius)

    @property
    def _chief_drag(self) -> float:
        return self.chief_ballistic_coefficient or 0.0

    @cached_property
    def _checkpoints(self) -> list[Array]:
        # Extended on demand; its entries do not depend on the order of the calls.
        return [inertial_state(np.array(self.chief_orbit.initial_elements))]
