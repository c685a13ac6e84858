"""Inertial space and the frame of the chief.

The axes of the chief's frame, in all of this package (LVLH; also called RSW, RTN or Hill's):

    x  radially out, from the Earth's centre to the chief
    y  transverse: in the plane of the orbit, square to x, towards where the chief goes
    z  along the orbit's normal, r × v

They are those of the osculating orbit, and velocities are seen from them as they turn,
with ω = (ω_x, 0, ω_z). Another frame is called LVLH too, such as Orekit's LVLH_CCSDS, whose
z points to the nadir and y against the normal: (X, Y, Z) there is (y, −z, −x) here.

Inertial axes: z along the Earth's axis, x and y in its equator. A state is a position and
a velocity [m, m/s]. The six numbers of a chief are those of `Orbit`: radius, radial
speed, angular momentum, node, inclination and argument of latitude.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.orbit import lvlh_rates


@dataclass(frozen=True, eq=False)
class LVLH:
    """The chief's frame at an instant, or at many.

    Its methods take states of one vehicle or of many: their first axes are those of the
    frame, and what follows them counts vehicles.
    """

    chief_state: Float[Array, "*k 6"]  # inertial state of the chief [m, m/s]
    axes: Float[Array, "*k 3 3"]  # rows: x, y and z in inertial axes
    omega: Float[Array, "*k 3"]  # as the frame turns, in its own axes [rad/s]

    @classmethod
    def from_state(
        cls, chief: Float[Array, "*k 6"], acceleration: Float[Array, "*k 3"] | None = None
    ) -> "LVLH":
        """The frame of a chief with this inertial state.

            ω_z = h/r²,    ω_x = r a_n/h    [Xu2008]

        Args:
            chief: Its inertial position and velocity [m, m/s].
            acceleration: All that it feels, in inertial axes; of it only the part a_n
                along the normal counts, which tilts the orbit [m/s²]. None is Kepler's
                motion, in which there is no such part.

        Raises:
            ValueError: The chief falls along a line, which has no normal.
        """
        r, h = radius_and_momentum(chief)
        axes = orbit_axes(chief)
        omega = np.zeros(axes.shape[:-1])
        omega[..., 2] = h / r**2
        if acceleration is not None:
            omega[..., 0] = r / h * (axes[..., 2, :] * acceleration).sum(axis=-1)
        return cls(chief, axes, omega)

    @classmethod
    def from_polar_nodal(cls, chief: Float[Array, "*k 6"], k_J2: float) -> "LVLH":
        """The frame of a chief with these six numbers, under two bodies and J2.

        Args:
            chief: As `Orbit.at` gives them.
            k_J2: Strength of the oblateness, 0 for Kepler's motion [m⁵/s²].
        """
        rates = lvlh_rates(chief, k_J2)
        omega = np.stack([rates.omega_x, np.zeros_like(rates.omega_x), rates.omega_z], axis=-1)
        return cls(inertial_state(chief), _axes_from_angles(chief), omega)

    def to_inertial(self, x: Float[Array, "... 6"]) -> Float[Array, "... 6"]:
        """Inertial states, of states in this frame.

        A position is known to no better than the last digit of the distance from the
        Earth's centre, a nanometre in low orbit. `to_offset` keeps what lies below.
        """
        return np.asarray(self._add_agent_axes(self.chief_state, x, 1) + self.to_offset(x))

    def from_inertial(self, state: Float[Array, "... 6"]) -> Float[Array, "... 6"]:
        """States in this frame, of inertial states."""
        return self.from_offset(state - self._add_agent_axes(self.chief_state, state, 1))

    def to_offset(self, x: Float[Array, "... 6"]) -> Float[Array, "... 6"]:
        """How inertial states differ from the chief's, of states in this frame."""
        omega, axes = self._add_agent_axes(self.omega, x, 1), self._add_agent_axes(self.axes, x, 2)
        seen = x[..., 3:] + _cross_omega(omega, x[..., :3])
        return np.concatenate(
            [np.einsum("...ab,...a->...b", axes, part) for part in (x[..., :3], seen)], axis=-1
        )

    def from_offset(self, offset: Float[Array, "... 6"]) -> Float[Array, "... 6"]:
        """States in this frame, of how inertial states differ from the chief's."""
        omega, axes = (
            self._add_agent_axes(self.omega, offset, 1),
            self._add_agent_axes(self.axes, offset, 2),
        )
        position, velocity = (
            np.einsum("...ab,...b->...a", axes, part) for part in (offset[..., :3], offset[..., 3:])
        )
        return np.concatenate([position, velocity - _cross_omega(omega, position)], axis=-1)

    def _add_agent_axes(self, part: Array, x: Array, own: int) -> Array:
        # Axes that count vehicles go between those of the frame and those of a vector.
        instants = part.ndim - own
        vehicles = max(0, x.ndim - 1 - instants)
        return part.reshape(part.shape[:instants] + (1,) * vehicles + part.shape[instants:])


def to_polar_nodal(state: Float[Array, "*k 6"]) -> Float[Array, "*k 6"]:
    """The six numbers of a chief, of its inertial state.

    In an equatorial orbit every direction is a node; the one taken is the x axis (node 0).
    The argument of latitude lies between −π and π.

    Raises:
        ValueError: The state falls along a line, and has no plane.
    """
    r, h = radius_and_momentum(state)
    position, velocity = state[..., :3], state[..., 3:]
    normal = _cross(position, velocity)
    tilt = np.hypot(normal[..., 0], normal[..., 1])
    # 0.0 − y is never −0, of which the arctangent would be π where there is no tilt.
    node = np.arctan2(normal[..., 0] + 0.0, 0.0 - normal[..., 1])
    to_node = np.stack([np.cos(node), np.sin(node), np.zeros_like(node)], axis=-1)
    ahead = _cross(normal, to_node) / h[..., None]
    latitude = np.arctan2((position * ahead).sum(axis=-1), (position * to_node).sum(axis=-1))
    radial = (position * velocity).sum(axis=-1) / r
    return np.stack([r, radial, h, node, np.arctan2(tilt, normal[..., 2]), latitude], axis=-1)


def inertial_state(chief: Float[Array, "*k 6"]) -> Float[Array, "*k 6"]:
    """The inertial state of a chief, of its six numbers."""
    r, v_x, h = (part[..., None] for part in np.moveaxis(chief[..., :3], -1, 0))
    axes = _axes_from_angles(chief)
    x, y = axes[..., 0, :], axes[..., 1, :]
    return np.concatenate([r * x, v_x * x + h / r * y], axis=-1)


def orbit_axes(state: Float[Array, "*k 6"]) -> Float[Array, "*k 3 3"]:
    """The axes x, y and z of an inertial state's orbit, as rows."""
    position, normal = state[..., :3], _cross(state[..., :3], state[..., 3:])
    x = position / np.sqrt((position * position).sum(axis=-1, keepdims=True))
    z = normal / np.sqrt((normal * normal).sum(axis=-1, keepdims=True))
    return np.stack([x, _cross(z, x), z], axis=-2)


def radius_and_momentum(
    state: Float[Array, "*k 6"],
) -> tuple[Float[Array, "*k"], Float[Array, "*k"]]:
    """Distance from the Earth's centre and angular momentum of inertial states.

    Raises:
        ValueError: One is not finite, or falls along a line.
    """
    r = np.linalg.norm(state[..., :3], axis=-1)
    h = np.linalg.norm(_cross(state[..., :3], state[..., 3:]), axis=-1)
    if not (np.isfinite(h).all() and (h > 0).all()):
        raise ValueError(
            "an orbit needs a finite position and velocity that do not lie on one line through "
            f"the Earth's centre, got {state.reshape(-1, 6)[np.argmin(np.nan_to_num(h))]}"
        )
    return np.asarray(r), np.asarray(h)


def _axes_from_angles(chief: Array) -> Array:
    """The axes of a chief by its angles, as rows: about z, x and z again."""
    node, i, theta = np.moveaxis(chief[..., 3:], -1, 0)
    cos_n, sin_n, cos_i, sin_i = np.cos(node), np.sin(node), np.cos(i), np.sin(i)
    to_node = np.stack([cos_n, sin_n, np.zeros_like(node)], axis=-1)
    square = np.stack([-sin_n * cos_i, cos_n * cos_i, sin_i], axis=-1)
    normal = np.stack([sin_n * sin_i, -cos_n * sin_i, cos_i], axis=-1)
    c, s = np.cos(theta)[..., None], np.sin(theta)[..., None]
    return np.stack([c * to_node + s * square, c * square - s * to_node, normal], axis=-2)


def _cross_omega(omega: Array, position: Array) -> Array:
    """ω × r with ω = (ω_x, 0, ω_z)."""
    x, y, z = np.moveaxis(position, -1, 0)
    about_x, about_z = omega[..., 0], omega[..., 2]
    return np.stack([-about_z * y, about_z * x - about_x * z, about_x * y], axis=-1)


def _cross(a: Array, b: Array) -> Array:
    # A tenth of the time of np.cross, which counts where few vehicles are integrated.
    one, two = [1, 2, 0], [2, 0, 1]
    return np.asarray(a[..., one] * b[..., two] - a[..., two] * b[..., one])
