"""Occlusion, tilted cameras, triangle closure, and late messages."""

from dataclasses import replace

import numpy as np
import pytest
from connectivity_cast import IDLE, fly, posed

from dynamics.quadrotor import Quadrotor
from problems.interaction_graph import Camera, interaction_graph
from sato.connectivity.obstacles import Box, Sphere
from sato.connectivity.settings import Potential, Repulsion, YawTracking
from sato.connectivity.stick import WaypointStick
from sato.network.link import Link

AHEAD = Camera(optical_axis=(1.0, 0.0, 0.0))
STILL = {"potential": Potential(strength=0.0), "repulsion": Repulsion(strength=0.0)}
# Robot 0 sees 1, which does not see it; each sees 2, and 2 both of them.
THREE = np.array([[0.0, 0, 3], [5, 0, 3], [5, 5, 3]])
LOOKS = np.radians([0.0, 90, 247])


def three(**settings):
    """Build a mission with exact relative yaws, but for robot 0 of 1."""
    believed = LOOKS - LOOKS[:, None]
    believed[0, 1] += 0.5
    given = {"duration": 2.0, "camera": AHEAD} | STILL | settings
    return posed(THREE, LOOKS, believed, **given)


def one_sided_error(mission):
    last = fly(mission)[-1]
    assert (
        last.visibility[0, 1]
        and not last.visibility[1, 0]
        and (last.visibility & last.visibility.T).sum() == 4
    )
    return abs(np.sin(last.yaw_estimate_error[0, 1] / 2))


def test_triangle_closure_corrects_a_one_sided_relative_yaw():
    # Nobody moves, so that nothing else could.
    assert one_sided_error(three()) < 1e-3
    off = [
        one_sided_error(three(tracking=t))
        for t in (YawTracking(closure_gain=0.0), YawTracking(as_printed=True))
    ]
    assert off == pytest.approx([np.sin(0.25)] * 2)


@pytest.mark.parametrize(
    ("what", "hides"),
    [
        (Sphere((2.5, 0, 3), 0.4), True),
        (Sphere((2.5, 1, 3), 0.4), False),
        (Box((2.0, -1, 2), (3, 1, 4)), True),
        (Box((2.0, 1, 2), (3, 2, 4)), False),
    ],
)
def test_robot_behind_an_obstacle_is_not_seen(what, hides):
    mission = three(obstacles=(what,), duration=0.1)
    open_sight, hidden = fly(mission)[-1], fly(replace(mission, occlusion=True))[-1]
    assert open_sight.visibility[0, 1] and open_sight.edge_weight[0, 1] == pytest.approx(1)
    assert hidden.visibility[0, 1] != hides
    assert hidden.edge_weight[0, 1] == pytest.approx(0 if hides else 1)
    assert hidden.visibility[0, 2] and hidden.visibility[1, 2]


def test_robot_behind_another_is_not_seen():
    start = np.array([[0.0, 0, 3], [3, 0, 3], [6, 0, 3]])
    mission = posed(start, np.zeros(3), camera=AHEAD, duration=0.1, **STILL)
    for occlusion in (False, True):
        seen = fly(replace(mission, occlusion=occlusion))[-1].visibility[0]
        assert seen.tolist() == [False, True, not occlusion]


def test_cameras_tilt_with_accelerating_quadrotors():
    start = np.array([[0.0, 0, 3], [4.5, 0, 6.0]])
    yaw = np.array([0.0, 0.0])
    away = WaypointStick(np.array([[-40.0, 0, 3]]), start_time=0.0)
    mission = posed(start, yaw, stick=away, camera=AHEAD, duration=0.5, plant=Quadrotor(), **STILL)
    frames = fly(mission)
    level = [interaction_graph(f.position, f.yaw, AHEAD).weights[0, 1] for f in frames]
    true = [f.edge_weight[0, 1] for f in frames]
    assert true[0] == pytest.approx(level[0])
    # Backwards: the nose goes up, towards the other one, who is above.
    assert true[10] > level[10] + 0.02
    assert fly(replace(mission, stick=IDLE))[-1].edge_weight[0, 1] == pytest.approx(true[0])


def six(**settings):
    """Build a ring of six that look inwards, whose leader flies away."""
    turn = np.radians(60 * np.arange(6))
    start = np.column_stack([4 * np.cos(turn), 4 * np.sin(turn), 3 + 0.3 * np.arange(6)])
    yaw = turn + np.pi + 0.2 * np.cos(np.arange(6))
    believed = yaw - yaw[:, None] + 0.3 * np.sin(np.arange(36)).reshape(6, 6)
    stick = WaypointStick(np.array([[12.0, 3, 3]]), start_time=0.0)
    return posed(start, yaw, believed, stick, **({"duration": 6.0, "camera": AHEAD} | settings))


@pytest.mark.parametrize(
    "link",
    [
        Link(period_steps=10),
        Link(period_steps=5, late=1),
        Link(late=9),
    ],
)
def test_rare_or_late_messages_keep_estimates_within_bounds(link):
    prompt, frames = fly(six()), fly(six(link=link))
    assert min(f.lambda2 for f in frames) > 0.01

    def errors(frames):
        later = frames[100:]
        yaw = []
        for f in later:
            off = np.abs(np.sin(f.yaw_estimate_error / 2))
            yaw.append(off[f.visibility & f.visibility.T])
        lambda2 = np.mean([np.abs(f.lambda2_estimate - f.lambda2).mean() for f in later])
        return lambda2, np.concatenate(yaw).mean()

    (known, sure), (guessed, unsure) = errors(prompt), errors(frames)
    assert known < 0.02 and sure < 0.01
    assert guessed < 0.2 and unsure < 0.03
