"""What one vehicle wants: the velocity that its neighbours' positions ask of it.

Everything here is what a single vehicle computes, in a frame of its own, from its own rows of
the gains and of the shape and from where it sees its neighbours. The gains commute with turns
about the vertical, so it does not matter which frame that is [Lusk2020, Sec. III-A].
"""

from math import atan, sqrt
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array


class ControlLaw(NamedTuple):
    """The numbers of the control law [Lusk2020, eq. 2, and Sec. III-C for the size]."""

    gain: float = 1.5  # of the whole command
    size_rate: float = 0.6  # rate at which errors of size die out [1/s]
    upright: bool = True  # heights as in the shape; else its mirror image will do too
    legacy: bool = False  # size control as in the paper's code, in place of `size`
    legacy_gain_xy: float = 0.1  # of the paper's code: K1 in the plane [1/s],
    legacy_slope_xy: float = 0.1  # K2 [1/m]
    legacy_deadband_xy: float = 0.3  # and the error that is let be [m]
    legacy_gain_z: float = 0.5  # the same of heights
    legacy_slope_z: float = 0.3
    legacy_deadband_z: float = 0.1


def size_control_weights(graph: Bool[Array, "n n"]) -> Float[Array, "n n"]:
    """Weights of the size control: equal on both sides of an edge, however many there are.

    Args:
        graph: Of the formation.
    """
    degree = graph.sum(axis=1)
    return np.asarray(graph / np.maximum(degree, degree[:, None]))


@no_type_check
@numba.njit(cache=True)
def compute_velocity_command(me, sees, neighbours, gain_xy, gain_z, shape, weight, law, command):
    """Velocity that the neighbours ask of a vehicle, in the frame in which it sees them.

    In the plane Σ_j (A_ij + f_ij) q_ij with f_ij the size control. Heights likewise, where the
    size control minds |q_ij| alone and takes a mirror image for the shape; or, upright,
    Σ_j c_ij q_ij + s w_ij (q_ij − p_ij), since all agree on what is up. For the shape p both are
    −∂V/∂q_i of one potential V, since A is symmetric and f_ij = f_ji: V decreases also
    where commands are scaled or turned by less than 90° [Lusk2020, Sec. III-C].

    Args:
        me: The point that the vehicle holds.
        sees: Where it sees who holds each point, from itself, (points, 3) [m].
        neighbours: The points of its neighbours.
        gain_xy: Its row of the gains in the plane, (points,) complex [1/s].
        gain_z: Its row of the gains of heights, (points,) [1/s].
        shape: The points of the shape, (points, 3) [m].
        weight: Of the size control, (points,): equal on both sides of an edge.
        law: The numbers of the law.
        command: Where the velocity goes, (3,) [m/s].
    """
    x, y, z = 0.0, 0.0, 0.0
    for j in neighbours:
        q_x, q_y, q_z = sees[j, 0], sees[j, 1], sees[j, 2]
        p_x, p_y, p_z = shape[j, 0] - shape[me, 0], shape[j, 1] - shape[me, 1], 0.0
        p_z = shape[j, 2] - shape[me, 2]
        a, b, c = gain_xy[j].real, gain_xy[j].imag, gain_z[j]
        near, far = sqrt(q_x * q_x + q_y * q_y), sqrt(p_x * p_x + p_y * p_y)
        if law.legacy:
            f = _legacy_size_gain(
                near - far, law.legacy_gain_xy, law.legacy_slope_xy, law.legacy_deadband_xy
            )
            g = _legacy_size_gain(
                abs(q_z) - abs(p_z), law.legacy_gain_z, law.legacy_slope_z, law.legacy_deadband_z
            )
        else:
            f = law.size_rate * weight[j] * _relative_error(near, far)
            g = (
                law.size_rate
                * weight[j]
                * (1.0 if law.upright else _relative_error(abs(q_z), abs(p_z)))
            )
        x += (a + f) * q_x - b * q_y
        y += b * q_x + (a + f) * q_y
        z += (c + g) * q_z - (g * p_z if law.upright else 0.0)
    command[0], command[1], command[2] = law.gain * x, law.gain * y, law.gain * z


@no_type_check
@numba.njit(cache=True)
def _relative_error(is_now, should_be):
    # Between −1, where it is nothing yet, and 1, where it is far too much.
    most = max(is_now, should_be)
    return (is_now - should_be) / most if most > 0 else 0.0


@no_type_check
@numba.njit(cache=True)
def _legacy_size_gain(error, size, bend, slack):
    return size * atan(bend * error) if abs(error) > slack else 0.0
