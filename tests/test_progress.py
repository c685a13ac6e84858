"""Vehicles with given targets in each other's way arrive: halfway, in turn, or making room."""

import numpy as np
import pytest
from planner_examples import continuous_separation, random_swarm
from reconfiguration_runs import make_mission

import sato
from sato import Leg, Points
from sato.network.graph import CommunicationGraph
from sato.scp.halfway import meet_halfway, push_apart

R = 0.5
FAR = {"comm_radius": 50.0, "max_speed": 0.5, "assignment": "given"}


def exchange(start, steps, **changes):
    """A mission of vehicles that fly to the opposite places."""
    return make_mission(start, Leg(Points(-start, keep_order=True), steps), **FAR, **changes)


def circle(count, radius):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def least_ratio(run):
    return run.check().separation_ratio


def arrives(run, mission):
    ends = run.data.position.values[-1], mission.legs[0].targets[:, : mission.axes]
    np.testing.assert_allclose(*ends, atol=1e-4)
    assert run.summary["reached"] and run.check().kept
    return run.summary


def test_vehicles_on_a_circle_exchange_sides_in_time_at_a_quarter_more():
    mission = exchange(circle(8, 4.0), 48)
    summary = arrives(sato.run(mission), mission)
    assert summary["legs"][0]["resets"] == 0
    assert summary["fuel_m_s"] <= 1.3 * summary["fuel_lower_bound_m_s"]


def test_pair_that_meets_in_a_lane_of_parked_vehicles_passes():
    x = np.arange(-3.0, 3.5, 0.75)
    walls = [np.column_stack([x, np.full_like(x, y)]) for y in (-0.7, 0.7)]
    pair = np.array([[-4.5, 0.0], [4.5, 0.0]])
    start = np.vstack([pair, *walls])
    target = np.vstack([-pair, *walls])
    mission = make_mission(start, Leg(Points(target, keep_order=True), 40), **FAR)
    arrives(sato.run(mission), mission)
