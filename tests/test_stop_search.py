"""Search for stops: limits, rest in time, and bodies from all sides."""

from itertools import islice

import numpy as np
import pytest
from reconfiguration_runs import make_mission

import sato
from problems.obstacle_paths import ObstaclePaths, is_path_clear
from sato.reconfiguration.stop_search import search_stops
from sato.reconfiguration.stopping import stopping_horizon

R, STEPS, REST = 0.5, 24, 6


def make_bodies(rng, mission, count, horizon):
    """Bodies that come over the origin from all sides, one after another."""
    d, pieces = mission.axes, STEPS * horizon.pieces_per_step
    time = (np.arange(pieces)[:, None] + np.arange(4) / 3) * horizon.fine_model.dt
    way = rng.normal(size=(count, d))
    velocity = 0.15 * way / np.linalg.norm(way, axis=1, keepdims=True)
    arrival = np.linspace(6.0, 12.0, count)
    paths = (time - arrival[:, None, None])[..., None] * velocity[:, None, None]
    return ObstaclePaths(paths, np.zeros((count, 1, d)), np.full(count, R), velocity)


@pytest.mark.parametrize("axes", [2, 3])
@pytest.mark.parametrize("norm", [1, 2, "inf"])
@pytest.mark.parametrize("seed", range(3))
def test_stops_keep_limits_rest_in_time_and_pass_among_bodies(axes, norm, seed):
    rng = np.random.default_rng(seed)
    model = sato.DoubleIntegrator(axes)
    limits = {"model": model, "max_control": 0.1, "control_norm": norm, "max_speed": 0.4}
    start = np.array([[0.0] * axes, [3.0] * axes])
    leg = sato.Leg(start, 5)
    mission = make_mission(start, leg, comm_radius=20.0, collision_radius=R, **limits)
    horizon = stopping_horizon(mission, STEPS)
    bodies = make_bodies(rng, mission, 4, horizon)
    x0 = np.append(np.zeros(axes), rng.uniform(-0.1, 0.1, axes))
    found = list(islice(search_stops(mission, horizon, 0, x0, REST, bodies), 20))
    assert found
    is_clear = []
    for u in found:
        x = horizon.discrete_model.simulate(x0, u)
        assert not mission.planned_control_limit(0).is_exceeded(u).any()
        assert not mission.speed_limit(0).is_exceeded(x[1:, axes:]).any()
        np.testing.assert_allclose(x[STEPS - 1 - REST :, axes:], 0.0, atol=1e-12)
        away = np.linalg.norm(horizon.control_points(x, u)[:, 0] - bodies.paths[:, :, 0], axis=2)
        assert away.min() >= R * (1 - 1e-9)
        is_clear.append(is_path_clear(horizon.control_points(x, u), bodies))
    assert any(is_clear)


@pytest.mark.parametrize("step", [0.05, 0.25, 1.0])
def test_ways_are_found_at_short_steps_and_low_thrust(step):
    start = np.array([[0.0, 0.0], [3.0, 3.0]])
    limits = {"max_control": 0.02, "max_speed": 0.4, "step": step}
    mission = make_mission(
        start, sato.Leg(start, 5), comm_radius=20.0, collision_radius=R, **limits
    )
    steps = round(30 / step)
    horizon = stopping_horizon(mission, steps)
    time = (np.arange(len(horizon.fine_model))[:, None] + np.arange(4) / 3) * horizon.fine_model.dt
    velocity = np.array([[0.1, 0.01]])
    paths = (time - 15.0)[None, ..., None] * velocity[:, None, None]
    body = ObstaclePaths(paths, np.zeros((1, 1, 2)), np.array([R]), velocity)
    found = search_stops(mission, horizon, 0, np.zeros(4), 2, body)
    u = next(u for u in islice(found, 20))
    path = horizon.control_points(horizon.discrete_model.simulate(np.zeros(4), u), u)
    assert np.linalg.norm(path[:, 0] - paths[0, :, 0], axis=1).min() >= R * (1 - 1e-9)
