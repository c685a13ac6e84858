"""Estimator of relative yaw: kinematics, observer, bearings and corrections."""

from itertools import pairwise

import numpy as np
import pytest
from connectivity_cast import connected_poses, fly, posed
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from dynamics.kinematic import KinematicVehicle, step_kinematic
from dynamics.vehicle import VehicleState, rotate_by_yaw
from problems.interaction_graph import Camera, bearings, lambda2_gradient
from sato.connectivity.controller import negative_slope
from sato.connectivity.settings import Potential, Repulsion, YawTracking
from sato.connectivity.state import Knowledge
from sato.connectivity.yaw_estimator import (
    circular_mean,
    estimate_relative_yaw,
    update_velocity_observer,
    update_yaw_estimate,
    wrap_angle,
    yaw_from_bearings,
    yaw_from_motion,
)

TRACK = YawTracking()
AHEAD = -np.pi / 4  # yaw with which the camera looks along x
ANGLES = st.floats(-np.pi, np.pi)
SEEDS = st.integers(0, 2**32 - 1)


def apart(a, b):
    """Compute the angle between two directions."""
    return abs(np.angle(np.exp(1j * (a - b))))


def pose(rng):
    """Draw positions, yaws, and body-frame velocities and yaw rates of two robots."""
    return (
        rng.uniform(-4, 4, (2, 3)), rng.uniform(-np.pi, np.pi, 2),
        rng.uniform(-2, 2, (2, 3)), rng.uniform(-1, 1, 2),
    )  # fmt: skip


def seen(position, yaw):
    """p_ij and p_ji."""
    distance, bearing = bearings(position, yaw)
    return distance[0, 1] * bearing[0, 1], distance[0, 1] * bearing[1, 0]


def on(position, yaw, velocity, rate, dt):
    """Advance both robots by a step."""
    state = VehicleState(position, yaw, velocity, rate, np.zeros((2, 3)))
    command = np.column_stack([velocity, rate])
    return step_kinematic(state, command, KinematicVehicle(), dt, np.zeros((2, 4)))[:2]


def watched(position, yaw, velocity, rate, dt, time, track=TRACK):
    """Run the observer for a time; return it with the final yaws."""
    watch, (before, _) = np.zeros(7), seen(position, yaw)
    told = np.append(velocity[1], rate[1])
    for _ in range(round(time / dt)):
        position, yaw = on(position, yaw, velocity, rate, dt)
        p, _ = seen(position, yaw)
        watch = update_velocity_observer(p, before, velocity[0], rate[0], told, watch, track, dt)
        before = p
    return watch, yaw


@pytest.mark.parametrize("printed", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_observer_tends_to_the_filtered_velocity_of_the_other(seed, printed):
    # As printed, through a filter that turns with the robot; ours rests in space.
    rng, time, track = np.random.default_rng(seed), 0.64, TRACK._replace(as_printed=printed)
    position, yaw, v, w = pose(rng)

    def lag(t, e):
        frame = yaw[0] + w[0] * t if printed else 0.0
        return TRACK.k1 * (rotate_by_yaw(v[1], yaw[1] + w[1] * t - frame) - e)

    e = solve_ivp(lag, (0, time), np.zeros(3), rtol=1e-10, atol=1e-12).y[:, -1]
    true = e if printed else rotate_by_yaw(e, -(yaw[0] + w[0] * time))
    steps = (0.02, 0.01, 0.005, 0.0025)
    errors = [abs(watched(position, yaw, v, w, h, time, track)[0][:3] - true).max() for h in steps]
    # Of first order at least: half the step, half the error.
    assert all(finer < 0.6 * coarser for coarser, finer in pairwise(errors))
    assert errors[-1] < 0.01


@pytest.mark.parametrize("seed", range(5))
def test_received_velocity_passes_the_filter_of_the_observed_one(seed):
    rng = np.random.default_rng(seed)
    position, yaw, v, w = pose(rng)
    coarse, fine = (watched(position, yaw, v, w, h, 0.4) for h in (0.02, 0.005))
    off = [
        apart(np.arctan2(x[1], x[0]) - np.arctan2(x[4], x[3]), end[1] - end[0])
        for x, end in (coarse, fine)
    ]
    assert off[0] < 0.05
    assert off[1] < 0.3 * off[0] + 1e-9


@given(SEEDS)
def test_hovering_robot_finds_the_yaw_of_a_moving_one_at_once(seed):
    rng = np.random.default_rng(seed)
    position, yaw, v, _ = pose(rng)
    v[0], dt, watch, still = 0.0, 0.02, np.zeros(7), np.array(0.0)
    before, _ = seen(position, yaw)
    for number in range(40):
        v[1] = rng.uniform(-2, 2, 3) if number % 7 == 0 else v[1]
        position, yaw = on(position, yaw, v, np.zeros(2), dt)
        p, _ = seen(position, yaw)
        told = np.append(v[1], 0)
        watch = update_velocity_observer(p, before, v[0], still, told, watch, TRACK, dt)
        before = p
        guessed, trust = yaw_from_motion(watch, told, TRACK)
        if np.hypot(*watch[3:5]) > 1e-3:
            assert apart(guessed, yaw[1] - yaw[0]) < 1e-9
        # It is trusted only when the filter has forgotten that it began at zero.
        assert trust == 0 or (number + 1) * dt >= 3 / TRACK.k1 - 1e-9


def test_new_sighting_resets_the_observer(rng):
    watch, p, v = rng.normal(size=7), rng.normal(size=3), rng.normal(size=3)
    rate, told, unseen = np.array(0.3), np.append(v, 0.1), np.full(3, np.nan)
    assert not update_velocity_observer(p, unseen, v, rate, told, watch, TRACK, 0.02).any()


@given(SEEDS)
def test_two_bearings_give_the_relative_yaw(seed):
    position, yaw, _, _ = pose(np.random.default_rng(seed))
    assert apart(yaw_from_bearings(*seen(position, yaw)), yaw[1] - yaw[0]) < 1e-9


@pytest.mark.parametrize("is_new", [True, False])
def test_bearings_correct_the_yaw_only_when_their_message_arrives(is_new):
    # Between messages an agent may turn in ways that the message does not tell.
    position, yaw = np.array([[0.0, 0, 0], [4, 0, 0]]), np.array([AHEAD, AHEAD + np.pi])
    mine, theirs = seen(position, yaw)
    away = np.full((2, 2, 3), np.nan)
    away[0, 1], away[1, 0] = mine, theirs
    believed = np.array([[0.0, 2.5], [-2.5, 0.0]])
    known = Knowledge.at_start(believed, np.random.default_rng(0))
    measured = known.measurements._replace(relative_position=away)
    inbox = known.inbox._replace(
        time=np.zeros((2, 2)),
        is_new=np.full((2, 2), is_new),
        relative_position=away.swapaxes(0, 1),
        own_relative_position=away,
        relative_yaw=np.tile(believed, (2, 1, 1)),
    )
    known = known._replace(measurements=measured, inbox=inbox)
    found, _ = estimate_relative_yaw(known, posed(position, yaw), 0.01)
    nearer = apart(found[0, 1], np.pi) < apart(2.5, np.pi) - 1e-6
    assert nearer if is_new else found[0, 1] == 2.5


@given(ANGLES, ANGLES)
def test_circular_mean_is_equally_far_from_both_angles(mine, theirs):
    mean = circular_mean(mine, -theirs)
    assert apart(mean, mine) == pytest.approx(apart(mean, -theirs), abs=1e-6)
    assert apart(mean, mine) <= np.pi / 2 + 1e-6  # and not opposite
    assert apart(circular_mean(mine, mine), mine) < 1e-9


@given(st.floats(-30, 30))
def test_wrapped_angle_is_the_same_angle(angle):
    assert -np.pi <= wrap_angle(angle) <= np.pi
    assert apart(wrap_angle(angle), angle) < 1e-12


@given(ANGLES, st.floats(-3.0, 3.0), st.floats(0.1, 1), st.booleans())
def test_corrections_converge_to_the_measured_yaw(yaw, off, share, mutual):
    # e⁺ = e − dt k sin e, at k ≥ 1/s for 12 s: tan e/2 falls from at most 14 to less than 1e-4.
    true, believed, turn, dt = yaw, wrap_angle(yaw + off), 0.4, 0.02
    for _ in range(600):
        before = apart(believed, true)
        if mutual:
            believed = update_yaw_estimate(believed, turn, share, true, 9.9, 0.0, TRACK, dt)
        else:
            believed = update_yaw_estimate(believed, turn, 0.0, 9.9, true, share, TRACK, dt)
        true += dt * turn
        assert apart(believed, true) <= before + 1e-12
    assert apart(believed, true) < 1e-3


@given(ANGLES, st.floats(0, 0.099), ANGLES, st.floats(0.5, 5))
def test_without_motion_the_error_of_yaw_stays(off, speed, way, climb):
    # Motion up and down tells nothing of yaw, however fast.
    psi = 0.4
    v = np.array([speed * np.cos(way), speed * np.sin(way), climb])
    position, yaw = np.array([[0.0, 0, 0], [3, 1, 0]]), np.array([0.0, psi])
    watch, _ = watched(position, yaw, np.array([np.zeros(3), v]), np.zeros(2), 0.02, 0.4)
    told = np.append(v, 0.0)
    guessed, trust = yaw_from_motion(watch, told, TRACK)
    assert trust == 0
    believed = wrap_angle(psi + off)
    assert update_yaw_estimate(believed, 0.0, 0.0, 0.0, guessed, trust, TRACK, 0.02) == believed
    # The printed estimator counts the climb as motion.
    assert yaw_from_motion(watch, told, TRACK._replace(as_printed=True))[1] == 1


@pytest.mark.parametrize("seed", range(10))
def test_first_commands_follow_the_true_gradient(seed):
    rng = np.random.default_rng(seed)
    position, yaw = connected_poses(rng)
    gentle = Potential(strength=1e-6, of="lambda2")  # so that nothing is cut off
    mission = posed(
        position, yaw, duration=0.02, estimator="exact", potential=gentle,
        repulsion=Repulsion(strength=0.0),
    )  # fmt: skip
    frame, _ = fly(mission)
    true, steep = lambda2_gradient(position, yaw, Camera()), negative_slope(frame.lambda2, gentle)
    slope = rotate_by_yaw(frame.velocity_command, yaw) / steep
    assert slope == pytest.approx(true.position, abs=1e-12)
    assert frame.yaw_rate / steep == pytest.approx(true.yaw, abs=1e-12)
    # The action pulls nobody but by the others: before it is cut off it sums up to nothing.
    assert slope.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
