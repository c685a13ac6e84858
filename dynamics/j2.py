"""Exact nonlinear relative motion under two-body gravity and J2 [Xu2008; Morgan2016, Sec. VI.B].

Axes (LVLH of the chief's osculating orbit): x radial, y transverse, z normal. Velocities
are relative to these axes, which rotate with ω = (ω_x, 0, ω_z).
"""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array

from dynamics.callbacks import freeze
from dynamics.doors import checked
from dynamics.model import Controls, Jacobian, NonlinearModel, Rates, States, Times
from dynamics.orbit import Orbit, Scalars, Vectors, lvlh_rates
from dynamics.symbols import Numbers

X_AXIS = np.array([1.0, 0.0, 0.0])
SLOW_NODES = 5e-5  # along-track drift of other inclinations in an orbit, as a part of z
MIN_COS_LATITUDE = 0.02  # of the argument of latitude, for positions with z ≠ 0


@checked
@dataclass(frozen=True)
class J2(NonlinearModel):
    """Motion relative to a chief, both under two-body gravity and J2.

        l̈ = −2 ω × l̇ − α × l − ω × (ω × l) + g(R) − g(r x̂) + u,    R = r x̂ + l

    with g the gravity of the oblate body. Exact at any separation; other forces are left
    out. With k_J2 = 0 it is Keplerian relative motion.

    Args:
        orbit: Orbit of the chief.
    """

    orbit: Orbit
    axes: int = field(default=3, init=False, repr=False)

    def rate(self, t: Times, x: States, u: Controls) -> Rates:
        """Return the rate of change of one state or of many."""
        axes = _axes_at(self.orbit, t)
        g = gravity_acceleration(x[..., :3] + axes.chief, axes.pole, self.orbit)
        a = g - axes.gravity + u + _matvec(axes.apparent, x)
        change = np.empty((*a.shape[:-1], 6), a.dtype)
        change[..., :3], change[..., 3:] = x[..., 3:], a
        return change

    def jacobian(self, t: Times, x: States, u: Controls) -> Jacobian:
        """Return ∂f/∂x and ∂f/∂u."""
        axes = _axes_at(self.orbit, t)
        gradient = gravity_gradient(x[..., :3] + axes.chief, axes.pole, self.orbit)
        B = np.zeros((*gradient.shape[:-2], 6, 3))
        A = np.zeros((*gradient.shape[:-2], 6, 6), gradient.dtype)
        A[..., :3, 3:] = B[..., 3:, :] = np.eye(3)
        A[..., 3:, :] = axes.apparent
        A[..., 3:, :3] += gradient
        return A, B


class _Axes(NamedTuple):
    """The chief and its LVLH axes, at one time or at many."""

    chief: Array  # r x̂, from the center of the body
    pole: Array  # unit vector along the body's axis
    apparent: Array  # −[[α]× + [ω]×², 2 [ω]×], which takes a state to apparent accelerations
    gravity: Array  # of the chief


def _axes_at(orbit: Orbit, t: Times) -> _Axes:
    times = np.asarray(t)
    if times.dtype == object:
        return _compute_axes(orbit, times)
    return _fixed_axes(orbit, times.astype(float).tobytes(), times.shape)


@lru_cache(maxsize=2048)  # motion is integrated, and linearized, at the same times again and again
def _fixed_axes(orbit: Orbit, times: bytes, shape: tuple[int, ...]) -> _Axes:
    return freeze(_compute_axes(orbit, np.frombuffer(times).reshape(shape)))


def _compute_axes(orbit: Orbit, times: Array) -> _Axes:
    elements = orbit.elements_at(times)
    chief, pole = elements[..., :1] * X_AXIS, _body_axis(elements)
    rates = lvlh_rates(elements, orbit.k_J2)
    omega = _cross_matrix(rates.omega_x, rates.omega_z)
    alpha = _cross_matrix(rates.alpha_x, rates.alpha_z)
    apparent = -np.concatenate([alpha + omega @ omega, 2 * omega], axis=-1)
    return _Axes(chief, pole, apparent, gravity_acceleration(chief, pole, orbit))


def gravity_acceleration(R: Vectors, pole: Vectors, orbit: Orbit) -> Vectors:
    """Return the gravity of the oblate body, g = −η² R − ζ s [m/s²].

    R leads from the center of the body, in any axes [m]; the pole s is a unit vector there.
    """
    rho2, Z = _dot(R, R), _dot(R, pole)
    rho3 = rho2 * np.sqrt(rho2)
    share = orbit.k_J2 / (rho2 * rho3)
    eta2 = orbit.mu / rho3 + share * (1 - 5 * Z * Z / rho2)
    return np.asarray(-eta2 * R - 2 * share * Z * pole)


def gravity_gradient(R: Vectors, pole: Vectors, orbit: Orbit) -> Numbers[Array, "... 3 3"]:
    """Return ∂g/∂R [1/s²] of `gravity_acceleration`."""
    rho2, Z = _dot(R, R), _dot(R, pole)
    rho3 = rho2 * np.sqrt(rho2)
    share, q = orbit.k_J2 / (rho2 * rho3), Z * Z / rho2
    eta2 = orbit.mu / rho3 + share * (1 - 5 * q)
    along = (3 * orbit.mu / rho3 + 5 * share * (1 - 7 * q)) / rho2
    across = 10 * share * Z / rho2
    # −η² I + R aᵀ + s bᵀ
    a, b = along * R + across * pole, across * R - 2 * share * pole
    gradient = R[..., :, None] * a[..., None, :] + pole[..., :, None] * b[..., None, :]
    return np.asarray(gradient - eta2[..., None] * np.eye(3))


@checked
def invariant_velocity(orbit: Orbit, position: Vectors, t: float = 0.0) -> Vectors:
    """Return the velocity of a J2-invariant relative orbit through a position [m/s].

        ẋ = ω_z y / 2              a 2:1 ellipse centered on a chief in circular orbit
        ż = (v_x/r − ω_z tan θ) z  no difference in inclination, so that nodes drift alike
        ẏ                          the energy of the chief, J2 included

    Where nodes hardly drift apart, 8π |k_J2| sin i / μp² < 5e-5 with p = h²/μ (near the equator:
    below 0.08° at 500 km, 3.1° in geostationary orbit), ż = v_x z/r instead: the angle out of the
    plane is then largest at this position, and no latitude is refused.

    [Morgan2012] removes the drift of the linear equations, of the nonlinear ones and of J2
    one after the other; here the exact energy removes all three at once. About a circular
    chief an along-track drift of a few centimeters an orbit is left at a distance of a
    kilometer; about an ellipse, whose perigees turn at different rates, up to a meter.

    Args:
        orbit: Orbit of the chief.
        position: Relative to the chief, in LVLH axes [m].
        t: Time at that position [s].

    Raises:
        ValueError: A position has z ≠ 0 while the chief is near |θ| = 90° on an inclined orbit,
            where no velocity gives equal inclinations, or is too far away for equal energies.
    """
    chief = orbit.elements_at(t)
    r, v_x, h, _, inclination, theta = chief
    p = h**2 / orbit.mu
    drift = 8 * np.pi * abs(orbit.k_J2) * np.sin(inclination) / (orbit.mu * p**2)
    slope = np.tan(theta) if drift > SLOW_NODES else 0.0
    x, y, z = np.moveaxis(position, -1, 0)
    rates = lvlh_rates(chief, orbit.k_J2)
    out_of_plane = np.abs(z) > 1e-9 * r
    if slope and out_of_plane.any() and abs(np.cos(theta)) < MIN_COS_LATITUDE:
        raise ValueError(
            f"the chief is at argument of latitude {np.degrees(theta) % 360:.4g}°, and within "
            f"{np.degrees(np.arcsin(MIN_COS_LATITUDE)):.2g}° of 90° and 270° no orbit through a "
            "position with z ≠ 0 stays near it; start at another latitude, or in the plane (z = 0)"
        )
    v = np.zeros(position.shape)
    v[..., 0] = rates.omega_z * y / 2
    v[..., 2] = np.where(out_of_plane, (v_x / r - rates.omega_z * slope) * z, 0.0)
    pole, center = _body_axis(chief), r * X_AXIS
    energy = (v_x**2 + (h / r) ** 2) / 2 + _potential(center, pole, orbit)
    speed2 = 2 * (energy - _potential(position + center, pole, orbit))
    radial = v_x + v[..., 0] - rates.omega_z * y
    normal = v[..., 2] + rates.omega_x * y
    if ((left := speed2 - radial**2 - normal**2) < 0).any():
        farthest = float(np.sqrt((position * position).sum(axis=-1)).max())
        reason = f"no orbit through it, {farthest:.6g} m away, has the energy of the chief"
        raise ValueError(f"position: {reason}; positions relative to the chief would do")
    transverse = np.sqrt(left)
    v[..., 1] = transverse - rates.omega_z * x + rates.omega_x * z - h / r
    return v


def _potential(R: Array, pole: Array, orbit: Orbit) -> Array:
    rho = np.linalg.norm(R, axis=-1)
    Z = (R * pole).sum(axis=-1)
    return np.asarray(-orbit.mu / rho - orbit.k_J2 / rho**3 * (1 / 3 - (Z / rho) ** 2))


def _body_axis(chief: Array) -> Array:
    """Return the unit vector along the body's axis in LVLH axes."""
    i, theta = chief[..., 4], chief[..., 5]
    return np.stack([np.sin(i) * np.sin(theta), np.sin(i) * np.cos(theta), np.cos(i)], axis=-1)


def _cross_matrix(a: Scalars, c: Scalars) -> Array:
    """Return the matrix of the cross product with (a, 0, c)."""
    zero = np.zeros_like(a)
    rows = [[zero, -c, zero], [c, zero, -a], [zero, a, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _dot(a: Array, b: Array) -> Array:
    """Return a·b along the last axis, which is kept."""
    if a.dtype == b.dtype == float:
        return np.asarray(np.vecdot(a, b))[..., None]
    return np.asarray((a * b).sum(axis=-1, keepdims=True))  # of symbols, or complex


def _matvec(matrix: Array, vector: Array) -> Array:
    if matrix.ndim == 2:
        return np.asarray(vector @ matrix.T)
    return np.asarray(np.einsum("...ab,...b->...a", matrix, vector))
