"""Assignment of points: costs in own frames, and auctions that give every agent a point."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from problems.alignment import align
from sato.formation.assignment import assign_points, compute_cost_matrix, observe_neighbors
from sato.formation.control_step import FormationState, Roles
from sato.formation.leg import FormationLeg, SparseGraph
from sato.formation.mission import Formation
from sato.formation.settings import AssignmentSettings, FrameSettings
from sato.network.radio import Radio
from sato.shapes.random_points import sample_formation, sample_positions

METHODS = ("cbaa", "vsdaa", "hungarian")
N = 9
ALIGNED = FrameSettings("aligned", 0.0, 0.0, 0.0)
RANDOM = FrameSettings("random", 20.0, 0.0, 0.0)


def mission(seed, method="vsdaa", share=0.7, frames=ALIGNED, epsilon=1e-4, **radio):
    """Draw a mission with a random start and formation; frames do not change the rest."""
    rng = np.random.default_rng(seed)
    points = sample_formation(N, (9.0, 9.0, 3.0), 1.5, rng)
    start = np.column_stack([sample_positions(N, (9.0, 9.0), 1.5, rng), np.ones(N)])
    return Formation(
        start=start,
        legs=[FormationLeg(points, SparseGraph(share))],
        frames=frames,
        assignment=AssignmentSettings(method, relative_epsilon=epsilon),
        radio=Radio(**radio),
    ).draw(rng)


def holding(assignment):
    """Roles in which all agents know the assignment."""
    holder = np.tile(np.argsort(assignment), (N, 1))
    return Roles(assignment, holder, np.full(N, True), -1, np.zeros(3))


def random_roles(seed):
    return holding(np.random.default_rng(seed).permutation(N))


def informed(mission, roles):
    """State in which every agent has just heard its neighbors."""
    start, frames = mission.initial_positions, mission.coordinate_frames
    state = FormationState.at_rest(start, 0)
    offset = start - frames.origin
    flat = (offset[:, 0] + 1j * offset[:, 1]) * frames.rotation.conj()
    state.measured_position[:] = np.column_stack([flat.real, flat.imag, offset[:, 2]])
    graph = mission.gains[0].formation.graph
    for i, point in enumerate(roles.assignment):
        j = roles.holder[i, graph[point]]
        state.received_flat[i, j] = flat[j]
        state.received_height[i, j] = offset[j, 2]
    return state


def costs(mission, roles, state):
    formation = mission.gains[0].formation
    seen = observe_neighbors(state, roles, mission.coordinate_frames, formation.graph)
    return compute_cost_matrix(seen, roles.assignment, formation.points)


def costs_in_one_frame(mission, roles):
    """Compute the same costs from true positions in one frame, agent by agent."""
    formation, start, cost = mission.gains[0].formation, mission.initial_positions, []
    for i, point in enumerate(roles.assignment):
        near = np.append(np.flatnonzero(formation.graph[point]), point)
        there = start[np.argsort(roles.assignment)[near]]
        placed = align(formation.points[near], there).transform(formation.points)
        cost.append(((placed - start[i]) ** 2).sum(axis=1))
    return np.array(cost)


def auction(mission, roles, state=None, index=0, seed=0):
    state = informed(mission, roles) if state is None else state
    return assign_points(mission, 0, index, state, roles, np.random.default_rng(seed))


@pytest.mark.parametrize("frames", [ALIGNED, RANDOM], ids=["aligned", "random"])
@pytest.mark.parametrize("seed", range(4))
def test_costs_are_squared_distances_to_the_formation_in_any_frames(seed, frames):
    flight, roles = mission(seed, frames=frames), random_roles(seed)
    found = costs(flight, roles, informed(flight, roles))
    assert found == pytest.approx(costs_in_one_frame(flight, roles), abs=1e-9)


def test_agents_not_heard_are_left_out_of_the_alignment():
    flight, roles = mission(1), holding(np.arange(N))
    formation, start = flight.gains[0].formation, flight.initial_positions
    graph = formation.graph
    i, j = np.argwhere(graph & (graph.sum(axis=1) > 3)[:, None])[0]
    state = informed(flight, roles)
    state.received_flat[i, j] = state.received_height[i, j] = np.nan
    less = graph.copy()
    less[i, j] = False
    seen = observe_neighbors(state, roles, flight.coordinate_frames, graph)
    assert np.array_equal(seen.is_known, less | np.eye(N, dtype=bool))
    near = np.append(np.flatnonzero(less[i]), i)
    placed = align(formation.points[near], start[near]).transform(formation.points)
    cost = ((placed - start[i]) ** 2).sum(axis=1)
    assert compute_cost_matrix(seen, roles.assignment, formation.points)[i] == pytest.approx(cost)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("seed", range(4))
def test_auction_gives_each_agent_its_own_point_in_any_frames(method, seed):
    roles = random_roles(seed)
    found, aligned = (
        auction(mission(seed, method, frames=frames, delay=0.1), roles)
        for frames in (RANDOM, ALIGNED)
    )
    assert sorted(found.assignment) == list(range(N))
    assert np.array_equal(found.holder, np.tile(np.argsort(found.assignment), (N, 1)))
    assert np.array_equal(found.assignment, aligned.assignment)


@pytest.mark.parametrize("seed", range(4))
def test_auctions_keep_their_bounds_on_cost_and_score(seed):
    flight, roles, every = mission(seed), random_roles(seed), np.arange(N)
    state = informed(flight, roles)
    cost = costs(flight, roles, state)
    distance, score = np.sqrt(cost), 1 / (cost + 1e-8)
    found = {kind: auction(mission(seed, kind), roles, state).assignment for kind in METHODS}
    extent = np.linalg.norm(np.ptp(flight.gains[0].formation.points, axis=0))
    bound = N * flight.assignment.relative_epsilon * extent  # N ε
    least = distance[linear_sum_assignment(distance)].sum()
    assert least - 1e-12 <= distance[every, found["vsdaa"]].sum() <= least + bound
    most = score[linear_sum_assignment(-score)].sum()
    assert score[every, found["cbaa"]].sum() >= most / 2


@pytest.mark.parametrize("seed", range(4))
def test_hungarian_minimizes_distances_to_one_common_alignment(seed):
    flight, roles = mission(seed, "hungarian"), random_roles(seed)
    points, start = flight.gains[0].formation.points, flight.initial_positions
    placed = align(points[roles.assignment], start).transform(points)
    distance = np.linalg.norm(start[:, None] - placed, axis=2)
    found = auction(flight, roles).assignment
    assert np.array_equal(found, linear_sum_assignment(distance)[1])


@pytest.mark.parametrize("method", METHODS)
def test_swarm_in_formation_keeps_its_assignment(method):
    flight, roles = mission(3, method), random_roles(3)
    points = flight.gains[0].formation.points
    flight = replace(flight, start=points[roles.assignment])
    assert np.array_equal(auction(flight, roles).assignment, roles.assignment)


def test_with_losses_informed_agents_agree_and_others_keep_their_points():
    partly = 0
    for seed in range(12):
        # 6 rounds are too few for all agents to learn the outcome.
        flight = mission(seed, "cbaa", share=0.5, loss_probability=0.4, message_rate=50 / 16)
        roles = random_roles(seed)
        outcome = auction(flight, roles, seed=seed)
        kept = (outcome.holder == roles.holder).all(axis=1)
        assert np.array_equal(outcome.assignment[kept], roles.assignment[kept])
        knows = np.flatnonzero(~kept)
        assert (outcome.holder[knows] == outcome.holder[knows[:1]]).all()
        assert np.array_equal(outcome.holder[knows, outcome.assignment[knows]], knows)
        partly += 0 < len(knows) < N
    assert partly >= 9


def test_with_enough_rounds_losses_do_not_change_the_outcome():
    flight, roles = mission(4, "cbaa", loss_probability=0.2, delay=0.1), holding(np.arange(N))
    lossless, outcome = auction(mission(4, "cbaa"), roles), auction(flight, roles)
    assert np.array_equal(outcome.assignment, lossless.assignment)
    assert np.array_equal(outcome.holder, lossless.holder)
    # No agent can know that all know, so the auction lasts until the next.
    assert outcome.rounds == flight.radio.rounds_within(flight.assignment.period)
    assert lossless.rounds < outcome.rounds


def test_delayed_messages_lengthen_an_auction_in_proportion():
    roles = holding(np.arange(N))
    outcome, late = auction(mission(4), roles), auction(mission(4, delay=0.1), roles)
    assert np.array_equal(outcome.assignment, late.assignment) and outcome.rounds > 0
    assert late.rounds == 6 * outcome.rounds  # five messages late, at 50 a second


def test_later_auctions_keep_more_points_within_their_bound():
    kept, every = 0, np.arange(N)
    for seed in range(20):
        flight, roles = mission(seed, epsilon=0.05), random_roles(seed)
        state = informed(flight, roles)
        distance = np.sqrt(costs(flight, roles, state))
        epsilon = 0.05 * np.linalg.norm(np.ptp(flight.gains[0].formation.points, axis=0))
        first, later = (auction(flight, roles, state, index=k).assignment for k in (0, 1))
        least = distance[linear_sum_assignment(distance)].sum()
        assert distance[every, first].sum() <= least + N * epsilon
        assert distance[every, later].sum() <= least + N * 2.2 * epsilon
        kept += (later == roles.assignment).sum() - (first == roles.assignment).sum()
    assert kept > 0


def test_disconnected_network_keeps_its_assignment():
    flight, roles = mission(5, "cbaa"), holding(np.arange(N))
    # After losses all agents may hold one point, and then none hears another.
    confused = roles._replace(assignment=np.full(N, 4))
    outcome = auction(flight, confused, informed(flight, roles))
    assert np.array_equal(outcome.assignment, confused.assignment)
    assert np.array_equal(outcome.holder, confused.holder)
    assert outcome.rounds == 0
