"""Targets given to the agents, and the central optimum, in place of an auction."""

import json

import numpy as np
import pytest
from graphs import random_graph
from reconfiguration_runs import make_mission, row

import sato
from problems.assignment import solve_assignment
from sato import InputError, Join, Leg, Loss, Points, Ring
from sato.auctions import OutOfTargets, VsdaaAuction, assign_centrally, run_vsdaa

START = row(5, 0.0)
TARGETS = np.roll(row(5, 6.0), 1, axis=0)
LOSS, JOIN = Loss("agents", agents=(1,), at_step=9), Join(1, [[0.0, -3.0]], 6)
NEAR = {"comm_radius": 20.0}


def test_central_is_the_optimum_in_each_component_and_bounds_the_auction(rng):
    for _ in range(30):
        agents = int(rng.integers(1, 9))
        graph, M = random_graph(rng, agents, 0.3, alive=0.9), int(rng.integers(agents, 14))
        cost, m = rng.uniform(0, 1, (agents, M)), rng.integers(1, M + 1, agents)
        auction = VsdaaAuction(cost, graph, m, 1e-3)
        found, theirs = assign_centrally(auction), run_vsdaa(auction)
        for c in range(graph.component.max() + 1):
            members = np.flatnonzero(graph.component == c)
            count = max(len(members), m[members].max())
            best = cost[np.ix_(members, range(count))]
            best = best[np.arange(len(members)), solve_assignment(best)].sum()
            total = cost[members, found.target_index[members]].sum()
            assert total == pytest.approx(best)
            assert total <= cost[members, theirs.target_index[members]].sum() + 1e-12
        for name in ("target_count", "bidder_count"):
            mine, other = getattr(found, name), getattr(theirs, name)
            np.testing.assert_array_equal(mine[graph.alive], other[graph.alive])
        assert (found.target_index[~graph.alive] == -1).all()


def test_central_needs_a_target_an_agent():
    graph = random_graph(np.random.default_rng(0), 3, 1.0)
    with pytest.raises(OutOfTargets):
        assign_centrally(VsdaaAuction(np.ones((3, 2)), graph, np.ones(3, dtype=int), 1e-3))


def test_given_targets_are_flown_to_by_their_own_agents():
    run = sato.run(
        make_mission(START, Leg(TARGETS, 40), assignment="given", foresight_steps=40, **NEAR)
    )
    held = run.data.target_index.values
    assert (held == np.arange(5)).all() and run.summary["reached"] and run.check().kept
    np.testing.assert_allclose(run.data.position[-1], TARGETS, atol=1e-4)
    assert run.summary["fuel_lower_bound_m_s"] <= run.summary["fuel_m_s"] * (1 + 1e-9)
    leg = run.summary["legs"][0]
    assert leg["holes"] == 0
    # The first flies 4 m along the row for nothing, and the others 1 m each.
    assert leg["assignment_m_s"] == pytest.approx(run.summary["fuel_lower_bound_m_s"])
    free = sato.run(make_mission(START, Leg(TARGETS, 40), assignment="central", **NEAR))
    best = free.summary["legs"][0]
    assert best["assignment_gap_m_s"] == pytest.approx(0, abs=1e-9)
    assert leg["assignment_gap_m_s"] == pytest.approx(
        leg["assignment_m_s"] - best["assignment_m_s"], rel=1e-6
    )
    assert leg["assignment_gap_m_s"] > 0.2


def test_lost_agents_leave_given_targets_empty_and_new_ones_have_their_own():
    targets = np.vstack([TARGETS, [[0.0, 9.0]]])
    mission = make_mission(
        START,
        Leg(targets, 40, losses=[LOSS], joins=[JOIN]),
        assignment="given",
        foresight_steps=40,
        **NEAR,
    )
    run = sato.run(mission)
    assert run.summary["reached"] and run.check().kept
    last = run.data.target_index[-1].values.tolist()
    assert last == [0, -1, 2, 3, 4, 5] and run.summary["legs"][0]["holes"] == 1
    # The others arrive in their own time, and the new one in as much.
    events = map(json.loads, run.data["event"].values.tolist())
    arrivals = [event["agents"] for event in events if event["kind"] == "arrival"]
    assert arrivals == [[0, 2, 3, 4], [5]]


def test_central_assignment_joins_components_that_do_not_hear_each_other():
    apart = np.array([[0.0, 0.0], [30.0, 0.0]])
    targets = np.array([[15.0, 0.0], [16.0, 12.0], [50.0, 0.0]])
    for assignment, duplicates in (("auction", 1), ("central", 0)):
        mission = make_mission(apart, Leg(targets, 80), assignment=assignment, comm_radius=4.0)
        held = next(sato.simulate(mission)).target_index
        assert 2 - len(set(held.tolist())) == duplicates


def test_central_assignment_with_losses_joins_and_prefixes_is_kept():
    legs = [Leg(Ring(spacing=2.0), 40, losses=[LOSS], joins=[JOIN]), Leg(Ring(spacing=3.0), 60)]
    run = sato.run(make_mission(START, *legs, assignment="central", comm_radius=4.0))
    assert run.summary["reached"] and run.check().kept


@pytest.mark.parametrize(
    ("leg", "message"),
    [
        (Leg(TARGETS[:4], 40), "leg.0.shape.positions_m: 4 targets are given to 5 agents"),
        (Leg(np.vstack([TARGETS, [[0, 9]]]), 40), "leg.0.shape.positions_m: 6 targets are given"),
        (Leg(Ring(spacing=2.0), 40, 6), "leg.0.targets: 6 targets are given to 5 agents"),
        (
            Leg(TARGETS, 40, joins=[JOIN]),
            "leg.0.shape.positions_m: 5 targets are",
        ),
        (Leg(Points(TARGETS), 40, choose="prefix"), "leg.0.choose: .prefix. reorders a list"),
        (Leg(Points(TARGETS, keep_order=True), 40, recount=True), "leg.0.recount: has no meaning"),
        (Leg(TARGETS, 4), "leg.0.steps: agent 0 can reach none of its targets in 4 steps"),
    ],
)
def test_targets_that_are_not_one_each_are_refused(leg, message):
    with pytest.raises(InputError, match=message):
        make_mission(START, leg, assignment="given", foresight_steps=40, **NEAR)
