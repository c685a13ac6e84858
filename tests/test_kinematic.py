"""Vehicles that are told how fast to go, by themselves and against integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynamics.kinematic import Kinematic, drive
from dynamics.quadrotor import GRAVITY, Quadrotor, fly, tilted


def driven(plant, command, turn, time, step, rng=None):
    position, velocity, yaw, rate = np.zeros(3), np.array([0.5, 0.2, 0.0]), 0.3, 0.4
    for _ in range(round(time / step)):
        yaw, rate = drive(
            position, yaw, velocity, rate, command, turn, plant, step,
            rng or np.random.default_rng(0),
        )  # fmt: skip
    return np.array([*position, yaw, *velocity, rate])


@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_steps_agree_with_integration_to_second_order(lag):
    command, turn = np.array([1.0, -0.5, 0.3]), 0.8

    def rates(_, x):
        yaw, v, w = x[3], x[4:7], x[7]
        c, s = np.cos(yaw), np.sin(yaw)
        moves = [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2], w]
        return [*moves, *(command - v) / lag, (turn - w) / lag] if lag else [*moves, 0, 0, 0, 0]

    begin = [0, 0, 0, 0.3, 0.5, 0.2, 0.0, 0.4] if lag else [0, 0, 0, 0.3, *command, turn]
    end = solve_ivp(rates, (0, 2), begin, rtol=1e-11, atol=1e-12).y[:, -1]
    errors = [abs(driven(Kinematic(lag), command, turn, 2, h) - end).max() for h in (0.04, 0.02)]
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.3])
def test_how_time_is_cut_matters_to_the_path_alone(lag):
    # Height, yaw and velocities are exact for a command that is held.
    command, turn = np.array([1.0, -0.5, 0.3]), 0.8
    fine, coarse = (driven(Kinematic(lag), command, turn, 0.6, h) for h in (0.01, 0.3))
    assert fine[2:] == pytest.approx(coarse[2:], abs=1e-12)


def test_noise_of_actuators_is_of_the_size_that_is_said():
    rng, plant = np.random.default_rng(5), Kinematic(0.0, 0.05)
    found = []
    for _ in range(2000):
        velocity = np.zeros(3)
        _, rate = drive(np.zeros(3), 0.0, velocity, 0.0, np.zeros(3), 0.0, plant, 0.02, rng)
        found.append([*velocity, rate])
    assert np.std(found, axis=0) == pytest.approx(np.full(4, 0.05), rel=0.07)


def test_a_quadrotor_comes_to_the_velocity_that_is_asked_for_and_tilts_on_the_way():
    plant, position, velocity, push = Quadrotor(), np.zeros(3), np.zeros(3), np.zeros(3)
    yaw, rate, most = 0.7, 0.0, 0.0
    for _ in range(400):
        yaw, rate = fly(
            position, yaw, velocity, rate, push, np.array([3.0, 0, 0.5]), 0.0, plant, 0.02
        )
        most = max(most, np.hypot(*push[:2]))
    assert velocity == pytest.approx([3 * np.cos(0.7), 3 * np.sin(0.7), 0.5], abs=1e-3)
    assert 0.5 * GRAVITY * np.tan(plant.tilt) < most <= GRAVITY * np.tan(plant.tilt) + 1e-12


def test_the_camera_tilts_with_the_thrust(rng):
    axis, turned = np.array([1.0, 0, 0]), np.zeros(3)
    tilted(axis, np.zeros(3), 0.4, turned)
    assert turned == pytest.approx(axis, abs=1e-15)
    # To speed up ahead it pitches down: the thrust leans forward, and what looked ahead looks down.
    tilted(axis, GRAVITY * np.array([np.cos(0.4), np.sin(0.4), 0]), 0.4, turned)
    assert turned == pytest.approx([np.sqrt(0.5), 0, -np.sqrt(0.5)], abs=1e-12)
    for _ in range(20):
        push, yaw = rng.normal(0, 3, 3), rng.uniform(-np.pi, np.pi)
        body = []
        for unit in np.eye(3):
            tilted(unit, push, yaw, turned)
            body.append(turned.copy())
        assert np.array(body) @ np.array(body).T == pytest.approx(np.eye(3), abs=1e-12)
        thrust = push + np.array([0, 0, GRAVITY])
        c, s = np.cos(yaw), np.sin(yaw)
        ahead = np.array([c * thrust[0] + s * thrust[1], c * thrust[1] - s * thrust[0], thrust[2]])
        assert body[2] == pytest.approx(ahead / np.linalg.norm(thrust), abs=1e-12)
