"""Plants: what every one of them promises, and the one that does as its model says."""

from dataclasses import dataclass

import numpy as np
import pytest

from dynamics import ClohessyWiltshire, DoubleIntegrator, LinearModel, discretize_zoh
from dynamics.atmosphere import Atmosphere
from dynamics.inertial import InertialPlant
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant

ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4)


@dataclass(frozen=True)
class Swinging(LinearModel):
    """An oscillator whose stiffness changes in time."""

    axes: int = 3

    def A(self, t):
        """Stiffness that comes and goes."""
        A = np.zeros((6, 6))
        A[:3, 3:] = np.eye(3)
        A[3:, :3] = -1e-4 * (1 + np.sin(t / 20)) * np.eye(3)
        return A


def plants():
    air = Atmosphere(), np.linspace(0.01, 0.02, 5)
    return {
        "a constant model": LinearPlant(ClohessyWiltshire(1.1e-3), ORBIT),
        "a changing model": LinearPlant(Swinging()),
        "two bodies and J2": InertialPlant(ORBIT),
        "an eccentric orbit": InertialPlant(Orbit.from_elements(9e6, 0.2, 1.2, 0.1, 0.2, 0.3)),
        "drag": InertialPlant(ORBIT, air[1], 0.015, air[0]),
    }


@pytest.fixture(params=list(plants()))
def plant(request):
    return plants()[request.param]


@pytest.fixture
def swarm(rng):
    x = rng.normal(size=(5, 6)) * np.repeat([1e3, 1.0], 3)
    return x, rng.normal(0, 1e-3, (5, 3))


def test_a_flight_begins_where_it_begins(plant, swarm):
    path = plant.propagate(*swarm, 90.0, 60.0, 3)
    assert path.shape == (4, 5, 6)
    np.testing.assert_array_equal(path[0], swarm[0])


def test_the_same_flight_is_the_same_whatever_was_flown_before(plant, swarm):
    first = plant.propagate(*swarm, 200.0, 60.0, 2)
    for t in (0.0, 977.0, 31.4):
        plant.fly(2 * swarm[0], -swarm[1], t, 45.0)
        plant.chief(t + 1)
    np.testing.assert_array_equal(plant.fly(*swarm, 200.0, 60.0, 2), first)


def test_a_fresh_plant_flies_the_same(plant, swarm, request):
    fresh = plants()[request.node.callspec.params["plant"]]
    plant.fly(*swarm, 3000.0, 60.0)
    np.testing.assert_array_equal(fresh.fly(*swarm, 130.0, 60.0), plant.fly(*swarm, 130.0, 60.0))


def test_a_flight_in_pieces_passes_through_the_ends_of_shorter_ones(plant, swarm):
    x, u = swarm
    path = plant.fly(x, u, 30.0, 120.0, 12)
    for k in range(12):
        x = plant.fly(x, u, 30.0 + 10.0 * k, 10.0)[1]
        np.testing.assert_allclose(path[k + 1], x, rtol=0, atol=1e-8)


def test_who_is_not_there_stays_away_and_is_not_felt(plant, swarm):
    x, u = swarm[0].copy(), swarm[1].copy()
    everyone = plant.propagate(x, u, 0.0, 60.0, 2)
    x[2], u[2] = np.nan, np.nan
    path = plant.fly(x, u, 0.0, 60.0, 2)
    assert np.isnan(path[:, 2]).all()
    others = [0, 1, 3, 4]
    np.testing.assert_allclose(path[:, others], everyone[:, others], rtol=0, atol=1e-9)


def test_nobody_at_all_can_be_flown(plant):
    away = np.full((5, 6), np.nan)
    assert np.isnan(plant.fly(away, np.zeros((5, 3)), 0.0, 60.0, 2)).all()


def test_a_model_is_flown_as_it_is_rolled(swarm):
    for model in (ClohessyWiltshire(1.1e-3), Swinging()):
        steps = discretize_zoh(model, 20.0, 3, t0=40.0)
        path = LinearPlant(model).propagate(*swarm, 40.0, 60.0, 3)
        held = np.repeat(swarm[1][:, None], 3, axis=1)
        np.testing.assert_array_equal(path.swapaxes(0, 1), steps.simulate(swarm[0], held))


def test_a_plane_can_be_flown():
    path = LinearPlant(DoubleIntegrator(2)).propagate(
        np.zeros((1, 4)), np.array([[2.0, 0]]), 0.0, 3.0
    )
    np.testing.assert_allclose(path[1], [[9, 0, 6, 0]])


def test_the_chief_is_that_of_the_orbit_where_there_is_one():
    assert LinearPlant(DoubleIntegrator(2)).chief_elements(10.0) is None
    np.testing.assert_array_equal(
        LinearPlant(ClohessyWiltshire(1.1e-3), ORBIT).chief_elements(70.0), ORBIT.elements_at(70.0)
    )


@pytest.mark.parametrize(
    ("shape", "dt", "pieces", "message"),
    [
        (((5, 4), (5, 2)), 60.0, 1, r"in 3 axes have states of shape \(agents, 6\).*\(5, 4\)"),
        (((5, 6), (5, 2)), 60.0, 1, r"got \(5, 6\) and \(5, 2\)"),
        (((5, 6), (5, 3)), 0.0, 1, "takes some time and has at least one piece, got dt = 0.0 s"),
        (((5, 6), (5, 3)), 60.0, 0, "at least one piece, got dt = 60.0 s, pieces = 0"),
    ],
)
def test_a_flight_that_means_nothing_is_refused(plant, shape, dt, pieces, message):
    x, u = (np.zeros(part) for part in shape)
    with pytest.raises(ValueError, match=message):
        plant.propagate(x, u, 0.0, dt, pieces)


def test_thrust_that_is_not_a_number_is_refused(plant, swarm):
    swarm[1][3, 0] = np.nan
    with pytest.raises(ValueError, match=r"vehicle 3 is there, but its acceleration is \[ *nan"):
        plant.propagate(*swarm, 0.0, 60.0)
