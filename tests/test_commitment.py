"""Commitment: what agents change their trajectories to keeps clear of those of their neighbors."""

from dataclasses import replace

import numpy as np
import pytest
from reconfiguration_runs import leg_to, make_mission

from dynamics.trajectory_geometry import hull_distance
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.commitment import improve, stopping_horizon
from sato.reconfiguration.planning import Plan
from sato.reconfiguration.state import AgentMemory, DecisionContext


@pytest.mark.parametrize("goal", [[-3.0, 0.5], [3.0, 0.5], [0.0, 3.0]])
def test_change_keeps_the_distance_to_a_neighbor_that_is_too_near(goal):
    states = np.array([[0.0, 0.0, 0.1, 0.0], [0.7, 0.1, 0.0, 0.0]])
    targets = np.array([[*goal, 0.0, 0.0], [8.0, 0.0, 0.0, 0.0]])
    mission = make_mission(states, leg_to(targets, 30))
    graph = CommunicationGraph.from_positions(states[:, :2], 4.0, np.ones(2, dtype=bool))
    memory = AgentMemory.initial(np.full(2, 2))
    context = DecisionContext(mission, mission.legs[0], graph, states, memory, 0, 0.0)
    context = context._replace(memory=replace(memory, target_index=np.arange(2)))
    horizon = stopping_horizon(mission, 8)
    stop = np.zeros((2, 7, 2))
    stop[0, 0, 0] = -0.1
    paths = horizon.control_points(horizon.discrete_model[:7].simulate(states, stop), stop)
    kept = hull_distance(paths[0] - paths[1])[0].min()
    assert kept < 0.7
    way = np.linspace(states[0], targets[0], 31)
    way[:, 2:] = (way[1] - way[0])[:2]
    transfer = context.make_transfer(context.remaining_model(0), 0)
    plan = Plan(transfer.simulate(states[0], np.zeros((30, 2)))._replace(x=way), 0, 0, 4)
    far = np.array([0.9])  # to be kept, and more than there is
    found = improve(context, 0, plan, horizon, paths[0], paths[1:], far)
    assert found is not None
    u, path = found
    assert np.abs(path - paths[0]).max() > 1e-3
    assert hull_distance(path - paths[1])[0].min() >= kept * (1 - 1e-9)
    end = horizon.discrete_model.simulate(states[0], u)[-1]
    np.testing.assert_allclose(end[2:], 0, atol=1e-12)
