"""Crowds of targets that grow until all can pass, and paths that lead there and back."""

import numpy as np
import pytest
from planner_examples import RADIUS as R
from planner_examples import random_swarm
from scipy.spatial.distance import pdist

from sato.network.graph import CommunicationGraph
from sato.scp.bending import path_message
from sato.scp.spreading import PASSAGE, find_growth, spread_all, spread_out


def crowd(spacing, rows=4):
    """Square lattice of targets."""
    return spacing * np.stack(np.meshgrid(*[np.arange(rows)] * 2), axis=-1).reshape(-1, 2)


def grown(targets):
    """Targets after the growth that the agent of each finds."""
    own_first = [np.roll(targets, -i, axis=0) for i in range(len(targets))]
    return targets + np.array([find_growth(own, R) for own in own_first])


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
        assert find_growth(targets, R) is None
    assert find_growth(np.pad(crowd(1.2 * R), ((0, 0), (0, 1))), R) is None


def test_crowds_apart_grow_each_about_its_own_center():
    crowds = np.vstack([crowd(1.2 * R), crowd(1.2 * R) + np.array([100.0, 0.0])])
    np.testing.assert_allclose(find_growth(crowds, R), find_growth(crowds[:16], R), atol=1e-12)


def delayed_crowd(rng, is_delayed):
    """Planners with targets in a crowd, the first of which others have delayed."""
    planners = random_swarm(rng, 9, box=4.0)
    for (i, agent), place in zip(planners.items(), crowd(1.2 * R, 3), strict=True):
        target = np.concatenate([place, np.zeros(2)])
        planners[i] = agent._replace(target_state=target, is_delayed=is_delayed and i == 0)
    return planners, CommunicationGraph(~np.eye(9, dtype=bool), np.ones(9, dtype=bool))


def test_paths_spread_only_where_one_in_hearing_is_delayed(rng):
    planners, graph = delayed_crowd(rng, is_delayed=False)
    assert all(after is planners[i] for i, after in spread_all(planners, graph).items())
    planners, graph = delayed_crowd(rng, is_delayed=True)
    alone = CommunicationGraph(np.zeros_like(graph.adjacency), graph.alive)
    assert all(after is planners[i] for i, after in spread_all(planners, alone).items())
    assert any(after is not planners[i] for i, after in spread_all(planners, graph).items())


def test_spread_paths_begin_and_end_where_they_did(rng):
    planners, graph = delayed_crowd(rng, is_delayed=True)
    for i, after in spread_all(planners, graph).items():
        shift = after.control_points - planners[i].control_points
        np.testing.assert_allclose(shift[0, 0], 0.0, atol=1e-12)
        np.testing.assert_allclose(shift[-1, -1], 0.0, atol=1e-12)
        messages = [path_message(other) for j, other in planners.items() if j != i]
        same = spread_out(planners[i], messages).control_points
        np.testing.assert_array_equal(same, after.control_points)
