"""Dense groups of targets that grow until all can pass, and paths that lead there and back."""

import numpy as np
import pytest
from planner_examples import RADIUS as R
from planner_examples import random_swarm
from scipy.spatial.distance import pdist

from sato.network.graph import CommunicationGraph
from sato.scp.bending import path_message
from sato.scp.halfway import meet_halfway
from sato.scp.spreading import PASSAGE, find_shift, spread_all, spread_out


def crowd(spacing, rows=4):
    """Square lattice of targets."""
    return spacing * np.stack(np.meshgrid(*[np.arange(rows)] * 2), axis=-1).reshape(-1, 2)


def grown(targets):
    """Targets after the growth that the agent of each finds."""
    own_first = [np.roll(targets, -i, axis=0) for i in range(len(targets))]
    return targets + np.array([find_shift(own, R) for own in own_first])


@pytest.mark.parametrize("gap", [1.02, 1.2, 1.35])
def test_all_can_pass_between_targets_of_a_crowd_that_grew(rng, gap):
    targets = rng.permutation(crowd(gap * R))
    after = grown(targets)
    assert pdist(targets).min() < PASSAGE * R
    assert pdist(after).min() == pytest.approx(PASSAGE * R)
    np.testing.assert_allclose(after.mean(axis=0), targets.mean(axis=0), atol=1e-12)


def test_rings_open_crowds_and_crowds_in_space_do_not_grow():
    angle = np.arange(12) * np.pi / 6
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    ring *= 1.2 * R / pdist(ring).min()
    for targets in (ring, crowd(PASSAGE * R), crowd(1.2 * R)[:2], crowd(1.2 * R, 1)):
        assert find_shift(targets, R) is None
    assert find_shift(np.pad(crowd(1.2 * R), ((0, 0), (0, 1))), R) is None


def test_crowds_apart_grow_each_about_its_own_center():
    crowds = np.vstack([crowd(1.2 * R), crowd(1.2 * R) + np.array([100.0, 0.0])])
    np.testing.assert_allclose(find_shift(crowds, R), find_shift(crowds[:16], R), atol=1e-12)


def delayed_group(rng, **delayed):
    """Planners with targets in a dense group, the first of which is changed."""
    planners = random_swarm(rng, 9, box=4.0)
    for (i, agent), place in zip(planners.items(), crowd(1.2 * R, 3), strict=True):
        planners[i] = agent._replace(target_state=np.concatenate([place, np.zeros(2)]))
    planners[0] = planners[0]._replace(**delayed)
    return planners, CommunicationGraph(~np.eye(9, dtype=bool), np.ones(9, dtype=bool))


def spread_agents(planners, graph):
    """Numbers of the agents whose paths spread."""
    return [i for i, after in spread_all(planners, graph).items() if after is not planners[i]]


def test_paths_spread_only_where_one_in_hearing_is_delayed(rng):
    planners, graph = delayed_group(rng)
    assert spread_agents(planners, graph) == []
    planners, graph = delayed_group(rng, is_delayed=True)
    alone = CommunicationGraph(np.zeros_like(graph.adjacency), graph.alive)
    assert spread_agents(planners, alone) == []
    assert spread_agents(planners, graph) == list(range(9))


def test_one_to_which_all_give_way_flies_straight_and_keeps_its_priority(rng):
    before = delayed_group(rng)[0][0].priority
    first = (before[0] - 0.5, *before[1:])
    planners, graph = delayed_group(rng, is_delayed=True, priority=first)
    assert spread_agents(planners, graph) == list(range(1, 9))
    found, *_ = meet_halfway(planners, graph)
    assert found[0].priority == first and found[0].has_converged


def test_spread_paths_begin_and_end_where_they_did(rng):
    planners, graph = delayed_group(rng, is_delayed=True)
    for i, after in spread_all(planners, graph).items():
        shift = after.control_points - planners[i].control_points
        np.testing.assert_allclose(shift[[0, -1], [0, -1]], 0.0, atol=1e-12)
        messages = [path_message(other) for j, other in planners.items() if j != i]
        same = spread_out(planners[i], messages).control_points
        np.testing.assert_array_equal(same, after.control_points)


def test_paths_that_are_bent_already_spread_from_the_straight_one(rng):
    planners, graph = delayed_group(rng, is_delayed=True)
    once = spread_all(planners, graph)
    for i, after in spread_all(once, graph).items():
        np.testing.assert_array_equal(after.control_points, once[i].control_points)
