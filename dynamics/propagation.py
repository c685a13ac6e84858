"""Many spacecraft in inertial space, in one integration that is accurate for each."""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.integrate import solve_ivp

from dynamics.coordinate_frames import radius_and_momentum
from dynamics.forces import Forces
from dynamics.orbit import EARTH_RADIUS

MIN_RTOL = 2.3e-14  # below, SciPy takes this and warns
MAX_ECCENTRICITY = 0.95  # for which `propagate` keeps its promise

DEFAULT_FORCES = Forces()  # two bodies and J2


class Impact(RuntimeError):
    """A vehicle meets the Earth."""

    def __init__(self, vehicle: int, time: float) -> None:
        """Name the vehicle, −1 for the chief, and when it happens [s]."""
        who = f"vehicle {vehicle}" if vehicle >= 0 else "the chief"
        super().__init__(
            f"{who} meets the Earth at t = {time:.6g} s: raise the perigee above "
            f"{EARTH_RADIUS / 1e3:.0f} km from the centre, or end before"
        )
        self.agent = vehicle
        self.time = time


def propagate(
    state: Float[Array, "agents 6"],
    times: Float[Array, " instants"],
    forces: Forces = DEFAULT_FORCES,
    ballistic: float | Float[Array, " each"] | None = None,
    accuracy: float = 1e-9,
) -> Float[Array, "instants agents 6"]:
    """Fly many spacecraft at once without thrust, all in one integration.

    Args:
        state: Inertial positions and velocities at time 0 [m, m/s].
        times: At which states are wanted, increasing from 0 or later [s].
        forces: What pulls at them; two bodies and J2 if nothing is said.
        ballistic: Coefficient C_D A/m of all or of each, where there is an atmosphere [m²/kg].
        accuracy: Largest error of any one spacecraft after an orbit, as a fraction of its
            distance from the Earth's centre. Later it grows with the square of the orbits.

    Raises:
        ValueError: Times do not increase, a spacecraft begins inside the Earth, or drag
            lacks ballistic coefficients.
        Impact: A spacecraft meets the Earth.
    """
    _validate_initial_states(state, times, accuracy)
    air = forces.broadcast_ballistic_coefficients(ballistic, len(state))

    def rate(t: float, y: Array) -> Array:
        now = y.reshape(-1, 6)
        return np.hstack([now[:, 3:], forces.acceleration(now, air)]).ravel()

    flown = integrate_orbits(
        rate,
        state.ravel(),
        times,
        rtol=MIN_RTOL,
        atol=_absolute_tolerances(state, accuracy, forces.mu).ravel(),
        radii=lambda y: np.asarray(np.linalg.norm(y.reshape(-1, 6)[:, :3], axis=1)),
        agents=np.arange(len(state)),
    )
    return flown.reshape(len(times), -1, 6)


@dataclass(frozen=True)
class _ImpactEvent:
    """An event, in the words of SciPy: someone's radius is that of the Earth."""

    radii: Callable[[Array], Array]
    terminal: ClassVar[bool] = True

    def __call__(self, t: float, y: Array) -> float:
        return float(self.radii(y).min()) - EARTH_RADIUS


def integrate_orbits(
    rate: Callable[[float, Array], Array],
    y0: Array,
    times: Array,
    rtol: float,
    atol: Array,
    radii: Callable[[Array], Array],
    agents: Array,
    t0: float = 0.0,
    first_step: float | None = None,
) -> Array:
    """States at times after the start, by the method of Dormand and Prince of order eight.

    Args:
        rate: (t, y) ↦ ẏ.
        start: y at time 0.
        times: At which states are wanted [s].
        rtol: Error allowed in a step, of what an entry of y is,
        atol: and of each entry besides. The root mean square over all entries keeps to it.
        radii: y ↦ everyone's distance from the Earth's centre [m].
        names: What an `Impact` calls them,
        begin: and what it takes for time 0 [s].
        first: Length of the first step [s], or None to leave it to the integrator.

    Raises:
        Impact: Someone meets the Earth.
        RuntimeError: The integrator gives up.
    """
    ground = _ImpactEvent(radii)
    found = solve_ivp(
        rate,
        (0.0, float(times[-1])),
        y0,
        method="DOP853",
        t_eval=times,
        events=ground,
        rtol=rtol,
        atol=atol,
        first_step=first_step,
    )
    if found.status == 1:
        lowest = np.argmin(radii(found.y_events[0][0]))
        raise Impact(int(agents[lowest]), t0 + float(found.t_events[0][0]))
    if not found.success:
        raise RuntimeError(f"the flight cannot be integrated: {found.message}")
    return np.asarray(found.y.T)


def _absolute_tolerances(state: Array, accuracy: float, mu: float) -> Array:
    """Errors allowed in a step, for each vehicle to be as accurate as asked an orbit later.

    An error of the semi-major axis moves a vehicle along its orbit by 3π δa an orbit, and
    the faster the lower its perigee; near there an axis is also the most easily wrong:

        δr/r = 3π √(1 + e)/(1 − e)^(3/2) δa/a,    δa/a = 2a δr/r² = 2a v δv/μ

    The integrator bounds the root mean square over all vehicles; divided by the root of
    their number it bounds each.
    """
    r, h = radius_and_momentum(state)
    energy = (state[:, 3:] ** 2).sum(axis=1) / 2 - mu / r
    e = np.sqrt(np.maximum(0, 1 + 2 * energy * (h / mu) ** 2))
    perigee = h**2 / mu / (1 + e)
    e = np.minimum(e, MAX_ECCENTRICITY)
    axis = accuracy / (3 * pi) * (1 - e) ** 1.5 / np.sqrt(1 + e) / np.sqrt(max(1, len(r)))
    size = np.stack([perigee, mu / h], axis=1) * ((1 - e) / 2 * axis)[:, None]
    return np.asarray(size.repeat(3, axis=1))


def _validate_initial_states(state: Array, times: Array, accuracy: float) -> None:
    if len(times) == 0 or not (
        np.isfinite(times).all() and times[0] >= 0 and (np.diff(times) > 0).all()
    ):
        raise ValueError(f"times increase from 0 or later, got {times}")
    if not 1e-13 <= accuracy <= 1e-3:
        raise ValueError(f"an accuracy lies between 1e-13 and 1e-3, got {accuracy}")
    if not np.isfinite(state).all():
        raise ValueError(f"vehicle {np.argmin(np.isfinite(state).all(axis=1))} has no finite state")
    r = np.linalg.norm(state[:, :3], axis=1)
    if len(r) and r.min() <= EARTH_RADIUS:
        raise ValueError(
            f"vehicle {np.argmin(r)} begins inside the Earth, {r.min() / 1e3:.6g} km from its "
            "centre; states are in metres"
        )
