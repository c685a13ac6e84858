"""What is true, what is sensed, what is told, and what each robot has in mind.

Four parts, so that the signature of a function says what it may read: what decides for a robot
is given its senses, its mail and its mind, and never the world.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.connectivity.power import Iterate


class World(NamedTuple):
    """The truth, for sensors and for who watches from outside."""

    position: Float[Array, "n 3"]  # [m]
    yaw: Float[Array, " n"]  # [rad]
    push: Float[Array, "n 3"]  # acceleration in the world frame, where robots tilt [m/s²]
    alive: Bool[Array, " n"]
    weight: Float[Array, "n n"]  # A_ij, of what cameras can see
    lambdas: Float[Array, " 2"]  # λ₂ and λ₃ of those alive
    robot: Float[Array, " n"]  # least distance to another robot so far [m]
    obstacle: Float[Array, " n"]  # least distance to an obstacle so far [m]


class Senses(NamedTuple):
    """What the sensors of robot i tell it: row i, in its body frame."""

    velocity: Float[Array, "n 3"]  # its own [m/s]
    rate: Float[Array, " n"]  # its own, of yaw [rad/s]
    sees: Bool[Array, "n n"]  # its camera has j in sight
    p: Float[Array, "n n 3"]  # p_ij as measured [m]
    saw: Bool[Array, "n n"]  # a step ago
    p_before: Float[Array, "n n 3"]  # a step ago [m]
    points: Float[Array, "n points 3"]  # nearest points of what is around [m]
    around: Int[Array, " n"]  # how many of them


class Mail(NamedTuple):
    """Messages: those on their way, and of every other robot the last that arrived."""

    p: Float[Array, "ring n n 3"]  # [., j]: what j tells: p_ji for every i
    sees: Bool[Array, "ring n n"]
    turned: Float[Array, "ring n n"]
    close: Bool[Array, "ring n n"]
    motion: Float[Array, "ring n 4"]
    rows: Float[Array, "ring n n n"]
    stamp: Float[Array, "ring n n"]
    when: Float[Array, "n n"]  # [i, j]: when the message was told that i last had from j [s]
    his_p: Float[Array, "n n 3"]  # [i, j]: p_ji in it
    his_sees: Bool[Array, "n n"]  # [i, j]: whether j had i in sight
    his_turned: Float[Array, "n n n"]  # [i, j, k]: ψ̃_jk
    his_close: Bool[Array, "n n n"]
    news: Bool[Array, "n n"]  # [i, j]: it came in this very step
    p_then: Float[Array, "n n 3"]  # [i, j]: p_ij, as i saw it itself when that was told [m]
    his_motion: Float[Array, "n n 4"]  # [i, j]: v_j, w_j


class Mind(NamedTuple):
    """What robot i reckons: row i."""

    watch: Float[Array, "n n 7"]  # observers of others' velocities, see `yaw`
    turned: Float[Array, "n n"]  # ψ̃_ij [rad]
    close: Bool[Array, "n n"]  # ψ̃_ij rests on two bearings
    weight: Float[Array, "n n"]  # A_ij
    motion: Float[Array, "n n 4"]  # its gradient: ∂A_ij/∂p_i in the body frame, ∂A_ij/∂ψ_i
    rows: Float[Array, "n n n"]  # the adjacency as far as i knows it
    stamp: Float[Array, "n n"]  # when row k of it was computed [s]
    modes: Float[Array, "n 3 n"]  # eigenvectors as i last had them, where it looks for new ones
    iterate: Iterate
    lambda2: Float[Array, " n"]  # NaN unknown
    felt: Float[Array, "n n"]  # ∂λ₂/∂A_ij
    command: Float[Array, "n 4"]  # velocity in the body frame, yaw rate


class State(NamedTuple):
    """All of it; changed in place from step to step."""

    world: World
    senses: Senses
    mail: Mail
    mind: Mind


def resting(
    position: Float[Array, "n 3"],
    yaw: Float[Array, " n"],
    believed: Float[Array, "n n"],
    late: int,
    obstacles: int,
    rng: np.random.Generator,
) -> State:
    """Everybody at rest, and nothing seen or told yet.

    Args:
        position: Of each robot [m].
        yaw: Of each robot [rad].
        believed: What each takes for the relative yaw of others at first [rad].
        late: How many messages later one arrives.
        obstacles: How many there are.
        rng: Draws where the power iteration begins.
    """
    n, ring = len(position), late + 1
    zero, unseen, ages = np.zeros, np.nan, -np.inf

    def never(*shape: int) -> Array:
        return np.zeros(shape, dtype=bool)

    world = World(
        position.copy(), yaw.copy(), zero((n, 3)), np.ones(n, dtype=bool), zero((n, n)),
        zero(2), np.full(n, np.inf), np.full(n, np.inf),
    )  # fmt: skip
    senses = Senses(
        zero((n, 3)), zero(n), never(n, n), np.full((n, n, 3), unseen), never(n, n),
        np.full((n, n, 3), unseen), zero((n, n + obstacles, 3)), zero(n, dtype=np.int64),
    )  # fmt: skip
    mail = Mail(
        np.full((ring, n, n, 3), unseen), never(ring, n, n), zero((ring, n, n)),
        never(ring, n, n), zero((ring, n, 4)), zero((ring, n, n, n)),
        np.full((ring, n, n), ages), np.full((n, n), ages), np.full((n, n, 3), unseen),
        never(n, n), zero((n, n, n)), never(n, n, n), never(n, n), np.full((n, n, 3), unseen),
        zero((n, n, 4)),
    )  # fmt: skip
    iterate = Iterate(rng.standard_normal(n), zero((n, 2)), zero((n, 2)))
    mind = Mind(
        zero((n, n, 7)), believed.copy(), never(n, n), zero((n, n)), zero((n, n, 4)),
        zero((n, n, n)), np.full((n, n), ages), zero((n, 3, n)), iterate,
        np.full(n, np.nan), zero((n, n)), zero((n, 4)),
    )  # fmt: skip
    return State(world, senses, mail, mind)
