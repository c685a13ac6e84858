"""Vehicles with given targets in each other's way arrive: halfway, in turn, or making room."""

import numpy as np
import pytest
from planner_examples import continuous_separation, random_swarm
from reconfiguration_runs import make_mission

import sato
from sato import Leg, Points
from sato.network.graph import CommunicationGraph
from sato.scp.bending import push_apart
from sato.scp.halfway import meet_halfway

R = 0.5
FAR = {"comm_radius": 50.0, "max_speed": 0.5, "assignment": "given"}


def exchange(start, steps, **changes):
    """A mission of vehicles that fly to the opposite places."""
    return make_mission(start, Leg(Points(-start, keep_order=True), steps), **FAR, **changes)


def circle(count, radius):
    angle = 2 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def arrives(run, mission):
    ends = run.data.position.values[-1], mission.legs[0].targets[:, : mission.axes]
    np.testing.assert_allclose(*ends, atol=1e-4)
    assert run.summary["reached"] and run.check().kept
    return run.summary


def test_vehicles_on_a_circle_exchange_sides_in_time():
    mission = exchange(circle(8, 4.0), 48)
    summary = arrives(sato.run(mission), mission)
    assert summary["legs"][0]["resets"] == 0
    assert summary["fuel_m_s"] <= 1.3 * summary["fuel_lower_bound_m_s"]


def test_vehicles_that_cross_a_sphere_decide_once_for_all():
    count, golden = 24, np.pi * (1 + 5**0.5)
    k = np.arange(count)
    z = 1 - (2 * k + 1) / count
    unit = np.column_stack([np.cos(golden * k), np.sin(golden * k), z])
    unit[:, :2] *= np.sqrt(1 - z**2)[:, None]
    mission = exchange(2.0 * unit, 30, model=sato.DoubleIntegrator(3))
    run = sato.run(mission)
    summary = arrives(run, mission)
    assert summary["cautious"] == summary["legs"][0]["resets"] == 0
    solves = [event["solves"] for event in run.events() if event["kind"] == "replan"]
    assert sum(number > 0 for number in solves) == 1


def test_pair_that_meets_in_a_lane_of_parked_vehicles_passes():
    x = np.arange(-3.0, 3.5, 0.75)
    walls = [np.column_stack([x, np.full_like(x, y)]) for y in (-0.7, 0.7)]
    pair = np.array([[-4.5, 0.0], [4.5, 0.0]])
    start = np.vstack([pair, *walls])
    target = np.vstack([-pair, *walls])
    mission = make_mission(start, Leg(Points(target, keep_order=True), 40), **FAR)
    arrives(sato.run(mission), mission)


def test_two_that_meet_head_on_are_pushed_to_their_right():
    path = np.column_stack([np.linspace(-2, 2, 41), np.zeros(41)])
    for own, other in ((path, -path), (-path, path)):
        (push,) = push_apart((own - other)[None], np.array([R]))
        way = own[-1] - own[0]
        right = np.array([way[1], -way[0]]) / np.linalg.norm(way)
        assert (push @ right).max() == pytest.approx(R)
        assert (push @ right).min() >= 0 and np.abs(push @ way).max() <= 1e-12


@pytest.mark.parametrize("axes", [2, 3])
def test_agents_that_meet_halfway_keep_their_distance_and_arrive(rng, axes):
    met = 0
    for _ in range(4):
        planners = random_swarm(rng, 4, axes)
        graph = CommunicationGraph(~np.eye(4, dtype=bool), np.ones(4, dtype=bool))
        found, *_ = meet_halfway(planners, graph)
        if all(agent.has_converged for agent in found.values()):
            assert continuous_separation(found) >= R * (1 - 1e-9)
            assert all(agent.reaches_target(agent.nominal) for agent in found.values())
            met += any(found[i].nominal is not planners[i].solo for i in found)
    assert met
