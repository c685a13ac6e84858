"""References of double integrators, the feedback that keeps agents near them, and its margin."""

from dataclasses import replace

import numpy as np
import pytest
from reconfiguration_runs import at_rest, fly, leg_to, make_mission, min_separation, row
from scipy.linalg import solve_discrete_lyapunov

from sato.reconfiguration.disturbances import disturb_control, measure
from sato.reconfiguration.estimator import MAX_DEVIATION, Estimate, predict, update
from sato.reconfiguration.tolerances import MARGIN_SIGMAS
from sato.reconfiguration.tracking import add_feedback, feedback_gain

NOISE = {"position_noise": 0.01, "velocity_noise": 0.003}
ERRORS = [NOISE, {"disturbance": 0.004}, NOISE | {"disturbance": 0.004, "thrust_error": 0.02}]
STEPS = 30


def moving(**changes):
    """Three agents that move side by side."""
    leg = leg_to(at_rest(row(3, 3.0)), 20)
    return make_mission(row(3, 0.0), leg, comm_radius=20.0, **changes)


def far(**changes):
    """A mission with time enough for vehicles of little control."""
    return make_mission(row(3, 0.0), leg_to(at_rest(row(3, 3.0)), 60), comm_radius=20.0, **changes)


def track(mission, rng, agents, way=(1.0, 0.0)):
    """States and estimates of agents that start, and brake again, as hard as plans may."""
    x, estimate = np.zeros((agents, 2 * mission.axes)), Estimate.none(agents, mission.axes)
    most = mission.planned_control_limit(0).most
    for k in range(STEPS):
        estimate = update(mission, estimate, measure(mission, x, rng))
        yield x, estimate
        planned = np.tile(most * ((k < 4) - (10 <= k < 14.0)) * np.array(way), (agents, 1))
        control = add_feedback(mission, planned, estimate.reference, estimate.mean)
        estimate = predict(mission, estimate, control, planned, k * mission.step)
        x = mission.flown_plant.propagate(x, disturb_control(mission, control, rng), 0.0, 1.0)[-1]


@pytest.mark.parametrize("errors", ERRORS)
def test_margin_covers_two_agents_and_is_not_far_above(rng, errors):
    mission, worst = moving(**errors), 0.0
    for x, estimate in track(mission, rng, 4000):
        error = (x - estimate.reference)[:, :2]
        worst = max(worst, np.abs(error[::2] - error[1::2]).max())
    assert worst < mission.margin < 2 * worst


@pytest.mark.parametrize(
    ("norm", "way"), [("inf", (1.0, 1.0)), (2, (0.8, 0.6)), (1, (0.5, 0.5)), (1, (1.0, 0.0))]
)
@pytest.mark.parametrize(
    "errors", [{"thrust_error": 0.05}, {"pointing_error": 0.05}, {"disturbance": 0.01}]
)
def test_margin_has_five_sigmas_whatever_the_direction(rng, norm, way, errors):
    mission, most = moving(control_norm=norm, **errors), 0.0
    for x, estimate in track(mission, rng, 4000, way):
        error = (x - estimate.reference)[:, :2]
        for unit in (np.array(way), np.array([-way[1], way[0]])):
            off = (error[::2] - error[1::2]) @ unit / np.linalg.norm(unit)
            most = max(most, off.std())
    assert MARGIN_SIGMAS * most < 1.05 * mission.margin


@pytest.mark.parametrize("errors", ERRORS)
def test_references_move_as_planned_without_noise(rng, errors):
    first, *_, last = (estimate.reference for _, estimate in track(moving(**errors), rng, 50))
    most = moving(**errors).planned_control_limit(0).most
    way = (STEPS - 1) * first[:, 2:] + [40 * most, 0.0]  # 4 steps at 4 U, 6 and 4 at that speed
    np.testing.assert_allclose(last, first + np.hstack([way, 0 * way]), rtol=0, atol=1e-12)


def test_deviations_are_those_of_the_closed_loop_at_rest():
    mission, K = moving(disturbance=0.004), feedback_gain(1.0)[None]
    A, B = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.5], [1.0]])
    S = solve_discrete_lyapunov(A - B @ K, 0.004**2 * B @ B.T)
    expected = *np.diag(S) ** 0.5, (K @ S @ K.T).item() ** 0.5
    np.testing.assert_allclose(mission.tracking, expected, rtol=1e-6)
    assert mission.margin == pytest.approx(MARGIN_SIGMAS * (2 * S[0, 0]) ** 0.5)


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_gain_does_not_depend_on_units(factor):
    here = feedback_gain(1.0)
    np.testing.assert_allclose(feedback_gain(factor) * [factor**2, factor], here, rtol=1e-12)
    calm = moving(**NOISE)
    slow = replace(calm, step=factor, velocity_noise=calm.velocity_noise / factor)
    assert slow.tracking.position == pytest.approx(calm.tracking.position, rel=1e-9)


def test_margin_is_automatic_with_noise_and_grows_with_it():
    calm, loud = moving(), moving(**NOISE)
    assert calm.margin == 0.0 and calm.tracking is None
    assert loud.margin >= 5 * 2**0.5 * NOISE["position_noise"]
    louder = moving(position_noise=0.02, velocity_noise=0.006)
    assert louder.margin == pytest.approx(2 * loud.margin, rel=1e-9)


def test_plans_leave_control_for_the_feedback_and_flights_keep_the_limit():
    calm, loud = moving(), moving(disturbance=0.01)
    most, planned = loud.control_limit(0).most, loud.planned_control_limit(0).most
    assert most - planned == pytest.approx(loud.reserve)
    assert calm.planned_control_limit(0) == calm.control_limit(0)
    strong = np.concatenate([np.abs(frame.control) for frame in fly(loud)[:-1]])
    assert planned < strong.max() <= most


def test_control_that_is_weak_against_noise_is_doubted():
    weak, strong = (far(disturbance=noise) for noise in (0.03, 0.01))
    assert weak.planned_control_limit(0).most == pytest.approx(0.1 / 4)
    assert not strong.warnings()
    (doubt,) = weak.warnings()
    assert "max_control_m_s2 = 0.17" in doubt
    assert not replace(weak, max_control=0.18).warnings()
    (doubt,) = far(thrust_error=0.3, max_speed=0.2).warnings()
    assert "max_control" not in doubt


def test_margin_below_that_of_the_noise_is_doubted():
    (doubt,) = moving(**NOISE, margin=0.0).warnings()
    assert doubt.startswith("plan.margin_m = 0 m is less than the 0.07")


@pytest.mark.parametrize(("sigmas", "is_kept"), [(0.99, True), (1.01, False)])
def test_reference_that_noise_does_not_explain_is_given_up(rng, sigmas, is_kept):
    mission, mean = moving(disturbance=0.004), rng.normal(size=(1, 4))
    way = rng.normal(size=2)
    way *= sigmas * MAX_DEVIATION * mission.tracking.position / np.linalg.norm(way)
    reference = mean + np.append(way, [0.0, 0.0])
    after = update(mission, Estimate(mean, np.zeros((1, 4, 4)), reference), mean)
    np.testing.assert_array_equal(after.reference, reference if is_kept else mean)


def test_agents_with_noise_keep_the_plans_of_the_same_mission_without():
    frames = fly(moving(**NOISE, disturbance=0.003))
    replans = [k for k, f in enumerate(frames) for e in f.events if e["kind"] == "replan"]
    assert replans == [0]


def fuel(frames):
    return sum(np.abs(frame.control).sum() for frame in frames[:-1])


@pytest.mark.parametrize(("errors", "most"), [({}, 1.3), ({"disturbance": 0.003}, 2.0)])
def test_noise_costs_little_fuel(errors, most):
    quiet, loud = (moving(**noise) for noise in ({}, NOISE | errors))
    frames = fly(loud)
    assert fuel(frames) < most * fuel(fly(quiet))
    assert min_separation(loud, frames) >= 0.5
    end, targets = frames[-1], loud.legs[0].targets[frames[-1].target_index]
    away = np.linalg.norm(end.position - targets[:, :2], axis=1)
    assert away.max() < loud.position_tolerance < 8 * away.max()
