"""Control law: the velocity command of each agent from the positions of its neighbors.

Agents are computed side by side, a row each. An agent uses a frame of its own, its own rows of the
gains and the formation, and the positions of its neighbors relative to itself. The gains commute
with rotations about the vertical, so the result does not depend on the frame
[Lusk2020, Sec. III-A].
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix
from sato.formation.sensing import NeighborLocations
from sato.formation.settings import ControlLaw

# Size control of [Lusk2020]'s code, in the plane and vertical: K1 [1/s], K2 [1/m], and the
# error up to which it does nothing [m].
LEGACY_GAIN_XY, LEGACY_SLOPE_XY, LEGACY_DEADBAND_XY = 0.1, 0.1, 0.3
LEGACY_GAIN_Z, LEGACY_SLOPE_Z, LEGACY_DEADBAND_Z = 0.5, 0.3, 0.1


class FormationData(NamedTuple):
    """Desired formation as all agents know it, a row a point; each agent uses the row it holds."""

    neighbors: Int[Array, "points most"]  # of each point, padded with −1; below those of each
    gains_xy: Complex[Array, "points most"]  # [1/s]
    gains_z: Float[Array, "points most"]  # [1/s]
    distances: Float[Array, "points most"]  # in the plane [m]
    heights: Float[Array, "points most"]  # above the point [m]
    size_weights: Float[Array, "points most"]  # w_ij = 1 / max(d_i, d_j), d the degree

    @classmethod
    def from_gains(cls, gains: GainMatrix) -> "FormationData":
        """Collect what the control law needs of a formation with its gains."""
        graph, points = gains.formation.graph, gains.formation.points
        degree, own = graph.sum(axis=1), np.arange(len(graph))[:, None]
        # Row by row the neighbors first, in order; the rest is −1.
        order = np.argsort(~graph, axis=1, kind="stable")[:, : degree.max()]
        neighbors = np.where(np.arange(degree.max()) < degree[:, None], order, -1)
        x, y, heights = np.moveaxis(points[neighbors] - points[own], -1, 0)
        weights = (graph / np.maximum(degree, degree[:, None]))[own, neighbors]
        of_pairs = gains.xy[own, neighbors], gains.z[own, neighbors], np.hypot(x, y)
        return cls(neighbors, *of_pairs, heights, weights)


def compute_velocity_commands(
    me: Int[Array, " k"],  # point that each agent holds
    seen: NeighborLocations,
    formation: FormationData,
    law: ControlLaw,
    legacy: bool,  # True for the size control of the paper's code
) -> Float[Array, "k 3"]:
    """Compute the velocity commands of agents, each in its own frame [m/s].

    In the plane it is Σ_j (A_ij + f_ij) q_ij with the size control f_ij. The vertical part is
    alike where the mirror image will do, with a size control of |q_ij|; upright, it is
    Σ_j c_ij q_ij + s w_ij (q_ij − p_ij), since all agents agree on the vertical. For a formation
    p both are −∂V/∂q_i of one potential V, since A is symmetric and f_ij = f_ji; V also
    decreases where commands are scaled, or turned by less than 90° [Lusk2020, Sec. III-C].
    """
    _, gains_xy, gains_z, far, p_z, weight = (part[me] for part in formation)
    is_known = seen.is_known
    q, q_z = np.where(is_known, seen.flat, 0.0), np.where(is_known, seen.rise, 0.0)
    near = np.abs(q)
    if legacy:
        f = _legacy_size_gain(near - far, LEGACY_GAIN_XY, LEGACY_SLOPE_XY, LEGACY_DEADBAND_XY)
        error = np.abs(q_z) - np.abs(p_z)
        g = _legacy_size_gain(error, LEGACY_GAIN_Z, LEGACY_SLOPE_Z, LEGACY_DEADBAND_Z)
    else:
        f = law.size_rate * weight * _relative_error(near, far)
        g = law.size_rate * weight
        if not law.upright:
            g = g * _relative_error(np.abs(q_z), np.abs(p_z))
    flat = ((gains_xy + f) * q).sum(axis=1)
    vertical = (gains_z + g) * q_z
    if law.upright:
        vertical -= np.where(is_known, g * p_z, 0.0)
    command = np.stack([flat.real, flat.imag, vertical.sum(axis=1)], axis=1)
    return np.asarray(law.gain * command)


def _relative_error(actual: Array, desired: Array) -> Array:
    # From −1, where the length is zero, to 1, where it is far too large.
    most = np.maximum(actual, desired)
    return np.asarray(np.divide(actual - desired, most, out=np.zeros_like(most), where=most > 0))


def _legacy_size_gain(error: Array, gain: float, slope: float, deadband: float) -> Array:
    return np.where(np.abs(error) > deadband, gain * np.arctan(slope * error), 0.0)
