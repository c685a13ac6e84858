"""Commitment: a property test for each lemma of docs/safety.md."""

from dataclasses import replace

import numpy as np
import pytest
from commitment_examples import (
    begin,
    crowd,
    distance,
    least_distances,
    random_mission,
    random_offers,
    random_reach,
    reflection,
    sample,
    stop_at_once,
)
from graphs import random_graph
from messages import run_rounds
from reconfiguration_runs import leg_to, make_mission, row

import sato
from dynamics.trajectory_geometry import hull_distance
from problems import convexify
from sato.network.graph import CommunicationGraph
from sato.reconfiguration import commitment, loop
from sato.reconfiguration.agent_stages import Choosing
from sato.reconfiguration.commitment import choose_offers, improve
from sato.reconfiguration.offers import Offers, make_offers
from sato.reconfiguration.plan import Plan
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.reconfiguration.stopping import end_at_rest, stopping_horizon

NORMS = (1, 2, "inf")
ROUNDING = 1e-9


def decide_by_messages(offers, graph, rank):
    """Let agents choose by messages alone; each knows its own offers, up to its own rest."""
    pieces = offers.horizon.pieces_per_step
    states = {}
    for i in np.flatnonzero(graph.alive).tolist():
        (a,) = np.flatnonzero(offers.agents == i)
        own = Offers(
            offers.agents[[a]],
            offers.plan_steps,
            offers.steps[[a]],
            offers.horizon,
            offers.u[[a], :],
            offers.paths[[a], :, : offers.steps[a] * pieces],
            offers.is_allowed[[a]],
            offers.clearance[[a]],
        )
        best = int(own.is_allowed[0].argmax())
        states[i] = Choosing(own, (0.0, 0.0, int(rank[a])), int(graph.diameter[i]), best)
    rounds = list(run_rounds(graph, states, Choosing.update, lambda s: s.message, is_over))
    return np.array([rounds[-1][i].choice for i in offers.agents.tolist()])


def is_over(state):
    """Tell whether an agent has chosen."""
    return state.is_finished


@pytest.fixture(scope="module")
def decisions():
    """Decisions in random missions: arguments of `commit`, and what it returned."""
    taken = []

    def note(context, plans, committed):
        found = commitment.commit(context, plans, committed)
        taken.append(((context, plans, dict(committed)), found))
        return found

    with pytest.MonkeyPatch.context() as unkept:
        # Where plans are kept to their ends, few decisions are left.
        unkept.setattr(sato.Reconfiguration, "keeps_plans", False)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(loop, "commit", note)
            for seed in range(20):
                begin(random_mission(np.random.default_rng([7, seed])), 25)
            # Far to go, at full speed and with little thrust: reach binds.
            tight = {
                "comm_radius": 2.2,
                "horizon_steps": 2,
                "auction_steps": 2,
                "max_control": 0.05,
            }
            begin(make_mission(row(4, 0.0), sato.Leg(row(4, 15.0), 90), **tight), 25)
        yield taken


@pytest.mark.parametrize("norm", NORMS)
def test_stops_rest_within_the_limit_in_fewest_steps(rng, norm):
    for _ in range(20):
        d, h = int(rng.integers(2, 4)), rng.uniform(0.1, 2)
        leg = sato.Leg(row(2, 3.0, d), 100)
        own = {"control_norm": norm, "comm_radius": 10.0, "step": h, "max_control": 0.3}
        if norm == "inf":
            own |= {"max_control": None, "max_control_axes": rng.uniform(0.1, 1, d).tolist()}
        mission = make_mission(row(2, 0.0, d), leg, **own)
        limit, agents = mission.control_limit(0), np.zeros(20, dtype=int)
        v = rng.normal(size=(20, d)) * rng.choice([0, 1e-8, 0.1, 1, 10], (20, 1))
        whole = rng.random(20) < 0.2  # exactly a number of steps
        size = rng.integers(1, 5, 20) * limit.most * h / np.maximum(limit.measure(v), 1e-9)
        v[whole] *= size[whole, None]
        u, length = end_at_rest(mission, agents, v, np.zeros((20, 0, d)), agents)
        off = np.abs(v + h * u.sum(axis=1)).max(axis=1)
        assert (off <= 1e-12 * np.maximum(limit.most * h, np.abs(v).max(axis=1))).all()
        assert (limit.measure(u) <= limit.most * (1 + ROUNDING)).all()
        # Each step takes away U h at most of the norm.
        assert ((limit.measure(v) > (length - 1) * limit.most * h) | (length == 0)).all()


def test_many_end_at_rest_as_each_alone_under_limits_of_its_own(rng):
    mission = make_mission(row(3, 0.0), sato.Leg(row(3, 3.0), 14), max_control=[0.1, 0.2, 0.4])
    agents = rng.integers(0, 3, 40)
    velocity, steps = rng.normal(0, 0.5, (40, 2)), rng.integers(0, 6, 40)
    u = 0.1 * rng.normal(size=(40, 5, 2))
    found, length = end_at_rest(mission, agents, velocity, u, steps)
    for a, i in enumerate(agents.tolist()):
        begun, limit = u[a, : steps[a]], mission.planned_control_limit(i)
        left = velocity[a] + mission.step * begun.sum(axis=0)
        alone = np.vstack([begun, stop_at_once(limit, left, mission.step)])
        np.testing.assert_allclose(found[a, : length[a]], alone, atol=1e-15)
        assert length[a] == len(alone) and not found[a, length[a] :].any()


def test_offers_keep_the_limit_begin_as_planned_and_end_at_rest(decisions):
    seen = 0
    for (context, plans, committed), _ in decisions:
        mission, d = context.mission, context.mission.axes
        none = np.zeros((0, d))
        offers = make_offers(context, plans, committed)
        start = np.repeat(context.state[offers.agents][:, None], len(offers.plan_steps), axis=1)
        x = offers.horizon.discrete_model.simulate(start, offers.u[:, :])
        paths, (middle, extent) = offers.horizon.control_points(x, offers.u[:, :]), offers.enclose()
        np.testing.assert_allclose(offers.paths[:, :], paths, atol=1e-12)
        away = np.linalg.norm(paths - middle[:, None, None, None], axis=-1).max(axis=(1, 2, 3))
        assert (away <= extent + 1e-12).all()
        for a, i in enumerate(offers.agents.tolist()):
            limit = mission.control_limit(i)
            assert limit.measure(offers.u[a, :]).max() <= limit.most * (1 + ROUNDING)
            rest = x[a, :, offers.steps[a] - 1 :, d:]
            assert np.abs(rest).max() <= 1e-9 * limit.most * mission.step
            held = committed[i].controls_from(context.instant) if i in committed else none
            for q, u in zip(offers.plan_steps, offers.u[a, :], strict=True):
                begun = limit.cut(plans[i].trajectory.u[:q]) if q else held
                np.testing.assert_array_equal(u[: len(begun)], begun)
                seen += len(begun)
    assert seen > 1000


def test_offers_that_are_allowed_stay_within_reach(decisions):
    refused = 0
    for (context, plans, committed), _ in decisions:
        mission, d = context.mission, context.mission.axes
        # At full thrust all the time, some plans lead too far.
        hasty = {
            i: plan._replace(trajectory=plan.trajectory._replace(u=np.full((20, d), 1.0)))
            for i, plan in plans.items()
        }
        offers = make_offers(context, hasty, committed)
        start = np.repeat(context.state[offers.agents][:, None], len(offers.plan_steps), axis=1)
        x = offers.horizon.discrete_model.simulate(start, offers.u[:, :])
        dense = sample(x, offers.u[:, :], mission.step, 20)
        reach = (mission.comm_radius - offers.horizon.clearance) / 2
        away = np.zeros(offers.is_allowed.shape)
        for k in range(offers.horizon.steps):
            later = dense[..., 20 * k :, :] - x[..., k, None, :d]
            away = np.maximum(away, np.linalg.norm(later, axis=-1).max(axis=-1))
        assert (away[offers.is_allowed] <= reach * (1 + 2 * ROUNDING)).all()
        refused += (away > reach).sum()
    assert refused > 0


@pytest.mark.parametrize("axes", [2, 3])
def test_neighbors_choose_offers_that_are_clear_whatever_the_graph(rng, axes):
    mission, chosen, kept = crowd(axes), 0, 0
    for _ in range(60):
        agents = int(rng.integers(2, 9))
        offers, dense = random_offers(rng, mission, agents, 1.2 * agents ** (1 / axes))
        graph, rank = random_graph(rng, agents, rng.random()), rng.permutation(agents)
        choice, _ = choose_offers(offers, graph, rank)
        rows = np.arange(agents)
        assert offers.is_allowed[rows, choice].all()
        apart = least_distances(dense[rows, choice])
        needed = (offers.clearance[:, None] + offers.clearance) / 2
        both_last = (choice == offers.last)[:, None] & (choice == offers.last)
        checked = graph.adjacency & ~both_last
        assert (apart >= needed - ROUNDING)[checked].all()
        chosen, kept = chosen + checked.sum(), kept + (choice == offers.last).sum()
    assert chosen > 100 and kept >= 10


def test_committed_trajectories_are_always_an_answer(rng):
    mission = crowd()
    for _ in range(20):
        agents = int(rng.integers(1, 9))
        offers, _ = random_offers(rng, mission, agents, 0.3)
        offers.is_allowed[:, :-1] = False
        graph = random_graph(rng, agents, 1.0)
        choice, _ = choose_offers(offers, graph, rng.permutation(agents))
        assert (choice == offers.last).all()


def test_agents_keep_a_plan_that_is_clear_of_all(rng):
    # Far apart, everybody's best offer is chosen.
    mission = crowd()
    offers, _ = random_offers(rng, mission, 6, 0.1)
    offers.paths[:] += 50.0 * np.arange(6)[:, None, None, None, None]
    choice, _ = choose_offers(offers, random_graph(rng, 6, 1.0), np.arange(6))
    np.testing.assert_array_equal(choice, offers.is_allowed.argmax(axis=1))


def test_choice_by_messages_is_that_of_all_at_once(rng):
    differs = 0
    for axes in (2, 3):
        mission = crowd(axes)
        for _ in range(25):
            agents = int(rng.integers(1, 9))
            offers, _ = random_offers(rng, mission, agents, 1.0 * agents ** (1 / axes))
            graph, rank = random_graph(rng, agents, rng.random()), rng.permutation(agents)
            choice, _ = choose_offers(offers, graph, rank)
            np.testing.assert_array_equal(decide_by_messages(offers, graph, rank), choice)
            differs += (choice != offers.is_allowed.argmax(axis=1)).sum()
    assert differs > 20


def test_step_of_the_filter_is_clear_and_rests_within_its_half_spaces(decisions, monkeypatch):
    improved = note_calls(monkeypatch, commitment, "improve")
    stops = note_calls(monkeypatch, commitment, "find_stop")
    walls = note_calls(monkeypatch, convexify, "convexify")
    for arguments, _ in decisions:
        commitment.commit(*arguments)
    for (arguments, found), (_, half_spaces) in zip(stops, walls, strict=True):
        mission, agent, d = arguments[0], arguments[2], arguments[0].axes
        if found is not None:
            u, x, _ = found
            limit = mission.control_limit(agent)
            assert limit.measure(u).max() <= limit.most * (1 + ROUNDING)
            assert np.abs(x[-1, d:]).max() <= 1e-12 + ROUNDING * limit.most * mission.step
            assert half_spaces.violation(x, u).max(initial=0) <= 1e-5 * arguments[1].clearance
    moved = followed = 0
    for (context, agent, plan, horizon, _, others, clearance), found in improved:
        if found is None:
            continue
        mission, d, (u, path, steps) = context.mission, context.mission.axes, found
        x = horizon.discrete_model.simulate(context.state[agent], u)
        np.testing.assert_allclose(x[: steps + 1], plan.trajectory.x[: steps + 1], atol=1e-9)
        t, s = np.linspace(0, 1, 40)[:, None], 1 - np.linspace(0, 1, 40)[:, None]
        weights = np.hstack([s**3, 3 * s**2 * t, 3 * s * t**2, t**3])
        apart = np.linalg.norm(weights @ (path - others), axis=-1)
        assert (apart.min(axis=(1, 2)) >= clearance - ROUNDING).all()
        dense, reach = sample(x, u, mission.step), (mission.comm_radius - horizon.clearance) / 2
        assert np.linalg.norm(dense - x[0, :d], axis=1).max() <= reach * (1 + 2 * ROUNDING)
        moved, followed = moved + 1, followed + (steps > 0)
    assert followed >= 2
    assert moved - followed >= 5


def note_calls(monkeypatch, module, name):
    """Note the arguments and the answers of a function."""
    calls, function = [], getattr(module, name)

    def note(*arguments):
        calls.append((arguments, function(*arguments)))
        return calls[-1][1]

    monkeypatch.setattr(module, name, note)
    return calls


def test_agents_that_do_not_hear_each_other_cannot_meet_unasked(rng):
    # One decides now; the other keeps what it committed to some steps ago. Both go as far towards
    # each other as they may, and come no closer than R, in all time.
    least, T = np.inf, 12
    for _ in range(200):
        d, k = int(rng.integers(2, 4)), int(rng.integers(0, T))  # steps ago
        mission = crowd(d, 2)
        horizon, R = stopping_horizon(mission, T), mission.largest_separation
        (x, path), (y, later) = (random_reach(rng, mission, horizon) for _ in range(2))
        moving, later = path[k * horizon.pieces_per_step :] - x[k], later - y[0]
        # Turn the second against the first, and put it just out of hearing.
        far, other = (
            points[np.linalg.norm(points, axis=1).argmax()]
            for points in (moving.reshape(-1, d), later.reshape(-1, d))
        )
        assert np.linalg.norm(other) > 0
        if not np.linalg.norm(far):  # at rest by now
            continue
        turn, toward = reflection(other, -far), far / np.linalg.norm(far)
        gap = mission.comm_radius * (1 + 1e-12) * toward
        met = np.concatenate([later, np.tile(later[-1, -1], (len(path), 4, 1))])[: len(moving)]
        least = min(least, distance(gap + met @ turn.T - moving) / R)
    assert 1 - 1e-8 <= least < 1.5


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
    u, path, _ = found
    assert np.abs(path - paths[0]).max() > 1e-3
    assert hull_distance(path - paths[1])[0].min() >= kept * (1 - 1e-9)
    end = horizon.discrete_model.simulate(states[0], u)[-1]
    np.testing.assert_allclose(end[2:], 0, atol=1e-12)
