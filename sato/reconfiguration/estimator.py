"""Estimation: each agent filters what it measures of itself, and keeps a reference for its plans.

The filter is that of [Kalman1960], by the model that all agents share. An agent plans from its
reference, the state at which it would be without noise. Double integrators follow theirs by
feedback, see `tracking`. For all others, it stays while the estimate differs from it by no more
than the estimate may err, and no control is spent on noise.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel
from dynamics.plant import NonlinearPlant
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.tracking import measurement_deviations

MAX_DEVIATION = 8.0  # standard deviations, from which a reference that is tracked is given up
GATE_SIGMAS = 3.0  # of the estimate, from which any other reference is given up

Covariance = Float[Array, "*agents n n"]


class Estimate(NamedTuple):
    """Own states as agents know them, a row each; NaN before the first measurement."""

    mean: Float[Array, "agents n"]
    covariance: Covariance
    reference: Float[Array, "agents n"]  # by which they plan

    @classmethod
    def none(cls, agents: int, axes: int) -> "Estimate":
        """Return what agents know before the first measurement."""
        mean = np.full((agents, 2 * axes), np.nan)
        return cls(mean, np.full((*mean.shape, 2 * axes), np.nan), mean)


def update(
    mission: Reconfiguration, estimate: Estimate, measured: Float[Array, "agents n"]
) -> Estimate:
    """Take in what the agents measure; references jump to estimates that differ too much.

    With δ the difference and P the covariance of the estimate, those of which δᵀ P⁻¹ δ > g²; where
    no measurement has noise, all. A reference that is tracked jumps only where its distance is 8
    times the standard deviation of `TrackingDeviations`.
    """
    R = measurement_covariance(mission)
    if not R.any():
        estimate = estimate._replace(mean=measured)
        return estimate._replace(reference=_keep_reference(mission, estimate))
    is_new = np.isnan(estimate.mean).any(axis=1)[:, None]
    before = np.where(is_new[..., None], R, estimate.covariance)
    mean = np.where(is_new, measured, estimate.mean)
    P = np.where(is_new[..., None], R, correct(before, R))
    # The gain K = P R⁻¹ is that of the covariance after the measurement.
    mean = mean + np.einsum("kab,b,kb->ka", P, 1 / np.diag(R), measured - mean)
    found = Estimate(mean, P, np.where(is_new, measured, estimate.reference))
    return found._replace(reference=_keep_reference(mission, found))


def _keep_reference(mission: Reconfiguration, estimate: Estimate) -> Float[Array, "agents n"]:
    """Return the references, or estimates where these are too far from them, or they are none."""
    mean, P, reference = estimate
    off, tracking = mean - reference, mission.tracking
    if tracking is not None:
        away = np.linalg.norm(off[:, : mission.axes], axis=1)
        is_kept = away <= MAX_DEVIATION * tracking.position
    elif measurement_covariance(mission).any():
        distance = np.einsum("ka,ka->k", off, np.linalg.solve(P, off[..., None])[..., 0])
        is_kept = distance <= GATE_SIGMAS**2
    else:
        return mean
    return np.where(is_kept[:, None], reference, mean)


def predict(
    mission: Reconfiguration,
    estimate: Estimate,
    control: Float[Array, "agents d"],
    planned: Float[Array, "agents d"],
    time: float,
) -> Estimate:
    """Predict estimates and references a step ahead, from a time [s] on.

    The controls are those commanded, and those planned without feedback [m/s²]. Agents without a
    control (NaN) are forgotten.
    """
    if not (measurement_covariance(mission).any() or mission.tracking):
        return estimate
    model, count = mission.discretize(1, time), len(control)
    x = np.concatenate([estimate.mean, estimate.reference])
    u = np.concatenate([control, planned])
    x = np.where(np.isfinite(u).all(axis=1)[:, None], x, np.nan)
    if mission.nonlinear_model is not None:
        x = NonlinearPlant(mission.nonlinear_model).propagate(x, u, time, mission.step)[-1]
    else:
        x = model.simulate(x, u[:, None])[:, -1]
    covariance = spread(model, 0, estimate.covariance, control_covariance(mission, control))
    return Estimate(x[:count], covariance, x[count:])


@lru_cache(maxsize=8)
def measurement_covariance(mission: Reconfiguration) -> Float[Array, "n n"]:
    """Return the covariance R of a measurement, which is regular if it is not 0."""
    return np.diag(np.repeat(np.square(measurement_deviations(mission)), mission.axes))


def correct(P: Covariance, R: Float[Array, "n n"]) -> Covariance:
    """Return the covariance of a state after a measurement of covariance R."""
    left = R @ np.linalg.inv(P + R)  # 1 − K
    after = left @ P
    return np.asarray((after + after.swapaxes(-1, -2)) / 2)


def spread(
    model: DiscreteModel, k: int, P: Covariance, W: Float[Array, "*agents d d"]
) -> Covariance:
    """Return the covariance of a state a step later, under accelerations of covariance W."""
    A, B = model.A[k], model.B[k]
    return np.asarray(A @ P @ A.T + B @ W @ B.T)


def control_covariance(
    mission: Reconfiguration, control: Float[Array, "agents d"]
) -> Float[Array, "agents d d"]:
    """Return the covariance of the accelerations of a step, in addition to the commanded ones.

        σ_w² + σ_m² + σ_a² ‖u‖² + (σ_u² − σ_a²) u uᵀ

    with σ_w of disturbances, σ_u and σ_a of the size and the direction of thrusts, and σ_m what
    would err in a step as the model does at most.
    """
    along = control[:, :, None] * control[:, None]
    size = np.trace(along, axis1=1, axis2=2)[:, None, None]
    thrust, pointing = mission.thrust_error**2, mission.pointing_error**2
    same = mission.disturbance**2 + model_acceleration(mission) ** 2 + pointing * size
    return np.asarray(same * np.eye(mission.axes) + (thrust - pointing) * along)


@lru_cache(maxsize=8)
def model_acceleration(mission: Reconfiguration) -> float:
    """Return the acceleration that moves an agent in a step as far as the model errs [m/s²]."""
    from sato.reconfiguration.tolerances import model_error

    return 2 * model_error(mission, 1) / mission.step**2
