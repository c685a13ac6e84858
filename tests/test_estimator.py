"""Estimates of the agents' own states: the filter, the gate, and the margin for a wrong model."""

import numpy as np
import pytest
from reconfiguration_runs import at_rest, leg_to, make_mission, row

from dynamics import ClohessyWiltshire, DoubleIntegrator
from dynamics.discretize import discretize_zoh
from dynamics.plant import LinearPlant, Plant
from sato.reconfiguration import commitment
from sato.reconfiguration.disturbances import disturb_control, measure
from sato.reconfiguration.estimator import (
    GATE_SIGMAS,
    Estimate,
    correct,
    measurement_covariance,
    predict,
    update,
)
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.offers import make_offers

NOISE = {"position_noise": 0.01, "velocity_noise": 0.003}
ERRORS = {"disturbance": 0.004, "thrust_error": 0.1, "pointing_error": 0.05}


def moving(**changes):
    """Three agents that move side by side."""
    leg = leg_to(at_rest(row(3, 3.0)), 20)
    return make_mission(row(3, 0.0), leg, comm_radius=20.0, replan_steps=1, **changes)


def least_squares(mission, z, u, W):
    """The last state by all measurements and accelerations at once, and its covariance."""
    model, (T, d) = discretize_zoh(mission.linear_model, mission.step, len(u)), u.shape
    n, R = 2 * d, measurement_covariance(mission)
    # Each state is linear in the first one and the accelerations that were not commanded.
    on, known, rows = np.eye(n, n + T * d), np.zeros(n), []
    for k in range(T + 1):
        rows.append((on, known))
        if k < T:
            on, known = model.A[k] @ on, model.A[k] @ known + model.B[k] @ u[k] + model.z[k]
            on[:, n + k * d : n + (k + 1) * d] += model.B[k]
    information = np.zeros((n + T * d, n + T * d))
    information[n:, n:] = np.kron(np.eye(T), np.linalg.inv(W))
    weighted = np.zeros(n + T * d)
    for (on_k, known_k), z_k in zip(rows, z, strict=True):
        information += on_k.T @ np.linalg.inv(R) @ on_k
        weighted += on_k.T @ np.linalg.inv(R) @ (z_k - known_k)
    covariance = np.linalg.inv(information)
    on, known = rows[-1]
    return on @ covariance @ weighted + known, on @ covariance @ on.T


@pytest.mark.parametrize("model", [DoubleIntegrator(2), ClohessyWiltshire(0.05)])
def test_filter_equals_least_squares_over_all_measurements(rng, model):
    d = model.axes
    start = at_rest(row(3, 0.0, d))
    mission = make_mission(start, leg_to(start, 9), model=model, disturbance=0.004, **NOISE)
    u = rng.normal(0.0, 0.05, (9, 3, d))
    z = start + rng.normal(0.0, 0.02, (10, 3, 2 * d))
    estimate = Estimate.none(3, d)
    for k in range(10):
        estimate = update(mission, estimate, z[k])
        if k < 9:
            estimate = predict(mission, estimate, u[k], u[k], k * mission.step)
    for i in range(3):
        mean, covariance = least_squares(mission, z[:, i], u[:, i], 0.004**2 * np.eye(d))
        np.testing.assert_allclose(estimate.mean[i], mean, rtol=0, atol=1e-9)
        np.testing.assert_allclose(estimate.covariance[i], covariance, rtol=1e-7, atol=1e-12)


def follow(mission, rng, agents, steps):
    """True states and estimates of many agents under one control, at every instant."""
    x, u = np.zeros((agents, 4)), np.tile([0.06, -0.03], (agents, 1))
    estimate = Estimate.none(agents, 2)
    for k in range(steps):
        estimate = update(mission, estimate, measure(mission, x, rng))
        yield x, estimate
        estimate = predict(mission, estimate, u, u, k * mission.step)
        applied = disturb_control(mission, u, rng)
        x = mission.flown_plant.propagate(x, applied, k * mission.step, mission.step)[-1]


@pytest.mark.parametrize("errors", [{}, {"disturbance": 0.004}, ERRORS])
def test_errors_of_estimates_are_as_large_as_their_covariance_says(rng, errors):
    agents = 3000
    for x, estimate in follow(moving(**NOISE, **errors), rng, agents, 12):
        error = x - estimate.mean
        scaled = np.linalg.solve(estimate.covariance, error[..., None])[..., 0]
        squared = (error * scaled).sum(axis=1).mean()
        assert abs(squared - 4) < 5 * (8 / agents) ** 0.5  # χ² of four has the variance 8


def drifting(**changes):
    """Three agents in orbit, which plan from their estimates."""
    start = at_rest(row(3, 0.0, 3))
    return make_mission(start, leg_to(start, 9), model=ClohessyWiltshire(1e-3), **changes)


@pytest.mark.parametrize(("sigmas", "is_kept"), [(0.99, True), (1.01, False)])
def test_reference_jumps_to_the_estimate_beyond_the_gate(rng, sigmas, is_kept):
    mission, mean = drifting(**NOISE), rng.normal(size=(1, 6))
    root = rng.normal(0.0, 0.01, (6, 6))
    before = (root @ root.T)[None]
    direction = rng.normal(size=6)
    direction *= sigmas * GATE_SIGMAS / np.linalg.norm(direction)
    P = correct(before, measurement_covariance(mission))
    reference = mean + np.linalg.cholesky(P[0]) @ direction
    after = update(mission, Estimate(mean, before, reference), mean)
    np.testing.assert_allclose(after.mean, mean, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(after.reference, reference if is_kept else after.mean)


def test_measurement_without_noise_is_the_reference(rng):
    mission, x = drifting(disturbance=0.01), rng.normal(size=(3, 6))
    assert update(mission, Estimate.none(3, 3), x).reference is x


def test_velocities_that_are_exact_are_believed(rng):
    for x, estimate in follow(moving(position_noise=0.01), rng, 4, 12):
        np.testing.assert_allclose(estimate.mean[:, 2:], x[:, 2:], rtol=0, atol=1e-4)
    assert (np.abs(estimate.mean - x)[:, :2] < 5 * 0.01 / 12**0.5).all()


def test_agent_that_was_away_begins_with_its_first_measurement(rng):
    mission, x = moving(**NOISE), rng.normal(size=(2, 4))
    estimate = update(mission, Estimate.none(2, 2), x)
    u = np.array([[0.0, 0.0], [np.nan, np.nan]])
    estimate = predict(mission, estimate, u, u, 0.0)
    after = update(mission, estimate, x + 1)
    np.testing.assert_array_equal(after.mean[1], x[1] + 1)
    np.testing.assert_array_equal(after.covariance[1], measurement_covariance(mission))
    assert after.covariance[0, 0, 0] < after.covariance[1, 0, 0]


class Windy(Plant):
    """Double integrators that a wind accelerates."""

    def propagate(self, x, u, t, dt, substeps=1):
        """Add the wind to the controls."""
        return LinearPlant(DoubleIntegrator(2)).propagate(x, u + 0.01, t, dt, substeps)


def test_margin_is_automatic_where_the_plant_is_not_the_model():
    mission = moving(plant=Windy())
    # Two may be moved against each other, by a t²/2 in the step until they plan again.
    assert mission.margin == pytest.approx(2 * 0.01 * 2**0.5 / 2)


@pytest.mark.parametrize(("plant", "most"), [({}, 20), ({"plant": Windy()}, 4)])
def test_plants_that_err_are_committed_to_no_longer_than_the_horizon(plant, most, monkeypatch):
    # The margin covers their errors until the next decision, and not for all that is foreseen.
    mission, found = moving(foresight_steps=16, **plant), []

    def record(*known):
        found.append(make_offers(*known).plan_steps[0])
        return make_offers(*known)

    monkeypatch.setattr(commitment, "make_offers", record)
    next(simulate(mission, np.random.default_rng(0)))
    assert found == [most]
