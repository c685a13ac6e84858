"""Measurements, messages and estimates: row i of every array is of agent i.

An agent decides by functions of these three, row by row, in its own body frame. They are never
given the truth, which is a `VehicleState`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array


class Measurements(NamedTuple):
    """Measurements of agent i, in row i, in its body frame."""

    velocity: Float[Array, "n 3"]  # [m/s]
    yaw_rate: Float[Array, " n"]  # [rad/s]
    relative_position: Float[Array, "n n 3"]  # p_ij as measured; NaN out of view [m]
    previous_relative_position: Float[Array, "n n 3"]  # a step ago [m]
    range_points: Float[Array, "n points 3"]  # nearest points of what is near; NaN otherwise [m]

    @property
    def visibility(self) -> Bool[Array, "n n"]:
        """True where i sees j."""
        return np.asarray(~np.isnan(self.relative_position[..., 0]))


class AdjacencyRows(NamedTuple):
    """Adjacency matrix as known to agent i, and the age of its rows."""

    weight: Float[Array, "n n n"]  # [i, k]: row of agent k
    time: Float[Array, "n n"]  # [i, k]: time at which agent k computed it [s]


class Message(NamedTuple):
    """Messages on their way: what agent j sent to all others is in row j."""

    twist: Float[Array, "n 4"]  # v_j, w_j
    relative_position: Float[Array, "n n 3"]  # p_ji [m]
    relative_yaw: Float[Array, "n n"]  # ψ̃_jk [rad]
    is_mutual: Bool[Array, "n n"]  # true where ψ̃_jk rests on two bearings
    adjacency: AdjacencyRows


class Inbox(NamedTuple):
    """Last messages that agent i received from agent j, at [i, j]; changed in place.

    Old ones are forgotten.
    """

    time: Float[Array, "n n"]  # time at which j sent it; −∞ where there is none [s]
    is_new: Bool[Array, "n n"]  # true where it arrived in this step
    twist: Float[Array, "n n 4"]  # v_j, w_j
    relative_position: Float[Array, "n n 3"]  # p_ji; NaN where j did not see i [m]
    own_relative_position: Float[Array, "n n 3"]  # p_ij that i measured at that time [m]
    relative_yaw: Float[Array, "n n n"]  # [i, j, k]: ψ̃_jk [rad]
    is_mutual: Bool[Array, "n n n"]  # [i, j, k]

    @property
    def is_seen(self) -> Bool[Array, "n n"]:
        """True where j says that it saw i."""
        return np.asarray(~np.isnan(self.relative_position[..., 0]))


class PowerIterates(NamedTuple):
    """Iterates of agent i of the power iteration, in row i."""

    v: Float[Array, " n"]  # v̂, of the eigenvector
    average: Float[Array, "n 2"]  # z₁, z₂: averages of v and of v²
    integral: Float[Array, "n 2"]  # w₁, w₂


class AgentEstimates(NamedTuple):
    """Estimates of agent i, in row i."""

    velocity_observer: Float[Array, "n n 7"]  # see `yaw_estimator.update_velocity_observer`
    relative_yaw: Float[Array, "n n"]  # ψ̃_ij [rad]
    is_mutual: Bool[Array, "n n"]  # true where ψ̃_ij rests on two bearings
    weight: Float[Array, "n n"]  # A_ij
    weight_gradient: Float[Array, "n n 4"]  # ∂A_ij/∂p_i in the body frame, ∂A_ij/∂ψ_i
    adjacency: AdjacencyRows
    iterates: PowerIterates
    lambda2: Float[Array, " n"]  # NaN unknown
    action: Float[Array, "n n"]  # −∂V/∂A_ij


class Knowledge(NamedTuple):
    """All that agents know, and nothing of the truth."""

    measurements: Measurements
    inbox: Inbox
    estimates: AgentEstimates

    @classmethod
    def at_start(cls, relative_yaw: Float[Array, "n n"], rng: np.random.Generator) -> "Knowledge":
        """Return what agents know that have neither looked nor heard, by first estimates ψ̃_ij."""
        n = len(relative_yaw)
        pairs, rows, unseen = np.zeros((n, n)), np.zeros((n, n, n)), np.full((n, n, 3), np.nan)
        never, still = np.full((n, n), -np.inf), np.zeros((n, 3))
        measurements = Measurements(still, still[:, 0], unseen, unseen, np.zeros((n, 0, 3)))
        inbox = Inbox(
            never.copy(), pairs > 0, np.zeros((n, n, 4)), unseen.copy(), unseen.copy(),
            rows.copy(), rows > 0,
        )  # fmt: skip
        iterates = PowerIterates(rng.standard_normal(n), np.zeros((n, 2)), np.zeros((n, 2)))
        estimates = AgentEstimates(
            np.zeros((n, n, 7)), relative_yaw, pairs > 0, pairs, np.zeros((n, n, 4)),
            AdjacencyRows(rows, never), iterates, np.full(n, np.nan), pairs,
        )  # fmt: skip
        return cls(measurements, inbox, estimates)
