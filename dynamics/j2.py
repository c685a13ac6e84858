"""Relative motion under the Earth's oblateness, exactly [Xu2008; Morgan2016, Sec. VI.B].

Axes: x radially out, y along the orbit, z along its normal, of the chief's osculating
orbit. Velocities are those seen in this frame, which turns with ω = (ω_x, 0, ω_z).
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.integrate import solve_ivp

from dynamics.model import NonlinearModel
from dynamics.orbit import Orbit, lvlh_rates, polar_nodal_rates, polar_nodal_scales

RTOL = 1e-13  # of `J2.propagate`: below a micrometre an orbit later
ATOL = np.repeat([1e-9, 1e-12], 3)  # in a step, of any one [m, m/s]
MIN_COS_LATITUDE = 0.02  # of the argument of latitude, for spacecraft out of the chief's plane


@dataclass(frozen=True)
class J2(NonlinearModel):
    """Motion relative to a chief, both under two bodies and J2.

        l̈ = −2 ω × l̇ − α × l − ω × (ω × l) + g(R) − g(r x̂) + u,    R = r x̂ + l

    with g the attraction of the oblate Earth. Exact at any separation: only forces other
    than these are left out. With k_J2 = 0 it is Kepler's relative motion.
    """

    orbit: Orbit
    axes: int = field(default=3, init=False, repr=False)

    def rate(
        self, t: float | Float[Array, "*#k"], x: Float[Array, "*#k 6"], u: Float[Array, "*#k 3"]
    ) -> Float[Array, "... 6"]:
        """Rate of change of the state, of one or of many."""
        return self._rate(self.orbit.elements_at(t), x, u)

    def jacobian(
        self, t: float | Float[Array, "*#k"], x: Float[Array, "*#k 6"], u: Float[Array, "*#k 3"]
    ) -> tuple[Float[Array, "... 6 6"], Float[Array, "... 6 3"]]:
        """∂f/∂x and ∂f/∂u."""
        chief = self.orbit.elements_at(t)
        turn, turning = _rotation_matrices(chief, self.orbit)
        pull = gravity_gradient(
            _from_earth_center(chief, x[..., :3]), _earth_axis(chief), self.orbit
        )
        B = np.zeros((*pull.shape[:-2], 6, 3))
        A = np.zeros((*pull.shape[:-2], 6, 6))
        A[..., :3, 3:] = B[..., 3:, :] = np.eye(3)
        A[..., 3:, :3] = pull - turning
        A[..., 3:, 3:] = -2 * turn
        return A, B

    def propagate(
        self, x: Float[Array, "*k 6"], times: Float[Array, " instants"], start: float = 0.0
    ) -> Float[Array, "instants *k 6"]:
        """Free flight, integrated together with the chief.

        Args:
            x: States at `start`.
            times: At which states are wanted, in increasing order [s].
            start: When the flight begins [s].
        """
        lead = x.shape[:-1]

        def rate(t: float, y: Array) -> Array:
            chief, own = y[:6], y[6:].reshape(*lead, 6)
            moved = polar_nodal_rates(chief, self.orbit.mu, self.orbit.k_J2)
            return np.concatenate([moved, self._rate(chief, own, np.zeros(3)).ravel()])

        y = np.concatenate([self.orbit.elements_at(start), x.ravel()])
        allowed = np.concatenate(
            [RTOL * polar_nodal_scales(y[:6]), np.tile(ATOL, x.size // 6) / (x.size // 6) ** 0.5]
        )
        flown = np.empty((len(times), x.size))
        # From instant to instant: what lies between is known to a lower order only.
        for k, (before, after) in enumerate(zip([start, *times[:-1]], times, strict=True)):
            if after > before:
                span = (float(before), float(after))
                y = solve_ivp(rate, span, y, method="DOP853", rtol=RTOL, atol=allowed).y[:, -1]
            flown[k] = y[6:]
        return flown.reshape(len(times), *lead, 6)

    def _rate(self, chief: Array, x: Array, u: Array) -> Array:
        turn, turning = _rotation_matrices(chief, self.orbit)
        pole = _earth_axis(chief)
        l, v = x[..., :3], x[..., 3:]  # noqa: E741
        pull = gravity_acceleration(_from_earth_center(chief, l), pole, self.orbit)
        pull = pull - gravity_acceleration(_from_earth_center(chief, np.zeros(3)), pole, self.orbit)
        a = pull + u - _matvec(turning, l) - 2 * _matvec(turn, v)
        return np.concatenate([np.broadcast_to(v, a.shape), a], axis=-1)


def gravity_acceleration(
    R: Float[Array, "*#k 3"], pole: Float[Array, "*#k 3"], orbit: Orbit
) -> Float[Array, "... 3"]:
    """Attraction of the oblate Earth at R from its centre, g = −η² R − ζ s [m/s²].

    Args:
        R: Place, in any axes [m].
        pole: s, the unit vector along the Earth's axis, in the same axes.
        orbit: Whose gravity it is.
    """
    mu, k = orbit.mu, orbit.k_J2
    rho2 = (R * R).sum(axis=-1, keepdims=True)
    rho, Z = np.sqrt(rho2), (R * pole).sum(axis=-1, keepdims=True)
    eta2 = mu / (rho * rho2) + k / (rho * rho2**2) * (1 - 5 * Z**2 / rho2)
    return np.asarray(-eta2 * R - 2 * k * Z / (rho * rho2**2) * pole)


def gravity_gradient(
    R: Float[Array, "*#k 3"], pole: Float[Array, "*#k 3"], orbit: Orbit
) -> Float[Array, "... 3 3"]:
    """∂g/∂R [1/s²], see `gravity`."""
    mu, k = orbit.mu, orbit.k_J2
    R, pole = np.broadcast_arrays(R, pole)
    rho = np.linalg.norm(R, axis=-1)[..., None, None]
    Z = (R * pole).sum(axis=-1)[..., None, None]
    eta2 = mu / rho**3 + k / rho**5 - 5 * k * Z**2 / rho**7
    along = 3 * mu / rho**5 + 5 * k / rho**7 - 35 * k * Z**2 / rho**9
    RR, Rs, ss = (a[..., :, None] * b[..., None, :] for a, b in ((R, R), (R, pole), (pole, pole)))
    cross = 10 * k * Z / rho**7 * (Rs + np.swapaxes(Rs, -1, -2))
    return np.asarray(-eta2 * np.eye(3) + along * RR + cross - 2 * k / rho**5 * ss)


def invariant_velocity(
    orbit: Orbit, position: Float[Array, "*k 3"], t: float = 0.0
) -> Float[Array, "*k 3"]:
    """Velocity with which a spacecraft stays near the chief under J2, without thrust [m/s].

        ẋ = ω_z y / 2             on a centred 2:1 ellipse about a circular chief
        ż = (v_x/r − ω_z tan θ) z no difference in inclination, so nodes drift alike
        ẏ: the same energy as the chief's, J2 included

    [Morgan2012] does away with the drift of the linear equations, then with that of the
    nonlinear ones, then with what J2 adds; the recipe here is another, in which the exact
    energy does all three. Along the orbit it leaves a few centimetres an orbit at a kilometre,
    about a circular chief; about an ellipse, perigees that turn unlike leave up to a metre.

    Args:
        orbit: The chief's.
        position: Relative to the chief, in its frame [m].
        t: When it is there [s].

    Raises:
        ValueError: A point out of the plane when the chief is near |θ| = 90°, where no
            velocity does it.
    """
    chief = orbit.elements_at(t)
    r, v_x, h, _, _, theta = chief
    x, y, z = np.moveaxis(position, -1, 0)
    rates = lvlh_rates(chief, orbit.k_J2)
    out = np.abs(z) > 1e-9 * r
    if out.any() and abs(np.cos(theta)) < MIN_COS_LATITUDE:
        raise ValueError(
            f"the chief is at argument of latitude {np.degrees(theta) % 360:.4g}°, and out of its "
            "plane nothing stays near it unless it crosses the plane within "
            f"{np.degrees(np.arcsin(MIN_COS_LATITUDE)):.2g}° of 90° and 270°; start at another "
            "latitude, or in the plane (z = 0)"
        )
    v = np.zeros(position.shape)
    v[..., 0] = rates.omega_z * y / 2
    v[..., 2] = np.where(out, (v_x / r - rates.omega_z * np.tan(theta)) * z, 0.0)
    pole = _earth_axis(chief)
    energy = (v_x**2 + (h / r) ** 2) / 2 + _potential(
        _from_earth_center(chief, np.zeros(3)), pole, orbit
    )
    left = 2 * (energy - _potential(_from_earth_center(chief, position), pole, orbit))
    radial = v_x + v[..., 0] - rates.omega_z * y
    normal = v[..., 2] + rates.omega_x * y
    transverse = np.sqrt(left - radial**2 - normal**2)
    v[..., 1] = transverse - rates.omega_z * x + rates.omega_x * z - h / r
    return v


def _potential(R: Array, pole: Array, orbit: Orbit) -> Array:
    rho = np.linalg.norm(R, axis=-1)
    Z = (R * pole).sum(axis=-1)
    return np.asarray(-orbit.mu / rho - orbit.k_J2 / rho**3 * (1 / 3 - (Z / rho) ** 2))


def _from_earth_center(chief: Array, l: Array) -> Array:  # noqa: E741
    return np.asarray(l + chief[..., :1] * np.array([1.0, 0.0, 0.0]))


def _earth_axis(chief: Array) -> Array:
    """The Earth's axis in the chief's frame."""
    i, theta = chief[..., 4], chief[..., 5]
    return np.stack([np.sin(i) * np.sin(theta), np.sin(i) * np.cos(theta), np.cos(i)], axis=-1)


def _rotation_matrices(chief: Array, orbit: Orbit) -> tuple[Array, Array]:
    """[ω]× and [α]× + [ω]×²."""
    rates = lvlh_rates(chief, orbit.k_J2)
    turn = _cross_matrix(rates.omega_x, rates.omega_z)
    return turn, _cross_matrix(rates.alpha_x, rates.alpha_z) + turn @ turn


def _cross_matrix(a: Float[Array, "*k"] | float, c: Float[Array, "*k"] | float) -> Array:
    """The matrix of a cross product with (a, 0, c)."""
    zero = np.zeros_like(a)
    return np.stack(
        [
            np.stack([zero, -c, zero], axis=-1),
            np.stack([c, zero, -a], axis=-1),
            np.stack([zero, a, zero], axis=-1),
        ],
        axis=-2,
    )


def _matvec(matrix: Array, vector: Array) -> Array:
    return np.asarray(np.einsum("...ab,...b->...a", matrix, vector))
