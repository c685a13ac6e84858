"""Tracking: a double integrator with noise flies by its reference, near which feedback keeps it.

The reference is the state that an agent plans and commits to. It moves as the model says, without
noise, so that plans are kept, and what is proven of them holds for the references. The agent flies

    u = ū + K (x̄ − x̂)

with its estimate x̂ and the gain K of a linear-quadratic regulator [Kalman1960]. The margin is how
far two may be from their references.
"""

from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

if TYPE_CHECKING:
    from sato.reconfiguration.planned_limits import PlannedLimits

CONTROL_WEIGHT = 3.0  # of (u Δt²)², over the square of the distance from the reference
NOISE_FLOOR = 1e-3  # a velocity is measured no better than by a position so much better in a step
MAX_STEPS = 1000  # after which errors no longer grow
RESERVE_SIGMAS = 4.0  # of the feedback, which plans leave of the limit of the control
MAX_RESERVE = 0.75  # of the limit


class TrackingDeviations(NamedTuple):
    """Largest standard deviations of agents from their references, along an axis."""

    position: float  # [m]
    velocity: float  # [m/s]
    feedback: float  # [m/s²]


@lru_cache(maxsize=8)
def feedback_gain(step: float) -> Float[Array, " 2"]:
    """Return the gain K on position [1/s²] and velocity [1/s]."""
    from scipy.linalg import solve_discrete_are

    A, B = _axis(1.0)  # in units of the step
    weight = np.array([[CONTROL_WEIGHT]])
    X = solve_discrete_are(A, B, np.diag([1.0, 0.0]), weight)
    return np.asarray(np.linalg.solve(B.T @ X @ B + weight, B.T @ X @ A)[0] / [step**2, step])


def _axis(h: float) -> tuple[Float[Array, "2 2"], Float[Array, "2 1"]]:
    return np.array([[1.0, h], [0.0, 1.0]]), np.array([[h**2 / 2], [h]])


@lru_cache(maxsize=8)
def compute_deviations(
    step: float, position: float, velocity: float, acceleration: float, begin: int = 0
) -> TrackingDeviations:
    """Compute how far agents are from their references, from a step on.

    The error is that of an estimate, which begins with the first measurement, plus the distance of
    the estimate from the reference, which is independent of it. Standard deviations are those of
    measured positions [m] and velocities [m/s], the latter positive if the former are, and of
    accelerations that are not commanded [m/s²].
    """
    (A, B), K = _axis(step), feedback_gain(step)[None]
    R, closed, is_exact = np.diag([position**2, velocity**2]), A - B @ K, position == 0
    P, S, W, most = R, np.zeros((2, 2)), acceleration**2 * B @ B.T, np.zeros(3)
    for k in range(MAX_STEPS + 1):
        found = np.append(np.diag(P + S), K @ S @ K.T)
        most = np.maximum(most, found) if k >= min(begin, MAX_STEPS) else most
        before = A @ P @ A.T + W
        P = R if is_exact else before - before @ np.linalg.solve(before + R, before)
        S = closed @ S @ closed.T + before - P
    return TrackingDeviations(*np.sqrt(most).tolist())


def measurement_deviations(mission: "PlannedLimits") -> tuple[float, float]:
    """Return the standard deviations of measured positions [m] and velocities [m/s]."""
    position, velocity, h = mission.position_noise, mission.velocity_noise, mission.step
    floors = NOISE_FLOOR * velocity * h, NOISE_FLOOR * position / h
    return max(position, floors[0]), max(velocity, floors[1])


def largest_disturbance(mission: "PlannedLimits") -> float:
    """Return the deviation of accelerations that are not commanded, in the worst direction [m/s²].

    Under full control.
    """
    most = max(limit.largest_length for limit in mission.control_limits)
    # Errors of size are along the thrust, and those of direction across it.
    thrust = most * max(mission.thrust_error, mission.pointing_error)
    return float(np.hypot(mission.disturbance, thrust))


def add_feedback(
    mission: "PlannedLimits",
    control: Float[Array, "agents d"],
    reference: Float[Array, "agents n"],
    mean: Float[Array, "agents n"],
) -> Float[Array, "agents d"]:
    """Return planned controls with the feedback, within the limits [m/s²].

    They are NaN for agents that are not there.
    """
    if mission.tracking is None:
        return control
    off = (reference - mean).reshape(len(control), 2, -1)
    wanted = control + np.einsum("p,apd->ad", feedback_gain(mission.step), off)
    for i in np.flatnonzero(np.isfinite(wanted).all(axis=1)).tolist():
        wanted[i] = mission.control_limit(i).cut(wanted[i])
    return np.asarray(wanted)
