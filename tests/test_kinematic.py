"""Kinematic vehicle: step size, noise, and integration."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynamics.kinematic import KinematicVehicle, step_kinematic
from dynamics.vehicle import VehicleState

CALM = np.zeros(4)  # no noise


def simulate(plant, command, turn, time, step):
    velocity, still = np.array([0.5, 0.2, 0.0]), np.zeros(3)
    state = VehicleState(still, np.array(0.3), velocity, np.array(0.4), still)
    for _ in range(round(time / step)):
        state = step_kinematic(state, np.append(command, turn), plant, step, CALM)
    return np.array([*state.position, state.yaw, *state.velocity, state.yaw_rate])


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
    errors = [
        abs(simulate(KinematicVehicle(lag), command, turn, 2, h) - end).max() for h in (0.04, 0.02)
    ]
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.3])
def test_all_but_the_horizontal_path_is_independent_of_the_step(lag):
    # Height, yaw and velocities are exact for a command that is held.
    command, turn = np.array([1.0, -0.5, 0.3]), 0.8
    fine, coarse = (simulate(KinematicVehicle(lag), command, turn, 0.6, h) for h in (0.01, 0.3))
    assert fine[2:] == pytest.approx(coarse[2:], abs=1e-12)


def test_actuator_noise_has_the_stated_standard_deviation():
    rng, plant = np.random.default_rng(5), KinematicVehicle(0.0, 0.05)
    zero, still = np.zeros((2000, 3)), np.zeros(2000)
    rest = VehicleState(zero, still, zero, still, zero)
    noise = plant.draw_noise(2000, rng)
    moved = step_kinematic(rest, np.zeros((2000, 4)), plant, 0.02, noise)
    found = np.column_stack([moved.velocity, moved.yaw_rate])
    assert np.std(found, axis=0) == pytest.approx(np.full(4, 0.05), rel=0.07)
