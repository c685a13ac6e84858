"""Independence of coordinate frames: controllers use only their own body frame."""

from dataclasses import replace

import numpy as np
import pytest
from connectivity_cast import connected_poses, fly, spheres
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st

from dynamics.vehicle import rotate_by_yaw
from problems.interaction_graph import Camera
from sato.connectivity.controller import (
    act_on_rows,
    compute_commands,
    estimate_edges,
)
from sato.connectivity.loop import Swarm
from sato.connectivity.mission import Connectivity
from sato.connectivity.stick import WaypointStick
from sato.network.link import Link

TURNS = st.floats(-np.pi, np.pi)
FEW = settings(max_examples=6, phases=[Phase.generate])  # flights are long to be made simpler
ROUND = Camera(
    a_min=-0.6, a_max=0.2, optical_axis=(0.0, 0.0, 1.0)
)  # sees the same whichever way it turns


def about(turn):
    """R_z."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def mission(seed, camera, **settings):
    """Build a mission of six robots among spheres."""
    rng = np.random.default_rng(seed)
    clear = False
    while not clear:
        position, yaw = connected_poses(rng, camera)
        ways = position[0] + np.array([[6.0, 0, 0], [6, 6, 0]])
        centers = ways + np.array([0, 2.5, 1])
        clear = np.linalg.norm(position[:, None] - centers, axis=2).min() > 1.5
    return Connectivity(
        start=position, yaw=yaw, yaw_error=rng.uniform(-0.5, 0.5, (6, 6)),
        stick=WaypointStick(ways, start_time=0.0), camera=camera,
        obstacles=spheres(np.column_stack([centers, [0.5, 0.5]])),
        **({"duration": 3.0} | settings),
    )  # fmt: skip


def smooth(frames):
    """Tell whether λ₂ stays simple and large; elsewhere rounding is amplified."""
    return all(f.lambda3 - f.lambda2 > 0.02 and f.lambda2 > 0.3 for f in frames)


@FEW
@given(st.integers(0, 100), TURNS, st.sampled_from(["flood", "exact"]))
def test_rotating_the_world_rotates_trajectories_and_no_command(seed, turn, estimator):
    here, shift = mission(seed, Camera(), estimator=estimator), np.array([3.0, -1, 2])
    rows = here.obstacle_arrays.spheres.copy()
    rows[:, :3] = rows[:, :3] @ about(turn).T + shift
    there = replace(
        here,
        start=here.initial_position @ about(turn).T + shift,
        yaw=here.yaw + turn,
        stick=WaypointStick(here.stick.waypoints @ about(turn).T + shift, start_time=0.0),
        obstacles=spheres(rows),
    )
    frames = fly(here)
    assume(smooth(frames))
    for one, other in zip(frames, fly(there), strict=True):
        assert other.position == pytest.approx(one.position @ about(turn).T + shift, abs=1e-9)
        assert other.velocity_command == pytest.approx(one.velocity_command, abs=1e-9)
        assert other.yaw_rate == pytest.approx(one.yaw_rate, abs=1e-9)
        assert np.array_equal(other.visibility, one.visibility)


def check_same_motion(plain, other, least_turn=0.0):
    """Check that the axes of body frames make no difference."""
    frames = fly(plain)
    assume(smooth(frames) and max(np.abs(f.yaw_rate).max() for f in frames) >= least_turn)
    for one, another in zip(frames, fly(other), strict=True):
        assert another.position == pytest.approx(one.position, abs=1e-9)
        assert another.yaw_rate == pytest.approx(one.yaw_rate, abs=1e-9)
        seen = [rotate_by_yaw(f.velocity_command, f.yaw) for f in (one, another)]
        assert seen[1] == pytest.approx(seen[0], abs=1e-9)
        known = one.lambda2_estimate, another.lambda2_estimate
        assert known[1] == pytest.approx(known[0], abs=1e-9, nan_ok=True)


@FEW
@given(st.integers(0, 100), st.integers(0, 5), TURNS, st.sampled_from(["flood", "exact"]))
def test_rotating_the_axes_of_one_robot_changes_no_trajectory(seed, robot, turn, estimator):
    # Its camera looks along the axis of the turn, so that the axes alone are turned: what it
    # senses, says and is said to be. Everybody else goes on as before.
    plain = mission(seed, ROUND, estimator=estimator)
    check_same_motion(plain, replace(plain, yaw=plain.yaw + turn * (np.arange(6) == robot)))


@FEW
@given(st.integers(0, 100), TURNS)
def test_rotating_all_body_axes_under_the_cameras_changes_no_trajectory(seed, turn):
    plain = mission(seed, Camera())
    x, y, z = about(-turn) @ plain.camera.optical_axis
    other = replace(plain, yaw=plain.yaw + turn, camera=Camera(optical_axis=(x, y, z)))
    check_same_motion(plain, other, least_turn=0.05)


def spoiled(part, robot):
    """Copy a part of the state, with the rows of all other robots overwritten."""
    if not isinstance(part, np.ndarray):
        return type(part)(*(spoiled(field, robot) for field in part))
    others, copy = np.arange(len(part)) != robot, part.copy()
    copy[others] = ~copy[others] if copy.dtype == bool else 77
    return copy


def decided(robot, known, mission):
    """Return all that a robot estimates and commands."""
    found = estimate_edges(known, mission, 0.6)
    lambda2, action = act_on_rows(found.adjacency, -0.4, mission.potential)
    found = found._replace(lambda2=lambda2, action=action)
    command = compute_commands(known._replace(estimates=found), mission)
    fields = [*found, *found.adjacency, command]
    return [field[robot] for field in fields if isinstance(field, np.ndarray)]


@pytest.mark.parametrize("robot", range(6))
@pytest.mark.parametrize("link", [Link(), Link(late=2, loss_probability=0.2)])
def test_controller_reads_only_rows_of_its_own_agent(robot, link):
    whole, rng = mission(3, Camera(), camera_noise=0.02, link=link), np.random.default_rng(0)
    swarm = Swarm(whole, rng)
    for _ in range(30):
        swarm.move(np.array([1.0, 0, 0]))
        swarm.decide()
    own = decided(robot, swarm.known, whole)
    for one, other in zip(own, decided(robot, spoiled(swarm.known, robot), whole), strict=True):
        assert np.array_equal(one, other, equal_nan=True)
    command, lambda2 = own[-1], own[5]
    assert command.any() and lambda2 > 0
