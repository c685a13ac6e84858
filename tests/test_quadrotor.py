"""Quadrotor: limits, equilibrium, symmetry, and integration."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from dynamics.quadrotor import STANDARD_GRAVITY, Quadrotor, rotate_to_heading_frame, step_quadrotor
from dynamics.vehicle import VehicleState, rotate_by_yaw

PLANT = Quadrotor()
VELOCITIES = st.tuples(*[st.floats(-8, 8)] * 3).map(np.array)
ANGLES = st.floats(-np.pi, np.pi)


def simulate(velocity, yaw, command, turn, time, step, rate=0.0, begin=(0.0, 0.0, 0.0)):
    """Return the position, yaw, velocity, yaw rate and acceleration at every step."""
    ahead, yaw = rotate_by_yaw(velocity.astype(float), -yaw), np.array(yaw)
    states = [VehicleState(np.zeros(3), yaw, ahead, np.array(rate), np.array(begin))]
    for _ in range(round(time / step)):
        states.append(step_quadrotor(states[-1], np.append(command, turn), PLANT, step))
    position, yaw, ahead, rate, acceleration = map(np.array, zip(*states, strict=True))
    velocity = rotate_by_yaw(ahead, yaw)
    return np.column_stack([position, yaw, velocity, rate, acceleration])


def test_hover_is_an_equilibrium():
    states = simulate(np.zeros(3), 0.7, np.zeros(3), 0.0, 10.0, 0.02)
    assert np.array_equal(states, np.tile(states[0], (501, 1)))


@given(VELOCITIES, VELOCITIES, ANGLES)
def test_acceleration_stays_within_tilt_and_vertical_limits(velocity, command, yaw):
    acceleration = simulate(velocity, yaw, command, 1.0, 3.0, 0.02)[:, 8:]
    tilt = np.arctan2(
        np.hypot(acceleration[:, 0], acceleration[:, 1]), STANDARD_GRAVITY + acceleration[:, 2]
    )
    assert tilt.max() <= PLANT.max_tilt + 1e-12
    assert np.abs(acceleration[:, 2]).max() <= PLANT.max_vertical_acceleration + 1e-12


@given(VELOCITIES, ANGLES)
def test_braking_does_not_overshoot(velocity, yaw):
    # The two loops, 0.08 s and 0.4 s, are overdamped: 4 × 0.08 < 0.4.
    states = simulate(velocity, yaw, np.zeros(3), 0.0, 6.0, 0.02)
    v = states[:, 4:7]
    assert (np.diff((v**2).sum(axis=1)) <= 1e-12).all()
    assert (v @ np.diag(velocity) >= -1e-9).all()
    assert np.abs(v[-1]).max() < 1e-3


@given(VELOCITIES, VELOCITIES, ANGLES, ANGLES)
def test_motion_is_invariant_to_rotations_about_the_vertical(velocity, command, yaw, turn):
    c, s = np.cos(turn), np.sin(turn)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    here = simulate(velocity, yaw, command, 0.5, 2.0, 0.02)
    there = simulate(R @ velocity, yaw + turn, command, 0.5, 2.0, 0.02)
    assert there[:, :3] == pytest.approx(here[:, :3] @ R.T, abs=1e-9)
    assert there[:, 8:] == pytest.approx(here[:, 8:] @ R.T, abs=1e-9)


@pytest.mark.parametrize("command", [(1.0, -0.5, 0.3), (6.0, 3.0, -4.0)])
def test_steps_agree_with_integration_to_first_order(command):
    # The second command saturates both limits for a while.
    velocity, turn, time = np.array([0.5, 0.2, 0.0]), 0.8, 1.28

    def rates(_, x):
        yaw, v, w, a = x[3], x[4:7], x[7], x[8:]
        c, s = np.cos(yaw), np.sin(yaw)
        wanted = np.array([c * command[0] - s * command[1], s * command[0] + c * command[1]])
        flat = (wanted - v[:2]) / PLANT.velocity_time_constant
        up = np.clip(
            (command[2] - v[2]) / PLANT.velocity_time_constant,
            -PLANT.max_vertical_acceleration,
            PLANT.max_vertical_acceleration,
        )
        flat = flat * min(
            1, (STANDARD_GRAVITY + up) * np.tan(PLANT.max_tilt) / np.linalg.norm(flat)
        )
        follows = (np.array([*flat, up]) - a) / PLANT.attitude_time_constant
        return np.array([*v, w, *a, (turn - w) / PLANT.attitude_time_constant, *follows])

    begin = [0, 0, 0, 0.3, *velocity, 0.1, 0.4, -0.2, 0.3]
    end = solve_ivp(rates, (0, time), begin, rtol=1e-9, atol=1e-11, max_step=0.01).y[:, -1]
    errors = []
    for step in (0.02, 0.01, 0.005):
        states = simulate(velocity, 0.3, np.array(command), turn, time, step, 0.1, begin[8:])
        errors.append(np.abs(states[-1] - end).max())
    # The velocity is fed back once a step.
    assert all(coarse / fine == pytest.approx(2, rel=0.2) for coarse, fine in pairwise(errors))
    assert errors[-1] < 0.03


def test_commands_are_reached_in_steady_state():
    command = np.array([2.0, -1, 0.4])
    straight = simulate(np.zeros(3), 0.7, command, 0.0, 12.0, 0.02)
    c, s = np.cos(0.7), np.sin(0.7)
    assert straight[-1, 4:7] == pytest.approx([2 * c + s, 2 * s - c, 0.4], abs=1e-6)
    assert straight[-1, 8:] == pytest.approx(np.zeros(3), abs=1e-6)
    # In a steady turn the velocity rotates too, and lags the command by both loops: at
    # w = 0.5/s the response of 1/(1 + 0.4 s + 0.4 × 0.08 s²) at s = iw.
    turning = simulate(np.zeros(3), 0.7, command, 0.5, 40.0, 0.002)
    assert turning[-1, 7] == pytest.approx(0.5, abs=1e-9)
    wanted = (2 - 1j) * np.exp(1j * turning[-1, 3])
    lagging = wanted / (1 + 0.4 * 0.5j + 0.4 * 0.08 * (0.5j) ** 2)
    assert turning[-1, 4] + 1j * turning[-1, 5] == pytest.approx(lagging, abs=5e-3)


def test_the_body_frame_tilts_with_the_thrust(rng):
    axis, turn = np.array([1.0, 0, 0]), np.array(0.4)
    rotated = rotate_to_heading_frame(axis, np.zeros(3), turn)
    assert rotated == pytest.approx(axis, abs=1e-15)
    # Forward acceleration pitches down: the forward body axis then points down.
    forward = STANDARD_GRAVITY * np.array([np.cos(0.4), np.sin(0.4), 0])
    rotated = rotate_to_heading_frame(axis, forward, turn)
    assert rotated == pytest.approx([np.sqrt(0.5), 0, -np.sqrt(0.5)], abs=1e-12)
    for _ in range(20):
        acceleration, yaw = rng.normal(0, 3, 3), np.array(rng.uniform(-np.pi, np.pi))
        body = np.array([rotate_to_heading_frame(e, acceleration, yaw) for e in np.eye(3)])
        assert body @ body.T == pytest.approx(np.eye(3), abs=1e-12)
        thrust = acceleration + np.array([0, 0, STANDARD_GRAVITY])
        c, s = np.cos(yaw), np.sin(yaw)
        ahead = np.array([c * thrust[0] + s * thrust[1], c * thrust[1] - s * thrust[0], thrust[2]])
        assert body[2] == pytest.approx(ahead / np.linalg.norm(thrust), abs=1e-12)
