"""Behavior after a split or a loss."""

import numpy as np
import pytest
from connectivity_cast import fly, posed, spheres

import sato
from dynamics.vehicle import rotate_by_yaw
from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.connectivity.controller import repulsion_gain
from sato.connectivity.mission import AgentLoss
from sato.connectivity.settings import (
    MAX_MESSAGE_AGE,
    MAX_ROW_AGE,
    Potential,
    Repulsion,
)
from sato.connectivity.stick import WaypointStick
from sato.network.link import Link

DEATH = 0.2  # [s]
AHEAD = -np.pi / 4  # yaw with which the camera looks along x
SPHERE = np.array([22.5, 2.0, 5.0, 0.5])  # near the last of four


def cut(dies, agents=4, **settings):
    """Fly a row of robots that loses one, which splits the row."""
    start = np.array([[7.5, 0, 0]]) * np.arange(agents)[:, None] + [0, 0, 5]
    yaw = np.full(agents, AHEAD)
    return fly(
        posed(
            start,
            yaw,
            duration=4.0,
            losses=(AgentLoss(dies, DEATH),),
            obstacles=spheres([SPHERE]),
            **settings,
        )
    )


def away(position):
    """Compute the repulsion of the sphere."""
    o = SPHERE[:3] - position
    o *= 1 - SPHERE[3] / np.linalg.norm(o)
    return -repulsion_gain(np.linalg.norm(o), Repulsion()) * o


@pytest.mark.parametrize("estimator", ["flood", "exact", "power_pi"])
def test_isolated_robot_stops_and_keeps_its_distance(estimator):
    # The third dies: the first two are left together, and the fourth, at the sphere, is alone.
    frames = cut(dies=2, estimator=estimator)
    before = [f for f in frames if 0.1 < f.time < DEATH - 1e-9]
    assert all(np.linalg.norm(f.velocity_command[0]) > 0.01 for f in before)
    alone = [f for f in frames if f.time > DEATH + MAX_MESSAGE_AGE + 0.01]
    for f in alone:
        asked = rotate_by_yaw(f.velocity_command, f.yaw)[3]
        assert asked == pytest.approx(away(f.position[3]), abs=1e-12)
        assert f.yaw_rate[3] == 0
    assert np.linalg.norm(away(alone[0].position[3])) > 0.05
    later = [f.lambda2_estimate[3] for f in frames if f.time > DEATH + MAX_ROW_AGE]
    if estimator == "flood":
        assert np.isnan(later).all()


def test_remaining_pair_uses_the_remaining_graph():
    late = [f for f in cut(dies=2) if f.time > DEATH + MAX_ROW_AGE + 0.02]
    assert late
    for f in late:
        weights = interaction_graph(f.position[:2], f.yaw[:2], Camera()).weights
        pair = algebraic_connectivity(weights).lambda2
        assert pair > 0.5
        # The other's row is one message old.
        assert f.lambda2_estimate[:2] == pytest.approx(np.full(2, pair), abs=0.01)


def test_estimate_out_of_range_is_rejected():
    # Who is alone would come to report e₃/e₂ = 8.3, for which nobody would do anything.
    frames = cut(dies=2, estimator="power_pi")
    told = np.array([f.lambda2_estimate for f in frames])
    settled = np.array([f.time > DEATH + 0.3 for f in frames])
    assert np.nanmax(told) <= 1.1 * Potential().lambda2_max
    assert np.ptp(told[settled, 3]) == 0 and told[settled, 3][0] < 1.1 * Potential().lambda2_max
    # Who still has somebody finds what holds the two together, and goes on by it.
    assert np.ptp(told[settled, 0]) > 0.1
    assert told[-1, :2] == pytest.approx(np.full(2, frames[-1].edge_weight[0, 1] * 2), rel=0.01)


@pytest.mark.parametrize("estimator", ["flood", "exact", "power_pi"])
@pytest.mark.parametrize("late", [0, 3])
def test_lost_robot_is_forgotten_after_a_second(estimator, late):
    frames = cut(dies=1, estimator=estimator, link=Link(late=late))
    alive = np.arange(4) != 1
    assert frames[0].known_agents[alive, 1].any()
    for f in frames:
        if f.time > DEATH + MAX_ROW_AGE + 0.02:
            assert not f.known_agents[alive, 1].any() and not f.edge_weight[1].any()
    still = frames[-1].position[1]
    dead = [f.position[1] for f in frames if f.time >= DEATH - 1e-9]
    assert np.array_equal(dead, np.tile(still, (len(dead), 1)))


def test_the_last_step_of_a_lost_robot_counts():
    mission = sato.Connectivity(
        start=[[0, 0, 3.0], [4, 0, 3.2], [2, 3, 3.0], [-3, 1, 3.5]],
        yaw=[0.0, -2.8, -0.7, -0.7],
        duration=2.0,
        step=0.1,
        repulsion=Repulsion(strength=1e-6),
        potential=Potential(strength=0.0),
        stick=WaypointStick(waypoints=[[8, 0, 3.3]], start_time=0.1),
        losses=(AgentLoss(0, 1.4),),
    )
    report = sato.run(mission).report
    assert report.line.startswith("BROKEN: separation, 0.756") and "0 and 1 at 1.4 s" in report.line
