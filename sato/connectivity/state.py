"""State of a simulation: truth, measurements, messages and estimates.

The four parts keep the information structure visible in signatures: the controller of an
agent is given its measurements, messages and estimates, and never the truth.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.connectivity.power_iteration import PowerIterationState


class TrueState(NamedTuple):
    """Truth, for sensors and for the record."""

    position: Float[Array, "n 3"]  # [m]
    yaw: Float[Array, " n"]  # [rad]
    acceleration: Float[Array, "n 3"]  # in the world frame, of quadrotors [m/s²]
    alive: Bool[Array, " n"]
    weight: Float[Array, "n n"]  # A_ij
    eigenvalues: Float[Array, " 2"]  # λ₂ and λ₃ of live agents


class Measurements(NamedTuple):
    """Measurements of agent i, in row i, in its body frame."""

    velocity: Float[Array, "n 3"]  # [m/s]
    yaw_rate: Float[Array, " n"]  # [rad/s]
    visibility: Bool[Array, "n n"]  # true where i sees j
    relative_position: Float[Array, "n n 3"]  # p_ij as measured [m]
    previous_visibility: Bool[Array, "n n"]  # a step ago
    previous_relative_position: Float[Array, "n n 3"]  # a step ago [m]
    range_points: Float[Array, "n points 3"]  # nearest points of what is near [m]
    range_point_count: Int[Array, " n"]  # number of these points


class MessageBuffers(NamedTuple):
    """Messages on their way, in a ring, and the last that each agent received from each other."""

    sent_relative_position: Float[Array, "ring n n 3"]  # [·, j, i]: p_ji
    sent_visibility: Bool[Array, "ring n n"]
    sent_relative_yaw: Float[Array, "ring n n"]
    sent_is_mutual: Bool[Array, "ring n n"]
    sent_twist: Float[Array, "ring n 4"]
    sent_rows: Float[Array, "ring n n n"]
    sent_row_time: Float[Array, "ring n n"]
    received_time: Float[Array, "n n"]  # [i, j]: time at which j sent what i received last [s]
    received_relative_position: Float[Array, "n n 3"]  # [i, j]: p_ji
    received_visibility: Bool[Array, "n n"]  # [i, j]: true where j saw i
    received_relative_yaw: Float[Array, "n n n"]  # [i, j, k]: ψ̃_jk
    received_is_mutual: Bool[Array, "n n n"]  # [i, j, k]
    is_new: Bool[Array, "n n"]  # [i, j]: true where it arrived in this step
    relative_position_when_sent: Float[Array, "n n 3"]  # [i, j]: p_ij of i at that time [m]
    received_twist: Float[Array, "n n 4"]  # [i, j]: v_j, w_j


class AgentEstimates(NamedTuple):
    """Estimates of agent i, in row i."""

    velocity_observer: Float[Array, "n n 7"]  # see `yaw_estimator.update_velocity_observer`
    relative_yaw: Float[Array, "n n"]  # ψ̃_ij [rad]
    is_mutual: Bool[Array, "n n"]  # true where ψ̃_ij rests on two bearings
    weight: Float[Array, "n n"]  # A_ij
    weight_gradient: Float[Array, "n n 4"]  # ∂A_ij/∂p_i in the body frame, ∂A_ij/∂ψ_i
    adjacency_rows: Float[Array, "n n n"]  # adjacency matrix as known to i
    row_time: Float[Array, "n n"]  # [i, k]: time at which row k of it was computed [s]
    eigenvector_guess: Float[Array, "n 3 n"]  # start of the search for eigenvectors
    power_iteration: PowerIterationState
    lambda2: Float[Array, " n"]  # NaN unknown
    lambda2_gradient: Float[Array, "n n"]  # ∂λ₂/∂A_ij
    command: Float[Array, "n 4"]  # velocity in the body frame [m/s], yaw rate [rad/s]


class ConnectivityState(NamedTuple):
    """State of all agents, changed in place from step to step."""

    truth: TrueState
    measurements: Measurements
    messages: MessageBuffers
    estimates: AgentEstimates


def initial_state(
    position: Float[Array, "n 3"],
    yaw: Float[Array, " n"],
    relative_yaw: Float[Array, "n n"],
    delay_messages: int,
    obstacles: int,
    rng: np.random.Generator,
) -> ConnectivityState:
    """Build the state at rest, before anything is measured or sent.

    Args:
        position: Positions [m].
        yaw: Yaw of each agent [rad].
        relative_yaw: First estimates ψ̃_ij [rad].
        delay_messages: Messages that are sent before one arrives.
        obstacles: Number of obstacles.
        rng: Draws the first iterates of the power iteration.
    """
    n, ring = len(position), delay_messages + 1
    zero, full = np.zeros, np.full

    def false(*shape: int) -> Array:
        return np.zeros(shape, dtype=bool)

    truth = TrueState(
        position.copy(), yaw.copy(), zero((n, 3)), np.ones(n, dtype=bool), zero((n, n)), zero(2)
    )
    measurements = Measurements(
        zero((n, 3)), zero(n), false(n, n), full((n, n, 3), np.nan), false(n, n),
        full((n, n, 3), np.nan), zero((n, n + obstacles, 3)), zero(n, dtype=np.int64),
    )  # fmt: skip
    messages = MessageBuffers(
        full((ring, n, n, 3), np.nan), false(ring, n, n), zero((ring, n, n)),
        false(ring, n, n), zero((ring, n, 4)), zero((ring, n, n, n)),
        full((ring, n, n), -np.inf), full((n, n), -np.inf), full((n, n, 3), np.nan),
        false(n, n), zero((n, n, n)), false(n, n, n), false(n, n), full((n, n, 3), np.nan),
        zero((n, n, 4)),
    )  # fmt: skip
    iterates = PowerIterationState(rng.standard_normal(n), zero((n, 2)), zero((n, 2)))
    estimates = AgentEstimates(
        zero((n, n, 7)), relative_yaw.copy(), false(n, n), zero((n, n)), zero((n, n, 4)),
        zero((n, n, n)), full((n, n), -np.inf), zero((n, 3, n)), iterates,
        full(n, np.nan), zero((n, n)), zero((n, 4)),
    )  # fmt: skip
    return ConnectivityState(truth, measurements, messages, estimates)
