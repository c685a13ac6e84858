"""Coordinate frames: round trips, rotation, and the axis convention."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from orbit_examples import inertial_states

from dynamics.atmosphere import Atmosphere
from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
from dynamics.forces import Forces
from dynamics.orbit import K_J2
from dynamics.propagation import propagate

angle = st.floats(-np.pi, np.pi)
NEAR = np.repeat([2e4, 20.0], 3)  # scale of relative states [m, m/s]


@st.composite
def states(draw):
    """Inertial states on any ellipse with 0 ≤ e ≤ 0.9, of any inclination."""
    e, perigee = draw(st.floats(0, 0.9)), draw(st.floats(6.6e6, 2e7))
    tilt = draw(st.one_of(st.floats(0, np.pi), st.sampled_from([0.0, np.pi, np.pi / 2])))
    return inertial_states(perigee / (1 - e), e, tilt, draw(angle), draw(angle), draw(angle))


def relative_states(rng, shape):
    return rng.uniform(-1, 1, (*shape, 6)) * NEAR


@given(states(), st.integers(0, 2**32 - 1))
def test_offsets_survive_the_round_trip_within_a_nanometer(chief, seed):
    rng = np.random.default_rng(seed)
    frame = LVLH.from_state(chief, rng.normal(size=3))
    x = relative_states(rng, (20,))
    back = frame.from_offset(frame.to_offset(x))
    assert_allclose(back[:, :3], x[:, :3], rtol=0, atol=1e-9)
    assert_allclose(back[:, 3:], x[:, 3:], rtol=0, atol=1e-12)


@given(states(), st.integers(0, 2**32 - 1))
def test_inertial_states_survive_the_round_trip_to_the_last_digit(chief, seed):
    rng = np.random.default_rng(seed)
    frame = LVLH.from_state(chief, rng.normal(0, 1e-2, 3))
    x = relative_states(rng, (20,))
    back = frame.from_inertial(frame.to_inertial(x))
    digit = np.spacing(np.linalg.norm(chief.reshape(2, 3), axis=1) + 2 * NEAR[::3])
    digit[1] += np.linalg.norm(frame.omega) * digit[0]
    error = np.linalg.norm((back - x).reshape(-1, 2, 3), axis=2)
    assert np.all(error <= 3 * digit)  # a nanometer in low orbit


@given(states())
def test_states_survive_the_round_trip_through_polar_nodal_elements(state):
    back = inertial_state(to_polar_nodal(state))
    size = np.linalg.norm(state.reshape(2, 3), axis=1).repeat(3)
    assert_allclose(back / size, state / size, rtol=0, atol=2e-15)


@given(states())
def test_axes_are_orthonormal_and_right_handed(state):
    axes = LVLH.from_state(state).axes
    assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1)


@given(states())
def test_frames_from_state_and_from_polar_nodal_elements_agree(state):
    by_state = LVLH.from_state(state, Forces().acceleration(state))
    by_elements = LVLH.from_polar_nodal(to_polar_nodal(state), K_J2)
    assert_allclose(by_state.axes, by_elements.axes, atol=1e-14)
    assert_allclose(by_state.omega, by_elements.omega, rtol=1e-12, atol=1e-18)


def test_the_axes_are_radial_transverse_and_normal():
    chief = np.array([7e6, 0, 0, 0, 7.5e3, 0])
    higher, ahead, left = np.eye(3) * 100
    frame = LVLH.from_state(chief)
    assert_array_equal(frame.axes, np.eye(3))
    for there, here in ((higher, 0), (ahead, 1), (left, 2)):
        x = frame.from_inertial(chief + np.concatenate([there, np.zeros(3)]))
        assert_array_equal(x[:3], np.eye(3)[here] * 100)


def test_conversions_of_many_instants_and_agents_are_each_its_own(rng):
    chief = inertial_states(8e6, 0.1, *rng.uniform(0, 2, (4, 5)))
    acceleration, x = rng.normal(size=(5, 3)), relative_states(rng, (5, 4))
    together = LVLH.from_state(chief, acceleration)
    for k in range(5):
        alone = LVLH.from_state(chief[k], acceleration[k])
        assert_allclose(together.to_offset(x)[k], alone.to_offset(x[k]), atol=1e-11)
        assert_allclose(together.from_offset(x)[k, 2], alone.from_offset(x[k, 2]))
        assert_allclose(together.to_inertial(x[:, 0])[k], alone.to_inertial(x[k, 0]))


def slopes(states, forces, ballistic, dt):
    """Return the LVLH velocity of a deputy and the sixth-order difference of its position."""
    chief, deputy = np.moveaxis(states, 1, 0)
    frame = LVLH.from_state(chief, forces.acceleration(chief, ballistic))
    x = frame.from_inertial(deputy)
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * dt)
    return x[3], weights @ x[:, :3], LVLH.from_state(chief[3]).from_inertial(deputy[3])


@pytest.mark.parametrize("air", [None, 1e-6])
@pytest.mark.parametrize(("e", "i"), [(0.0, 0.8), (0.3, 1.2), (0.01, 2.4)])
def test_relative_velocity_is_the_derivative_of_relative_position(e, i, air, rng):
    forces = Forces(atmosphere=None if air is None else Atmosphere(reference_density=air))
    chief = inertial_states(6.9e6 / (1 - e), e, i, 0.3, 0.4, 0.9)
    deputy = LVLH.from_state(chief).to_inertial(relative_states(rng, (1,)))
    start, dt = np.vstack([chief, deputy]), 2.0
    drag = None if air is None else np.array([0.01, 0.02])
    path = propagate(start, dt * np.arange(7), forces, drag, accuracy=1e-13)
    each = 0.0 if air is None else 0.01
    velocity, slope, without_tilt = slopes(path, forces, each, dt)
    # The last digit of a position, a nanometer, over two seconds.
    assert_allclose(velocity[3:], slope, rtol=0, atol=3e-9)
    assert np.abs(without_tilt[3:] - slope).max() > 1e-3


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_an_equatorial_orbit_has_its_node_on_the_x_axis(turn):
    state = np.array([0, 7e6, 0, -7.5e3 * turn, 10, 0])
    _, _, _, node, i, latitude = to_polar_nodal(state)
    assert (node, i) == (0, 0 if turn > 0 else np.pi)
    assert latitude == pytest.approx(turn * np.pi / 2)


def test_a_published_example_has_its_inertial_state():
    # [Vallado2013, example 2-6]: p = 11 067.790 km, e = 0.83285.
    e, angles = 0.83285, np.radians([87.87, 227.89, 53.38, 92.335])
    state = inertial_states(11067.790e3 / (1 - e**2), e, *angles)
    assert_allclose(state[:3], [6525.344e3, 6861.535e3, 6449.125e3], atol=0.5e3)
    assert_allclose(state[3:], [4902.276, 5533.124, -1975.709], atol=0.5)


@pytest.mark.parametrize("state", [[7e6, 0, 0, 100, 0, 0], [0] * 6, [np.nan, 0, 0, 0, 1, 0]])
def test_rectilinear_motion_is_refused(state):
    with pytest.raises(ValueError, match=r"one line through|must be an array"):
        LVLH.from_state(np.array(state, dtype=float))


def test_without_the_acceleration_of_the_chief_velocities_are_off():
    chief = inertial_states(6978e3, 1e-3, np.radians(45), 0.5, 0.5, 0.9)
    deputy = inertial_states(6978e3, 1e-3, np.radians(45) + 3e-4, 0.5 + 3e-4, 0.5, 0.9 - 3e-4)
    exact = LVLH.from_state(chief, Forces().acceleration(chief)).from_inertial(deputy)
    found = LVLH.from_state(chief).from_inertial(deputy)
    assert_allclose(found[:3], exact[:3], rtol=0, atol=1e-6)
    assert 1e-3 < np.abs(found - exact)[3:].max() < 1e-2  # [m/s], some kilometers away
