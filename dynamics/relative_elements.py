"""Quasi-nonsingular relative orbital elements [DAmico2010].

What two orbits differ by, in numbers that change slowly or not at all where LVLH positions
go round. They are defined for circular chiefs; not for equatorial ones, whose node is not.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.coordinate_frames import LVLH
from dynamics.elements import ClassicalElements, true_anomaly, validate_eccentricity
from dynamics.orbit import EARTH_MU

# Below this sine of the inclination a node is known to 10⁻⁸ rad at best.
MIN_SIN_INCLINATION = 1e-8


class RelativeOrbitalElements(NamedTuple):
    """A deputy's orbit relative to the chief's, without dimension [DAmico2010, Chapter 2].

        δa   = (a_d − a_c)/a_c
        δλ   = u_d − u_c + (Ω_d − Ω_c) cos i_c,    u = M + ω
        δe_x = e_d cos ω_d − e_c cos ω_c
        δe_y = e_d sin ω_d − e_c sin ω_c
        δi_x = i_d − i_c
        δi_y = (Ω_d − Ω_c) sin i_c

    Times the chief's semi-major axis they are lengths: δλ the mean distance along the
    orbit, δe half the width along it of the ellipse flown, δi the swing out of the plane.
    """

    semi_major_axis: float | Float[Array, "*k"]
    longitude: float | Float[Array, "*k"]
    eccentricity_x: float | Float[Array, "*k"]
    eccentricity_y: float | Float[Array, "*k"]
    inclination_x: float | Float[Array, "*k"]
    inclination_y: float | Float[Array, "*k"]

    @classmethod
    def from_elements(
        cls, chief: ClassicalElements, deputy: ClassicalElements
    ) -> "RelativeOrbitalElements":
        """How a deputy's elements differ from the chief's.

        Raises:
            ValueError: One of the orbits is equatorial.
        """
        _validate_inclination("the chief", chief.inclination)
        _validate_inclination("a deputy", deputy.inclination)
        e_c, w_c = np.asarray(chief.eccentricity), chief.arg_perigee
        e_d, w_d = np.asarray(deputy.eccentricity), deputy.arg_perigee
        nodes = _wrap_angle(deputy.raan - np.asarray(chief.raan))
        latitudes = _wrap_angle(w_d + deputy.mean_anomaly - w_c - chief.mean_anomaly)
        return cls(
            (deputy.semi_major_axis - np.asarray(chief.semi_major_axis)) / chief.semi_major_axis,
            _wrap_angle(latitudes + nodes * np.cos(chief.inclination)),
            e_d * np.cos(w_d) - e_c * np.cos(w_c),
            e_d * np.sin(w_d) - e_c * np.sin(w_c),
            deputy.inclination - np.asarray(chief.inclination),
            nodes * np.sin(chief.inclination),
        )

    @classmethod
    def from_lvlh(
        cls, frame: LVLH, x: Float[Array, "... 6"], mu: float = EARTH_MU
    ) -> "RelativeOrbitalElements":
        """Relative elements of states in the chief's frame, exactly.

        Raises:
            ValueError: One of the orbits is equatorial, or no ellipse.
        """
        chief = ClassicalElements.from_state(_broadcast_chief(frame, x), mu)
        return cls.from_elements(chief, ClassicalElements.from_state(frame.to_inertial(x), mu))

    def deputy_elements(self, chief: ClassicalElements) -> ClassicalElements:
        """The deputy's elements.

        Raises:
            ValueError: The chief or the deputy is equatorial, or the deputy's orbit is no
                ellipse.
        """
        _validate_inclination("the chief", chief.inclination)
        e_x = chief.eccentricity * np.cos(chief.arg_perigee) + self.eccentricity_x
        e_y = chief.eccentricity * np.sin(chief.arg_perigee) + self.eccentricity_y
        e, perigee = np.hypot(e_x, e_y), np.arctan2(e_y, e_x)
        validate_eccentricity(e)
        inclination = chief.inclination + np.asarray(self.inclination_x)
        _validate_inclination("the deputy", inclination)
        nodes = self.inclination_y / np.sin(chief.inclination)
        u = (
            chief.arg_perigee
            + chief.mean_anomaly
            + self.longitude
            - nodes * np.cos(chief.inclination)
        )
        return ClassicalElements(
            chief.semi_major_axis * (1 + np.asarray(self.semi_major_axis)),
            e,
            inclination,
            chief.raan + nodes,
            perigee,
            true_anomaly(u - perigee, e),
        )

    def to_lvlh(self, frame: LVLH, mu: float = EARTH_MU) -> Float[Array, "*k 6"]:
        """States in the chief's frame, exactly.

        Raises:
            ValueError: One of the orbits is equatorial, or no ellipse.
        """
        like = np.broadcast(*self)
        x = np.broadcast_to(0.0, (*like.shape, 6))
        deputy = self.deputy_elements(ClassicalElements.from_state(_broadcast_chief(frame, x), mu))
        return frame.from_inertial(deputy.to_state(mu))

    def to_lvlh_first_order(
        self, chief: ClassicalElements, mu: float = EARTH_MU
    ) -> Float[Array, "*k 6"]:
        """States in the chief's frame to first order [DAmico2010, Chapter 2].

        Good to second order in the elements for a circular chief, and off by the fraction e
        for others.
        """
        u = chief.arg_perigee + chief.mean_anomaly
        n = np.sqrt(mu / np.asarray(chief.semi_major_axis) ** 3)
        c, s = np.cos(u), np.sin(u)
        a, longitude, e_x, e_y, i_x, i_y = self
        position = [
            a - e_x * c - e_y * s,
            longitude + 2 * (e_x * s - e_y * c),
            i_x * s - i_y * c,
        ]
        velocity = [
            n * (e_x * s - e_y * c),
            n * (2 * (e_x * c + e_y * s) - 1.5 * a),
            n * (i_x * c + i_y * s),
        ]
        parts = np.broadcast_arrays(*position, *velocity)
        return np.asarray(np.stack(parts, axis=-1) * np.asarray(chief.semi_major_axis)[..., None])


def _broadcast_chief(frame: LVLH, x: Array) -> Array:
    """The chief's state with an axis wherever `x` counts vehicles."""
    chief = frame.chief_state
    vehicles = max(0, x.ndim - chief.ndim)
    return chief.reshape(chief.shape[:-1] + (1,) * vehicles + (6,))


def _validate_inclination(whose: str, inclination: float | Array) -> None:
    flat = np.ravel(inclination)
    wrong = np.abs(np.sin(flat)) <= MIN_SIN_INCLINATION
    if wrong.any():
        raise ValueError(
            "quasi-nonsingular relative elements are singular for an equatorial orbit, whose "
            f"node is undefined: {whose} has an inclination of {np.degrees(flat[wrong][0]):.3g}°; "
            "use states in the chief's frame (LVLH), which are defined for every orbit"
        )


def _wrap_angle(angle: float | Array) -> Array:
    """The same angle between −π and π."""
    return np.asarray(angle - 2 * np.pi * np.round(angle / (2 * np.pi)))
