"""What is true, what is sensed, what is told, and what each robot has in mind.

Four parts, so that the signature of a function says what it may read: what decides for a robot
is given its senses, its mail and its mind, and never the world.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.connectivity.power_iteration import PowerIterationState


class TrueState(NamedTuple):
    """The truth, for sensors and for who watches from outside."""

    position: Float[Array, "n 3"]  # [m]
    yaw: Float[Array, " n"]  # [rad]
    acceleration: Float[Array, "n 3"]  # acceleration in the world frame, where robots tilt [m/s²]
    alive: Bool[Array, " n"]
    weight: Float[Array, "n n"]  # A_ij, of what cameras can see
    eigenvalues: Float[Array, " 2"]  # λ₂ and λ₃ of those alive
    min_separation: Float[Array, " n"]  # least distance to another robot so far [m]
    min_obstacle_distance: Float[Array, " n"]  # least distance to an obstacle so far [m]


class Measurements(NamedTuple):
    """What the sensors of robot i tell it: row i, in its body frame."""

    velocity: Float[Array, "n 3"]  # its own [m/s]
    yaw_rate: Float[Array, " n"]  # its own, of yaw [rad/s]
    visibility: Bool[Array, "n n"]  # its camera has j in sight
    relative_position: Float[Array, "n n 3"]  # p_ij as measured [m]
    previous_visibility: Bool[Array, "n n"]  # a step ago
    previous_relative_position: Float[Array, "n n 3"]  # a step ago [m]
    range_points: Float[Array, "n points 3"]  # nearest points of what is around [m]
    range_point_count: Int[Array, " n"]  # how many of them


class MessageBuffers(NamedTuple):
    """Messages: those on their way, and of every other robot the last that arrived."""

    sent_relative_position: Float[Array, "ring n n 3"]  # [., j]: what j tells: p_ji for every i
    sent_visibility: Bool[Array, "ring n n"]
    sent_relative_yaw: Float[Array, "ring n n"]
    sent_is_mutual: Bool[Array, "ring n n"]
    sent_twist: Float[Array, "ring n 4"]
    sent_rows: Float[Array, "ring n n n"]
    sent_row_time: Float[Array, "ring n n"]
    received_time: Float[
        Array, "n n"
    ]  # [i, j]: when the message was told that i last had from j [s]
    received_relative_position: Float[Array, "n n 3"]  # [i, j]: p_ji in it
    received_visibility: Bool[Array, "n n"]  # [i, j]: whether j had i in sight
    received_relative_yaw: Float[Array, "n n n"]  # [i, j, k]: ψ̃_jk
    received_is_mutual: Bool[Array, "n n n"]
    is_new: Bool[Array, "n n"]  # [i, j]: it came in this very step
    relative_position_when_sent: Float[
        Array, "n n 3"
    ]  # [i, j]: p_ij, as i saw it itself when that was told [m]
    received_twist: Float[Array, "n n 4"]  # [i, j]: v_j, w_j


class AgentEstimates(NamedTuple):
    """What robot i reckons: row i."""

    velocity_observer: Float[Array, "n n 7"]  # observers of others' velocities, see `yaw`
    relative_yaw: Float[Array, "n n"]  # ψ̃_ij [rad]
    is_mutual: Bool[Array, "n n"]  # ψ̃_ij rests on two bearings
    weight: Float[Array, "n n"]  # A_ij
    weight_gradient: Float[Array, "n n 4"]  # its gradient: ∂A_ij/∂p_i in the body frame, ∂A_ij/∂ψ_i
    adjacency_rows: Float[Array, "n n n"]  # the adjacency as far as i knows it
    row_time: Float[Array, "n n"]  # when row k of it was computed [s]
    eigenvector_guess: Float[
        Array, "n 3 n"
    ]  # eigenvectors as i last had them, where it looks for new ones
    power_iteration: PowerIterationState
    lambda2: Float[Array, " n"]  # NaN unknown
    lambda2_gradient: Float[Array, "n n"]  # ∂λ₂/∂A_ij
    command: Float[Array, "n 4"]  # velocity in the body frame, yaw rate


class ConnectivityState(NamedTuple):
    """All of it; changed in place from step to step."""

    truth: TrueState
    measurements: Measurements
    messages: MessageBuffers
    estimates: AgentEstimates


def initial_state(
    position: Float[Array, "n 3"],
    yaw: Float[Array, " n"],
    yaw_estimate: Float[Array, "n n"],
    delay_messages: int,
    obstacles: int,
    rng: np.random.Generator,
) -> ConnectivityState:
    """Everybody at rest, and nothing seen or told yet.

    Args:
        position: Of each robot [m].
        yaw: Of each robot [rad].
        believed: What each takes for the relative yaw of others at first [rad].
        late: How many messages later one arrives.
        obstacles: How many there are.
        rng: Draws where the power iteration begins.
    """
    n, ring = len(position), delay_messages + 1
    zero, unseen, ages = np.zeros, np.nan, -np.inf

    def never(*shape: int) -> Array:
        return np.zeros(shape, dtype=bool)

    world = TrueState(
        position.copy(), yaw.copy(), zero((n, 3)), np.ones(n, dtype=bool), zero((n, n)),
        zero(2), np.full(n, np.inf), np.full(n, np.inf),
    )  # fmt: skip
    senses = Measurements(
        zero((n, 3)), zero(n), never(n, n), np.full((n, n, 3), unseen), never(n, n),
        np.full((n, n, 3), unseen), zero((n, n + obstacles, 3)), zero(n, dtype=np.int64),
    )  # fmt: skip
    mail = MessageBuffers(
        np.full((ring, n, n, 3), unseen), never(ring, n, n), zero((ring, n, n)),
        never(ring, n, n), zero((ring, n, 4)), zero((ring, n, n, n)),
        np.full((ring, n, n), ages), np.full((n, n), ages), np.full((n, n, 3), unseen),
        never(n, n), zero((n, n, n)), never(n, n, n), never(n, n), np.full((n, n, 3), unseen),
        zero((n, n, 4)),
    )  # fmt: skip
    iterate = PowerIterationState(rng.standard_normal(n), zero((n, 2)), zero((n, 2)))
    mind = AgentEstimates(
        zero((n, n, 7)), yaw_estimate.copy(), never(n, n), zero((n, n)), zero((n, n, 4)),
        zero((n, n, n)), np.full((n, n), ages), zero((n, 3, n)), iterate,
        np.full(n, np.nan), zero((n, n)), zero((n, 4)),
    )  # fmt: skip
    return ConnectivityState(world, senses, mail, mind)
