"""Prices in frames of one's own, and auctions that end with a point for everybody."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from problems.alignment import align
from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.formation.assignment import assign_points, compute_cost_matrix, observe_neighbors
from sato.formation.kernel import FormationState, Roles
from sato.formation.mission import AssignmentSettings, Formation, aligned_frames, draw_frames
from sato.network.radio import Radio
from sato.shapes.graphs import random_sparse_graph
from sato.shapes.random_points import sample_formation, sample_positions

KINDS = ("cbaa", "vsdaa", "hungarian")


def flight(seed, kind="vsdaa", share=0.7, agents=9, frames=None, **radio):
    """A flight to a random formation, and where everybody is."""
    rng = np.random.default_rng(seed)
    points = sample_formation(agents, (9.0, 9.0, 3.0), 1.5, rng)
    gains = design_gains(DesiredFormation(points, random_sparse_graph(points, share, rng)))
    start = np.column_stack([sample_positions(agents, (9.0, 9.0), 1.5, rng), np.ones(agents)])
    return Formation(
        start,
        (gains,),
        aligned_frames(agents) if frames is None else frames,
        assignment=AssignmentSettings(kind, relative_epsilon=1e-4),
        radio=Radio(**radio),
    )


def holding(point):
    """Roles in which everybody knows who holds what."""
    holder = np.tile(np.argsort(point), (len(point), 1))
    return Roles(point, holder, np.full(len(point), True), -1, np.zeros(3))


def known(mission, roles):
    """Where everything is, when everybody has just heard its neighbours."""
    state, frames = FormationState.at_rest(mission.start, 0), mission.frames
    away = mission.start - frames.offset
    flat = (away[:, 0] + 1j * away[:, 1]) * frames.rotation.conj()
    state.measured_position[:] = np.column_stack([flat.real, flat.imag, away[:, 2]])
    graph = mission.gains[0].formation.graph
    for i, point in enumerate(roles.point):
        for j in roles.holder[i, graph[point]]:
            state.received[i, j] = state.measured_position[j]
    return state


def priced(mission, roles, state):
    formation = mission.gains[0].formation
    view = observe_neighbors(state, roles, mission.frames, formation.graph)
    return compute_cost_matrix(view, roles.point, formation.points)


def everybodys(mission, roles):
    """The prices from one frame that sees all, vehicle by vehicle and neighbour by neighbour."""
    formation, cost = mission.gains[0].formation, []
    for i, point in enumerate(roles.point):
        near = np.append(np.flatnonzero(formation.graph[point]), point)
        there = mission.start[np.argsort(roles.point)[near]]
        placed = align(formation.points[near], there).transform(formation.points)
        cost.append(((placed - mission.start[i]) ** 2).sum(axis=1))
    return np.array(cost)


@pytest.mark.parametrize("seed", range(6))
def test_prices_are_squared_ways_to_the_shape_laid_over_who_is_seen_in_any_frames(seed):
    rng = np.random.default_rng(seed)
    anyhow = draw_frames(9, 50.0, 0.0, 0.0, rng)
    roles = holding(rng.permutation(9))
    for frames in (aligned_frames(9), anyhow):
        mission = flight(seed, frames=frames)
        found = priced(mission, roles, known(mission, roles))
        assert found == pytest.approx(everybodys(mission, roles), abs=1e-9)


def test_who_was_not_heard_is_left_out_of_the_alignment():
    mission, roles = flight(1), holding(np.arange(9))
    graph = mission.gains[0].formation.graph
    i, j = np.argwhere(graph & (graph.sum(axis=1) > 3)[:, None])[0]
    state = known(mission, roles)
    state.received[i, j] = np.nan
    less = graph.copy()
    less[i, j] = False
    formation = mission.gains[0].formation
    view = observe_neighbors(state, roles, mission.coordinate_frames, graph)
    assert np.array_equal(view.is_known, less | np.eye(9, dtype=bool))
    near = np.append(np.flatnonzero(less[i]), i)
    placed = align(formation.points[near], mission.start[near]).transform(formation.points)
    cost = ((placed - mission.start[i]) ** 2).sum(axis=1)
    assert compute_cost_matrix(view, roles.assignment, formation.points)[i] == pytest.approx(cost)


def test_a_vehicle_that_heard_nobody_lays_the_shape_over_itself():
    mission, roles = flight(2), holding(np.arange(9))
    state = known(mission, roles)
    state.received[:] = np.nan
    cost = priced(mission, roles, state)
    assert np.diag(cost) == pytest.approx(np.zeros(9), abs=1e-12)
    points = mission.gains[0].formation.points
    assert cost[0] == pytest.approx(((points - points[0]) ** 2).sum(axis=1))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_every_auction_gives_everybody_a_point_of_its_own_and_all_know_it(kind, seed):
    rng = np.random.default_rng(seed)
    mission = flight(seed, kind, frames=draw_frames(9, 20.0, 0.0, 0.0, rng), delay=0.1)
    roles = holding(rng.permutation(9))
    outcome = assign_points(mission, 0, 0, known(mission, roles), roles, rng)
    assert sorted(outcome.assignment) == list(range(9))
    assert np.array_equal(outcome.holder, np.tile(np.argsort(outcome.assignment), (9, 1)))


@pytest.mark.parametrize("seed", range(4))
def test_the_outcome_is_the_same_whatever_the_frames(seed):
    rng = np.random.default_rng(seed)
    roles = holding(rng.permutation(9))
    for kind in KINDS:
        straight, turned = (
            flight(seed, kind, frames=frames) for frames in (None, draw_frames(9, 9.0, 0, 0, rng))
        )
        one, other = (
            assign_points(m, 0, 0, known(m, roles), roles, rng) for m in (straight, turned)
        )
        assert np.array_equal(one.assignment, other.assignment)


@pytest.mark.parametrize("seed", range(4))
def test_the_auctions_are_as_good_as_they_say(seed):
    rng = np.random.default_rng(seed)
    roles = holding(rng.permutation(9))
    mission = flight(seed)
    state = known(mission, roles)
    cost, every = priced(mission, roles, state), np.arange(9)
    way = np.sqrt(cost)
    least = way[linear_sum_assignment(way)].sum()
    found = {
        kind: assign_points(flight(seed, kind), 0, 0, state, roles, rng).assignment
        for kind in ("vsdaa", "cbaa")
    }
    extent = np.linalg.norm(np.ptp(mission.gains[0].formation.points, axis=0))
    bound = 9 * mission.assignment.relative_epsilon * extent  # N ε
    assert least - 1e-12 <= way[every, found["vsdaa"]].sum() <= least + bound
    score = 1 / (cost + 1e-8)
    most = score[linear_sum_assignment(-score)].sum()
    assert score[every, found["cbaa"]].sum() >= most / 2


@pytest.mark.parametrize("seed", range(4))
def test_hungarian_takes_the_shortest_ways_with_all_laid_over_all(seed):
    rng = np.random.default_rng(seed)
    mission, roles = flight(seed, "hungarian"), holding(rng.permutation(9))
    points = mission.gains[0].formation.points
    placed = align(points[roles.assignment], mission.start).transform(points)
    far = np.linalg.norm(mission.start[:, None] - placed, axis=2)
    found = assign_points(mission, 0, 0, known(mission, roles), roles, rng).assignment
    assert np.array_equal(found, linear_sum_assignment(far)[1])


def test_who_stands_in_the_shape_keeps_its_point():
    for kind in KINDS:
        mission = flight(3, kind)
        points = mission.gains[0].formation.points
        point = np.random.default_rng(3).permutation(9)
        mission = replace(mission, start=points[point])
        outcome = assign_points(
            mission, 0, 0, known(mission, holding(point)), holding(point), any_rng()
        )
        assert np.array_equal(outcome.assignment, point)


def any_rng():
    return np.random.default_rng(0)


def test_with_losses_who_knows_the_end_agrees_and_others_keep_what_they_had():
    some = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        roles = holding(rng.permutation(9))
        # 6 rounds: so few that some do not come to know.
        mission = flight(seed, "cbaa", share=0.5, loss=0.4, rate=3.0)
        outcome = assign_points(mission, 0, 0, known(mission, roles), roles, rng)
        kept = (outcome.holder == roles.holder).all(axis=1)
        assert np.array_equal(outcome.assignment[kept], roles.assignment[kept])
        knows = np.flatnonzero(~kept)
        assert (outcome.holder[knows] == outcome.holder[knows[:1]]).all()
        assert np.array_equal(outcome.holder[knows, outcome.assignment[knows]], knows)
        some += 0 < len(knows) < 9
    assert some >= 9


def test_with_time_enough_losses_do_no_harm():
    mission = flight(4, "cbaa", loss=0.2, delay=0.1)
    roles = holding(np.arange(9))
    state = known(mission, roles)
    lossless = assign_points(flight(4, "cbaa"), 0, 0, state, roles, any_rng())
    outcome = assign_points(mission, 0, 0, state, roles, any_rng())
    assert np.array_equal(outcome.assignment, lossless.assignment)
    assert np.array_equal(outcome.holder, lossless.holder)
    # That everybody knows, nobody can know: all go on until the next auction.
    assert outcome.rounds == mission.radio.rounds_within(mission.assignment.period)
    assert lossless.rounds < outcome.rounds


def test_messages_that_come_late_make_an_auction_as_much_longer():
    roles = holding(np.arange(9))
    soon = flight(4)
    state = known(soon, roles)
    outcome = assign_points(soon, 0, 0, state, roles, any_rng())
    late = assign_points(flight(4, delay=0.1), 0, 0, state, roles, any_rng())
    assert np.array_equal(outcome.assignment, late.assignment) and outcome.rounds > 0
    assert late.rounds == 6 * outcome.rounds  # five messages late, at 50 a second


def test_after_the_first_auction_points_change_hands_only_for_a_shorter_way():
    kept = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        roles = holding(rng.permutation(9))
        coarse = AssignmentSettings("vsdaa", relative_epsilon=0.05)
        mission = replace(flight(seed), assignment=coarse)
        state = known(mission, roles)
        way, every = np.sqrt(priced(mission, roles, state)), np.arange(9)
        extent = np.linalg.norm(np.ptp(mission.gains[0].formation.points, axis=0))
        epsilon = coarse.relative_epsilon * extent
        first, later = (assign_points(mission, 0, k, state, roles, rng).assignment for k in (0, 1))
        least = way[linear_sum_assignment(way)].sum()
        assert way[every, first].sum() <= least + 9 * epsilon
        assert way[every, later].sum() <= least + 9 * 2.2 * epsilon
        kept += (later == roles.assignment).sum() - (first == roles.assignment).sum()
    assert kept > 0


def test_where_not_everybody_can_learn_the_end_all_stays_as_it_is():
    mission, roles = flight(5, "cbaa"), holding(np.arange(9))
    # After losses all may want one point, and then nobody hears anybody.
    confused = roles._replace(point=np.full(9, 4))
    outcome = assign_points(mission, 0, 0, known(mission, roles), confused, any_rng())
    assert np.array_equal(outcome.assignment, confused.assignment)
    assert np.array_equal(outcome.holder, confused.holder)
    assert outcome.rounds == 0
