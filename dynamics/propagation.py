"""Propagation of many agents in inertial space, with an accuracy that holds for each."""

from collections.abc import Callable
from math import pi
from typing import Annotated, Any

import numpy as np
import scipy
from annotated_types import Ge, Le
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.bodies import find_body
from dynamics.coordinate_frames import radius_and_momentum
from dynamics.doors import checked
from dynamics.forces import Forces

MIN_RTOL = 2.3e-14  # SciPy replaces smaller values by this one, with a warning
MAX_ECCENTRICITY = 0.95  # the accuracy of `propagate` holds up to this

DEFAULT_FORCES = Forces()  # two-body gravity and J2


class Impact(RuntimeError):
    """Collision of an agent or of the chief with the body that they go about."""

    def __init__(self, agent: int, time: float, forces: Forces = DEFAULT_FORCES) -> None:
        """Describe the impact of an agent, −1 for the chief, at a time [s]."""
        name = f"agent {agent}" if agent >= 0 else "the chief"
        cure = f"above {forces.body_radius / 1e3:.0f} km from the center, or end before"
        hit = f"{name} hits {find_body(forces.mu).name} at t = {time:.6g} s"
        super().__init__(f"{hit}: raise the perigee {cure}")
        self.agent, self.time, self.forces = agent, time, forces

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how a copy is made."""
        return type(self), (self.agent, self.time, self.forces)


@checked
def propagate(
    state: Float[Array, "agents 6"],
    times: Float[Array, " instants"],
    forces: Forces = DEFAULT_FORCES,
    ballistic_coefficient: float | Float[Array, " each"] | None = None,
    accuracy: Annotated[float, Ge(1e-13), Le(1e-3)] = 1e-9,
) -> Float[Array, "instants agents 6"]:
    """Propagate many agents without thrust, all in one integration.

    Args:
        state: Inertial positions and velocities at time 0 [m, m/s].
        times: Times of the states to return, increasing from 0 or later [s].
        forces: Forces on the agents.
        ballistic_coefficient: C_D A/m of all or of each, where there is an atmosphere [m²/kg].
        accuracy: Largest error of any agent after an orbit, as a fraction of its distance
            from the center. It grows with the square of the number of orbits.

    Raises:
        ValueError: Times do not increase, an agent starts inside the body, or drag lacks
            ballistic coefficients.
        Impact: An agent hits the body.
    """
    _validate_initial_states(state, times, forces)
    drag = forces.broadcast_ballistic_coefficients(ballistic_coefficient, len(state))
    if not len(state):
        return np.empty((len(times), 0, 6))

    def rate(t: float, y: Array) -> Array:
        now = y.reshape(-1, 6)
        return np.hstack([now[:, 3:], forces.acceleration(now, drag)]).ravel()

    def radii(y: Array) -> Array:
        return np.asarray(np.linalg.norm(y.reshape(-1, 6)[:, :3], axis=1))

    y, atol = state.ravel(), _absolute_tolerances(state, accuracy, forces.mu).ravel()
    path = integrate_orbits(rate, y, times, MIN_RTOL, atol, radii, np.arange(len(state)), forces)
    return path.reshape(len(times), -1, 6)


def integrate_orbits(
    rate: Callable[[float, Array], Array],
    y0: Array,
    times: Array,
    rtol: float,
    atol: Array,
    radii: Callable[[Array], Array],
    agents: Array,
    forces: Forces,
    t0: float = 0.0,
    first_step: float | None = None,
) -> Array:
    """Integrate by the Dormand–Prince method of order eight, until an impact.

    Args:
        rate: (t, y) ↦ ẏ, with t counted from the initial time.
        y0: Initial y.
        times: Times of the values to return, counted from the initial time [s].
        rtol: Error tolerance of a step relative to each entry of y.
        atol: Absolute tolerance in addition; the integrator bounds the root mean square of
            the errors over all entries.
        radii: y ↦ distances from the center [m].
        agents: Index of each distance in an `Impact`.
        forces: Forces, of which the radius of the body ends the integration.
        t0: Initial time, for an `Impact` [s].
        first_step: Length of the first step [s], or None to let the integrator choose.

    Raises:
        Impact: An agent hits the body.
        RuntimeError: The integrator fails.
    """

    def altitude(t: float, y: Array) -> float:
        return float(radii(y).min()) - forces.body_radius

    altitude.terminal = True  # type: ignore[attr-defined]  # as SciPy asks for
    settings = {"rtol": rtol, "atol": atol, "first_step": first_step, "events": altitude}
    if not times[-1]:  # the initial time alone
        return y0[None].copy()
    if altitude(0.0, y0) < 0:
        raise Impact(int(agents[np.argmin(radii(y0))]), t0, forces)
    span = 0.0, float(times[-1])
    solution = scipy.integrate.solve_ivp(rate, span, y0, "DOP853", times, **settings)
    if solution.status == 1:
        lowest = np.argmin(radii(solution.y_events[0][0]))
        raise Impact(int(agents[lowest]), t0 + float(solution.t_events[0][0]), forces)
    if not solution.success:
        raise RuntimeError(f"the orbits cannot be integrated: {solution.message}")
    return np.asarray(solution.y.T)


def _absolute_tolerances(state: Array, accuracy: float, mu: float) -> Array:
    """Return the tolerances of a step that give each agent its accuracy after an orbit.

    An error of the semi-major axis displaces an agent along its orbit by 3π δa an orbit,
    most at perigee, where the axis is also most sensitive to errors of the state:

        δr/r = 3π √(1 + e)/(1 − e)^(3/2) δa/a,    δa/a = 2a δr/r² = 2a v δv/μ

    The integrator bounds the root mean square over all agents; divided by the root of
    their number, the tolerance bounds each.
    """
    r, h = radius_and_momentum(state)
    energy = (state[:, 3:] ** 2).sum(axis=1) / 2 - mu / r
    e = np.sqrt(np.maximum(0, 1 + 2 * energy * (h / mu) ** 2))
    perigee = h**2 / mu / (1 + e)
    e = np.minimum(e, MAX_ECCENTRICITY)
    axis_error = accuracy / (3 * pi) * (1 - e) ** 1.5 / np.sqrt(1 + e) / np.sqrt(max(1, len(r)))
    errors = np.stack([perigee, mu / h], axis=1) * ((1 - e) / 2 * axis_error)[:, None]
    return np.asarray(errors.repeat(3, axis=1))


def _validate_initial_states(state: Array, times: Array, forces: Forces) -> None:
    if not (len(times) and times[0] >= 0 and (np.diff(times) > 0).all()):
        raise ValueError(f"times: must increase from 0 or later, got {times}")
    r = np.linalg.norm(state[:, :3], axis=1)
    if len(r) and r.min() <= forces.body_radius:
        reason = f"agent {np.argmin(r)} starts inside {find_body(forces.mu).name}"
        raise ValueError(f"{reason}, {r.min() / 1e3:.6g} km from its center; states are in meters")
