"""Simulations of connectivity maintenance: connectivity, distances and losses."""

from dataclasses import replace

import numpy as np
import pytest
from connectivity_cast import connected_poses, fly

from dynamics.kinematic import KinematicVehicle
from sato.check.common import find_closest_approach
from sato.connectivity.mission import AgentLoss, Connectivity
from sato.connectivity.settings import Potential
from sato.connectivity.stick import WaypointStick
from sato.network.link import Link


def flight(seed, **settings):
    rng = np.random.default_rng(seed)
    position, yaw = connected_poses(rng)
    forward = np.array([np.cos(yaw[0]), np.sin(yaw[0]), 0])
    return Connectivity(
        start=position, yaw=yaw, yaw_error=rng.uniform(-0.5, 0.5, (6, 6)),
        stick=WaypointStick(position[0] + np.outer([5, 10], forward), start_time=0.0),
        **({"duration": 15.0} | settings),
    )  # fmt: skip


@pytest.mark.parametrize("estimator", ["flood", "exact"])
@pytest.mark.parametrize("seed", range(3))
def test_swarm_stays_connected_and_separated_and_follows_the_leader(seed, estimator):
    frames = fly(flight(seed, estimator=estimator))
    assert min(f.lambda2 for f in frames) > 0.01
    position, alive = (
        np.array([getattr(f, name) for f in frames]) for name in ("position", "alive")
    )
    assert find_closest_approach(position, alive).distance >= 1.0
    assert all((f.component == 0).all() for f in frames)
    waypoints = [e for f in frames for e in f.events if e["kind"] == "waypoint"]
    assert waypoints  # the leader gets somewhere


def test_flooded_estimate_of_lambda2_is_within_two_thousandths():
    frames = fly(flight(1))
    off = [np.abs(f.lambda2_estimate - f.lambda2).mean() for f in frames[10:]]
    assert np.mean(off) <= 0.002


def test_without_the_connectivity_action_the_leader_is_lost():
    idle = flight(2, potential=Potential(strength=0.0))
    far = idle.stick.waypoints + np.array([[40, 0, 0], [80, 0, 0]])
    frames = fly(replace(idle, stick=replace(idle.stick, waypoints=far)))
    assert min(f.lambda2 for f in frames) == 0
    assert [e["kind"] for f in frames for e in f.events if e["kind"] == "split"] == ["split"]


@pytest.mark.parametrize("robot", [0, 3])
def test_lost_robot_is_neither_seen_nor_commanded(robot):
    frames = fly(flight(0, losses=(AgentLoss(robot, 2.0),)))
    dead = [f for f in frames if f.time >= 2.0]
    for f in dead:
        edges = f.visibility[:, robot], f.edge_weight[robot]
        motion = (
            f.velocity_command[robot],
            f.velocity[robot],
            f.position[robot] - dead[0].position[robot],
        )
        assert not f.alive[robot] and not any(values.any() for values in edges + motion)
        assert np.isnan(f.lambda2_estimate[robot])
        assert f.alive[0] or not f.stick.any()
    assert [e["agents"] for f in frames for e in f.events if e["kind"] == "loss"] == [[robot]]


def test_swarm_stays_connected_with_lag_noise_and_message_loss():
    rough = flight(
        1,
        plant=KinematicVehicle(time_constant=0.3),
        camera_noise=0.05,
        link=Link(loss_probability=0.1),
    )
    frames = fly(rough)
    assert min(f.lambda2 for f in frames) > 0.01
