"""Prices in frames of one's own, and auctions that end with a point for everybody."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from problems.alignment import align
from problems.formation import Formation
from problems.formation_gain import design
from sato.formation.assigning import ask, prices, seen
from sato.formation.mission import Assigning, FormationFlight, aligned, misaligned
from sato.formation.swarm import Roles, State
from sato.radio import Radio
from sato.shapes.random_formation import random_formation, random_start, sparse_graph

KINDS = ("cbaa", "vsdaa", "hungarian")


def flight(seed, kind="vsdaa", share=0.7, agents=9, frames=None, **radio):
    """A flight to a random formation, and where everybody is."""
    rng = np.random.default_rng(seed)
    points = random_formation(agents, (9.0, 9.0, 3.0), 1.5, rng)
    gains = design(Formation(points, sparse_graph(points, share, rng)))
    start = np.column_stack([random_start(agents, (9.0, 9.0), 1.5, rng), np.ones(agents)])
    return FormationFlight(
        start,
        (gains,),
        aligned(agents) if frames is None else frames,
        assigning=Assigning(kind, fineness=1e-4),
        radio=Radio(**radio),
    )


def holding(point):
    """Roles in which everybody knows who holds what."""
    holder = np.tile(np.argsort(point), (len(point), 1))
    return Roles(point, holder, np.full(len(point), True), -1, np.zeros(3))


def known(mission, roles):
    """Where everything is, when everybody has just heard its neighbours."""
    state, frames = State.resting(mission.start, 0), mission.frames
    away = mission.start - frames.offset
    flat = (away[:, 0] + 1j * away[:, 1]) * frames.heading.conj()
    state.reckoned[:] = np.column_stack([flat.real, flat.imag, away[:, 2]])
    graph = mission.shapes[0].formation.graph
    for i, point in enumerate(roles.point):
        for j in roles.holder[i, graph[point]]:
            state.heard[i, j] = state.reckoned[j]
    return state


def priced(mission, roles, state):
    formation = mission.shapes[0].formation
    view = seen(state, roles, mission.frames, formation.graph)
    return prices(view, roles.point, formation.points)


def everybodys(mission, roles):
    """The prices from one frame that sees all, vehicle by vehicle and neighbour by neighbour."""
    formation, cost = mission.shapes[0].formation, []
    for i, point in enumerate(roles.point):
        near = np.append(np.flatnonzero(formation.graph[point]), point)
        there = mission.start[np.argsort(roles.point)[near]]
        placed = align(formation.points[near], there).place(formation.points)
        cost.append(((placed - mission.start[i]) ** 2).sum(axis=1))
    return np.array(cost)


@pytest.mark.parametrize("seed", range(6))
def test_prices_are_squared_ways_to_the_shape_laid_over_who_is_seen_in_any_frames(seed):
    rng = np.random.default_rng(seed)
    anyhow = misaligned(9, 50.0, 0.0, 0.0, rng)
    roles = holding(rng.permutation(9))
    for frames in (aligned(9), anyhow):
        mission = flight(seed, frames=frames)
        found = priced(mission, roles, known(mission, roles))
        assert found == pytest.approx(everybodys(mission, roles), abs=1e-9)


def test_who_was_not_heard_is_left_out_of_the_alignment():
    mission, roles = flight(1), holding(np.arange(9))
    graph = mission.shapes[0].formation.graph
    i, j = np.argwhere(graph & (graph.sum(axis=1) > 3)[:, None])[0]
    state = known(mission, roles)
    state.heard[i, j] = np.nan
    less = graph.copy()
    less[i, j] = False
    formation = mission.shapes[0].formation
    view = seen(state, roles, mission.frames, graph)
    assert np.array_equal(view.known, less | np.eye(9, dtype=bool))
    near = np.append(np.flatnonzero(less[i]), i)
    placed = align(formation.points[near], mission.start[near]).place(formation.points)
    cost = ((placed - mission.start[i]) ** 2).sum(axis=1)
    assert prices(view, roles.point, formation.points)[i] == pytest.approx(cost)


def test_a_vehicle_that_heard_nobody_lays_the_shape_over_itself():
    mission, roles = flight(2), holding(np.arange(9))
    state = known(mission, roles)
    state.heard[:] = np.nan
    cost = priced(mission, roles, state)
    assert np.diag(cost) == pytest.approx(np.zeros(9), abs=1e-12)
    points = mission.shapes[0].formation.points
    assert cost[0] == pytest.approx(((points - points[0]) ** 2).sum(axis=1))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_every_auction_gives_everybody_a_point_of_its_own_and_all_know_it(kind, seed):
    rng = np.random.default_rng(seed)
    mission = flight(seed, kind, frames=misaligned(9, 20.0, 0.0, 0.0, rng), delay=0.1)
    roles = holding(rng.permutation(9))
    outcome = ask(mission, 0, 0, known(mission, roles), roles, rng)
    assert sorted(outcome.point) == list(range(9))
    assert np.array_equal(outcome.holder, np.tile(np.argsort(outcome.point), (9, 1)))


@pytest.mark.parametrize("seed", range(4))
def test_the_outcome_is_the_same_whatever_the_frames(seed):
    rng = np.random.default_rng(seed)
    roles = holding(rng.permutation(9))
    for kind in KINDS:
        straight, turned = (
            flight(seed, kind, frames=frames) for frames in (None, misaligned(9, 9.0, 0, 0, rng))
        )
        one, other = (ask(m, 0, 0, known(m, roles), roles, rng) for m in (straight, turned))
        assert np.array_equal(one.point, other.point)


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
        kind: ask(flight(seed, kind), 0, 0, state, roles, rng).point for kind in ("vsdaa", "cbaa")
    }
    extent = np.linalg.norm(np.ptp(mission.shapes[0].formation.points, axis=0))
    bound = 9 * mission.assigning.fineness * extent  # N ε
    assert least - 1e-12 <= way[every, found["vsdaa"]].sum() <= least + bound
    score = 1 / (cost + 1e-8)
    most = score[linear_sum_assignment(-score)].sum()
    assert score[every, found["cbaa"]].sum() >= most / 2


@pytest.mark.parametrize("seed", range(4))
def test_hungarian_takes_the_shortest_ways_with_all_laid_over_all(seed):
    rng = np.random.default_rng(seed)
    mission, roles = flight(seed, "hungarian"), holding(rng.permutation(9))
    points = mission.shapes[0].formation.points
    placed = align(points[roles.point], mission.start).place(points)
    far = np.linalg.norm(mission.start[:, None] - placed, axis=2)
    found = ask(mission, 0, 0, known(mission, roles), roles, rng).point
    assert np.array_equal(found, linear_sum_assignment(far)[1])


def test_who_stands_in_the_shape_keeps_its_point():
    for kind in KINDS:
        mission = flight(3, kind)
        points = mission.shapes[0].formation.points
        point = np.random.default_rng(3).permutation(9)
        mission = replace(mission, start=points[point])
        outcome = ask(mission, 0, 0, known(mission, holding(point)), holding(point), any_rng())
        assert np.array_equal(outcome.point, point)


def any_rng():
    return np.random.default_rng(0)


def test_with_losses_who_knows_the_end_agrees_and_others_keep_what_they_had():
    some = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        roles = holding(rng.permutation(9))
        # 6 rounds: so few that some do not come to know.
        mission = flight(seed, "cbaa", share=0.5, loss=0.4, rate=3.0)
        outcome = ask(mission, 0, 0, known(mission, roles), roles, rng)
        kept = (outcome.holder == roles.holder).all(axis=1)
        assert np.array_equal(outcome.point[kept], roles.point[kept])
        knows = np.flatnonzero(~kept)
        assert (outcome.holder[knows] == outcome.holder[knows[:1]]).all()
        assert np.array_equal(outcome.holder[knows, outcome.point[knows]], knows)
        some += 0 < len(knows) < 9
    assert some >= 9


def test_with_time_enough_losses_do_no_harm():
    mission = flight(4, "cbaa", loss=0.2, delay=0.1)
    roles = holding(np.arange(9))
    state = known(mission, roles)
    lossless = ask(flight(4, "cbaa"), 0, 0, state, roles, any_rng())
    outcome = ask(mission, 0, 0, state, roles, any_rng())
    assert np.array_equal(outcome.point, lossless.point)
    assert np.array_equal(outcome.holder, lossless.holder)
    # That everybody knows, nobody can know: all go on until the next auction.
    assert outcome.rounds == mission.radio.rounds_within(mission.assigning.period)
    assert lossless.rounds < outcome.rounds


def test_messages_that_come_late_make_an_auction_as_much_longer():
    roles = holding(np.arange(9))
    soon = flight(4)
    state = known(soon, roles)
    outcome = ask(soon, 0, 0, state, roles, any_rng())
    late = ask(flight(4, delay=0.1), 0, 0, state, roles, any_rng())
    assert np.array_equal(outcome.point, late.point) and outcome.rounds > 0
    assert late.rounds == 6 * outcome.rounds  # five messages late, at 50 a second


def test_after_the_first_auction_points_change_hands_only_for_a_shorter_way():
    kept = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        roles = holding(rng.permutation(9))
        coarse = Assigning("vsdaa", fineness=0.05)
        mission = replace(flight(seed), assigning=coarse)
        state = known(mission, roles)
        way, every = np.sqrt(priced(mission, roles, state)), np.arange(9)
        extent = np.linalg.norm(np.ptp(mission.shapes[0].formation.points, axis=0))
        epsilon = coarse.fineness * extent
        first, later = (ask(mission, 0, k, state, roles, rng).point for k in (0, 1))
        least = way[linear_sum_assignment(way)].sum()
        assert way[every, first].sum() <= least + 9 * epsilon
        assert way[every, later].sum() <= least + 9 * 2.2 * epsilon
        kept += (later == roles.point).sum() - (first == roles.point).sum()
    assert kept > 0


def test_where_not_everybody_can_learn_the_end_all_stays_as_it_is():
    mission, roles = flight(5, "cbaa"), holding(np.arange(9))
    # After losses all may want one point, and then nobody hears anybody.
    confused = roles._replace(point=np.full(9, 4))
    outcome = ask(mission, 0, 0, known(mission, roles), confused, any_rng())
    assert np.array_equal(outcome.point, confused.point)
    assert np.array_equal(outcome.holder, confused.holder)
    assert outcome.rounds == 0
