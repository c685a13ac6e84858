"""Control law of one agent: its velocity command from the positions of its neighbors.

An agent uses a frame of its own, its own rows of the gains and the formation, and the
positions of its neighbors relative to itself. The gains commute with rotations about the
vertical, so the result does not depend on the frame [Lusk2020, Sec. III-A].
"""

from math import atan, sqrt
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix

# Size control of [Lusk2020]'s code, in the plane and vertical: K1 [1/s], K2 [1/m], and the
# error up to which it does nothing [m].
LEGACY_GAIN_XY, LEGACY_SLOPE_XY, LEGACY_DEADBAND_XY = 0.1, 0.1, 0.3
LEGACY_GAIN_Z, LEGACY_SLOPE_Z, LEGACY_DEADBAND_Z = 0.5, 0.3, 0.1


class FormationData(NamedTuple):
    """Desired formation as all agents know it; each uses its own row."""

    gains_xy: Complex[Array, "points points"]  # [1/s]
    gains_z: Float[Array, "points points"]  # [1/s]
    points: Float[Array, "points 3"]  # [m]
    neighbors: Int[Array, "points most"]  # of each point, padded with −1
    size_weights: Float[Array, "points points"]  # w_ij = 1 / max(d_i, d_j), d the degree

    @classmethod
    def from_gains(cls, gains: GainMatrix) -> "FormationData":
        """Collect what the control law needs of a formation with its gains."""
        graph = gains.formation.graph
        degree = graph.sum(axis=1)
        # Row by row the neighbors first, in order; the rest is −1.
        order = np.argsort(~graph, axis=1, kind="stable")[:, : degree.max()]
        neighbors = np.where(np.arange(degree.max()) < degree[:, None], order, -1)
        weights = graph / np.maximum(degree, degree[:, None])
        return cls(gains.xy, gains.z, gains.formation.points, neighbors, weights)


@numba.njit(cache=True)
def compute_velocity_command(me, relative, neighbors, formation, law, legacy, command):
    """Compute the velocity command of an agent, in the frame of the relative positions.

    In the plane it is Σ_j (A_ij + f_ij) q_ij with the size control f_ij. The vertical part is
    alike where the mirror image will do, with a size control of |q_ij|; upright, it is
    Σ_j c_ij q_ij + s w_ij (q_ij − p_ij), since all agents agree on the vertical. For a formation
    p both are −∂V/∂q_i of one potential V, since A is symmetric and f_ij = f_ji; V also
    decreases where commands are scaled, or turned by less than 90° [Lusk2020, Sec. III-C].

    Args:
        me: Index of the point that the agent holds.
        relative: Relative position of the holder of each point, (points, 3) [m].
        neighbors: Indices of the neighboring points.
        formation: Formation with its gains, a `FormationData`.
        law: Numbers of the law, a `ControlLaw`.
        legacy: True for the size control of the paper's code.
        command: Buffer for the velocity command, (3,) [m/s].
    """
    gain_xy, gain_z = formation.gains_xy[me], formation.gains_z[me]
    points, weight = formation.points, formation.size_weights[me]
    x, y, z = 0.0, 0.0, 0.0
    for j in neighbors:
        q_x, q_y, q_z = relative[j, 0], relative[j, 1], relative[j, 2]
        p_x, p_y = points[j, 0] - points[me, 0], points[j, 1] - points[me, 1]
        p_z = points[j, 2] - points[me, 2]
        a, b, c = gain_xy[j].real, gain_xy[j].imag, gain_z[j]
        near, far = sqrt(q_x * q_x + q_y * q_y), sqrt(p_x * p_x + p_y * p_y)
        if legacy:
            f = _legacy_size_gain(near - far, LEGACY_GAIN_XY, LEGACY_SLOPE_XY, LEGACY_DEADBAND_XY)
            error = abs(q_z) - abs(p_z)
            g = _legacy_size_gain(error, LEGACY_GAIN_Z, LEGACY_SLOPE_Z, LEGACY_DEADBAND_Z)
        else:
            f = law.size_rate * weight[j] * _relative_error(near, far)
            error = 1.0 if law.upright else _relative_error(abs(q_z), abs(p_z))
            g = law.size_rate * weight[j] * error
        x += (a + f) * q_x - b * q_y
        y += b * q_x + (a + f) * q_y
        z += (c + g) * q_z - (g * p_z if law.upright else 0.0)
    command[0], command[1], command[2] = law.gain * x, law.gain * y, law.gain * z


@numba.njit(cache=True)
def _relative_error(actual, desired):
    # From −1, where the length is zero, to 1, where it is far too large.
    most = max(actual, desired)
    return (actual - desired) / most if most > 0 else 0.0


@numba.njit(cache=True)
def _legacy_size_gain(error, gain, slope, deadband):
    return gain * atan(slope * error) if abs(error) > deadband else 0.0
