"""Propagation of many agents: invariants, accuracy, and known rates."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose
from orbit_examples import inertial_states, semi_major_axis

from dynamics.atmosphere import Atmosphere
from dynamics.coordinate_frames import inertial_state, to_polar_nodal
from dynamics.forces import Forces
from dynamics.orbit import EARTH_J2, EARTH_MU, EARTH_RADIUS, K_J2, Orbit
from dynamics.propagation import Impact, propagate

ROUND = Forces(k_J2=0.0)


def swarm(rng, count, e):
    e = rng.uniform(0, e, count)
    perigee = EARTH_RADIUS + rng.uniform(4e5, 1e6, count)
    return inertial_states(perigee / (1 - e), e, *rng.uniform(0, np.pi, (4, count)))


def period(a):
    return 2 * np.pi * np.sqrt(a**3 / EARTH_MU)


def relative_error(a, b):
    """Return the distance of positions as a fraction of the radius."""
    return np.linalg.norm((a - b)[..., :3], axis=-1) / np.linalg.norm(b[..., :3], axis=-1)


def test_energy_and_polar_angular_momentum_are_conserved(rng):
    start = swarm(rng, 30, 0.5)
    path = propagate(start, np.array([0.0, 3e3, 2e4]), accuracy=1e-12)

    def invariants(state):
        position, velocity = state[..., :3], state[..., 3:]
        r = np.linalg.norm(position, axis=-1)
        oblateness = K_J2 / r**3 * (1 / 3 - (position[..., 2] / r) ** 2)
        energy = (velocity**2).sum(axis=-1) / 2 - EARTH_MU / r - oblateness
        momentum = position[..., 0] * velocity[..., 1] - position[..., 1] * velocity[..., 0]
        return energy, momentum

    np.testing.assert_array_equal(path[0], start)
    for before, after in zip(
        invariants(start), np.moveaxis(invariants(path[1:]), 1, 0).swapaxes(0, 1), strict=True
    ):
        assert_allclose(after, np.broadcast_to(before, after.shape), rtol=1e-11)


def test_orbits_without_oblateness_close(rng):
    start = inertial_states(9e6, 0.25, *rng.uniform(0, 3, (4, 12)))
    end = propagate(start, np.array([period(9e6)]), ROUND)[0]
    assert relative_error(end, start).max() < 1e-9


@pytest.mark.parametrize("accuracy", [1e-6, 1e-9])
def test_each_agent_is_as_accurate_as_asked_in_any_swarm(accuracy, rng):
    # An average over the swarm would hide the errors of two eccentric orbits among circles.
    e = np.append(np.zeros(60), [0.3, 0.6])
    a = (EARTH_RADIUS + 5e5) / (1 - e)
    start = inertial_states(a, e, *rng.uniform(0, np.pi, (3, 62)), np.full(62, 2.0))
    times = np.linspace(0, period(a.max()), 50)
    times = times[times <= period(a.min())] if accuracy < 1e-6 else times
    together = propagate(start, times, accuracy=accuracy)
    truth = propagate(start, times, accuracy=1e-13)
    revolutions = np.maximum(1, times[:, None] / period(a))
    assert (relative_error(together, truth) / revolutions**2).max() < accuracy
    alone = propagate(start[-1:], times, accuracy=1e-13)
    assert relative_error(together[:, -1:], alone).max() < accuracy


def test_propagation_agrees_with_the_polar_nodal_equations(rng):
    times = np.array([1e3, 6e3])
    for state in [*swarm(rng, 3, 0.3), *swarm(rng, 2, 0.01)]:
        path = propagate(state[None], times, accuracy=1e-13)[:, 0]
        # `Orbit` interpolates between the steps of its integration.
        second = inertial_state(Orbit(*to_polar_nodal(state)).elements_at(times))
        assert_allclose(path[:, :3], second[:, :3], rtol=0, atol=3e-5)


def test_nodes_drift_at_the_known_rate():
    # To first order in J2 [Vallado2013, Chapter 9]; 98.6° and 800 km are Sun-synchronous.
    a, i = EARTH_RADIUS + 800e3, np.radians(98.6)
    t = 10 * period(a)
    end = propagate(inertial_states(a, 0.001, i)[None], np.array([t]))[0, 0]
    known = -1.5 * EARTH_J2 * (EARTH_RADIUS / a) ** 2 * np.cos(i) * 2 * np.pi / period(a)
    assert to_polar_nodal(end)[3] / t == pytest.approx(known, rel=5e-3)
    assert np.degrees(known) * 86400 == pytest.approx(0.9856, rel=5e-3)


def test_drag_lowers_a_circular_orbit_at_the_known_rate():
    # Δa = −2π B ρ a² a revolution in air that does not rotate [Wertz1999, Sec. 6.2].
    a, B = EARTH_RADIUS + 500e3, np.array([0.01, 0.02])
    still = Forces(k_J2=0.0, atmosphere=Atmosphere(rotation_rate=0.0))
    start = np.tile(inertial_states(a, 0.0, 0.9, 0.1, 0.0, 0.4), (2, 1))
    end = propagate(start, np.array([period(a)]), still, B, 1e-12)[0]
    assert_allclose(semi_major_axis(end) - a, -2 * np.pi * B * 6.967e-13 * a**2, rtol=1e-3)


def test_an_impact_names_agent_and_time():
    doomed = inertial_states(7e6, np.array([0.0, 0.2]), 0.5, 0.0, 0.0, np.pi)
    with pytest.raises(Impact, match="agent 1 hits the Earth at t = ") as caught:
        propagate(doomed, np.array([period(7e6)]))
    there = propagate(doomed, np.array([caught.value.time - 1e-3]))[0, 1]
    assert caught.value.agent == 1
    assert np.linalg.norm(there[:3]) == pytest.approx(EARTH_RADIUS, abs=10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"times": np.array([2.0, 1.0])}, "times: must increase from 0 or later"),
        ({"times": np.array([-1.0, 1.0])}, "times: must increase from 0 or later"),
        ({"times": np.array([])}, "times: must increase from 0 or later"),
        ({"accuracy": 1e-15}, "^accuracy: .* at least 1e-13 and at most 0.001, got 1e-15"),
        ({"state": np.full((1, 6), np.nan)}, "state: must be an array of finite numbers"),
        ({"state": np.array([[7e3, 0, 0, 0, 7.5, 0]])}, "starts inside the Earth, 7 km.*in meters"),
        ({"forces": Forces(atmosphere=Atmosphere())}, "drag needs the ballistic coefficient"),
        (
            {"forces": Forces(atmosphere=Atmosphere()), "ballistic_coefficient": np.ones(3)},
            "there are 1 agents and 3 coefficients",
        ),
    ],
)
def test_invalid_arguments_are_refused(change, message):
    good = {"state": np.array([[7e6, 0, 0, 0, 7.5e3, 0]]), "times": np.array([1.0])}
    with pytest.raises(ValueError, match=message):
        propagate(**(good | change))


def test_an_empty_swarm_can_be_propagated():
    assert propagate(np.zeros((0, 6)), np.array([0.0, 60.0])).shape == (2, 0, 6)


def test_an_impact_survives_a_copy_to_another_process():
    impact = Impact(3, 12.0)
    again = pickle.loads(pickle.dumps(impact))
    assert str(again) == str(impact) and (again.agent, again.time) == (3, 12.0)
