"""Auctions on random connected networks, and what they guarantee."""

from time import perf_counter
from typing import Any

import numpy as np
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

import sato
from dynamics import discretize_zoh
from problems import auction_cost
from problems.assignment import solve_assignment
from problems.transfer import TransferProblem
from sato.auctions import CbaaAuction, VsdaaAuction, run_cbaa, run_vsdaa
from sato.network.graph import CommunicationGraph

TIE_BREAK = 0.2  # w [1/m]
ROUNDING = 1e-9  # of a gap
STEPS, LIMIT = 60, 1.0  # of 1 s, and of the acceleration [m/s²]: every target is within reach


def vsdaa(
    rng: np.random.Generator, agents: int, layout: str, target_count_factor: float, epsilon: str
) -> dict[str, Any]:
    """Assign targets at the cost of `sato run`, |Δx| + |Δy| + w d², as VSDAA does.

    Args:
        rng: Generator of starts and targets.
        agents: Number N of agents.
        layout: "random", or "grid", which has ties.
        target_count_factor: Number of targets that agents believe in at the start, over N.
        epsilon: Name of the least bid; s is the least spacing of the targets.
    """
    m = max(1, round(target_count_factor * agents))
    used = max(agents, m)
    start, goal = _draw_positions(rng, layout, agents, used + max(10, agents // 4))
    move = goal - start[:, None]
    cost = np.abs(move).sum(axis=2) + TIE_BREAK * (move**2).sum(axis=2)
    spacing = cKDTree(goal).query(goal, k=2)[0][:, 1].min()
    least_bid = float(
        {
            "1e-2 range": 1e-2 * np.ptp(cost),
            "1e-3 range": 1e-3 * np.ptp(cost),
            "w s²/2": 0.5 * TIE_BREAK * spacing**2,
        }[epsilon]
    )
    network = _connect(start)
    began = perf_counter()
    auction = run_vsdaa(VsdaaAuction(cost, network, np.full(agents, m), least_bid))
    seconds = perf_counter() - began
    steps = np.ceil(np.ptp(cost[:, :used], axis=1) / least_bid).max()
    bound = network.diameter[0] * (agents - 1) * steps  # [Morgan2016, eq. 20]
    cells = _judge(cost, auction.target_index, used, least_bid)
    return {
        "kept": cells["unique"] and cells["optimal"] and np.all(auction.target_count == used),
        "rounds": auction.round_count,
        "last_bid_over_bound": auction.last_bid_round / bound,
        "gap": cells["gap"],
        "auction_ms": 1e3 * seconds,
    }


def cbaa(rng: np.random.Generator, edge_share: float, score: str) -> dict[str, Any]:
    """Assign 2 to 50 points in a cube to as many agents, as CBAA does, and again with losses.

    Args:
        rng: Generator of points and graph.
        edge_share: Share of the edges beside those of a random tree.
        score: "distance", of 1/d², or "random".
    """
    agents = int(rng.integers(2, 51))
    network = _draw_graph(rng, agents, edge_share)
    apart = rng.random((agents, 1, 3)) - rng.random((agents, 3))
    distance = np.linalg.norm(apart, axis=2)
    is_random = score == "random"
    value = rng.random((agents, agents)) + 1e-12 if is_random else 1 / (distance**2 + 1e-8)
    auction = run_cbaa(CbaaAuction(value, network))
    held, listened = (np.arange(agents), auction.point), auction.round_count - 1
    bound = agents * int(network.diameter[0])
    ratio = value[held].sum() / value[linear_sum_assignment(value, maximize=True)].sum()
    # A message in five is lost, all others come a round late.
    rough = run_cbaa(CbaaAuction(value, network, rounds=20 * bound, loss=0.2, delay=1, rng=rng))
    detour = distance[held].sum() / distance[linear_sum_assignment(distance)].sum()
    return {
        "agents": agents,
        "kept": auction.is_conflict_free and auction.has_consensus and listened <= bound,
        "half_of_optimum": ratio >= 0.5,
        "same_with_losses": rough.has_consensus and np.array_equal(rough.point, auction.point),
        "score_over_optimum": ratio,
        "way_over_least": None if is_random else detour,
        "rounds": auction.round_count,
        "listened_over_bound": listened / bound,
        "listened_over_2n": listened / (2 * agents),
    }


def choose_freely(rng: np.random.Generator, cost: str) -> dict[str, Any]:
    """Assign up to 3 N targets in a list to N agents, and compare with the optimum over all.

    Args:
        rng: Generator of starts, targets and velocities.
        cost: "fuel" or "distance", of missions in motion; "energy", or "random" numbers.
    """
    agents = int(rng.integers(2, 61))
    count = int(rng.integers(agents, 3 * agents + 1))
    side = 1.6 * np.sqrt(count)
    start, targets = (_draw_spaced_points(rng, k, 0.8, side) for k in (agents, count))
    if cost == "random":
        values = rng.uniform(0, 1, (agents, count)) ** rng.uniform(0.3, 3)
        return _judge(values, *_bid(values, _connect(start)))
    graph, start = _connect(start), np.hstack([start, rng.normal(0, 0.3, start.shape)])
    goals, steps = (
        np.hstack([targets, 0 * targets]),
        discretize_zoh(sato.DoubleIntegrator(2), 1.0, STEPS),
    )
    if cost == "energy":
        values = STEPS**3 / 12 * auction_cost.compute_energies(steps, start, goals)
        return _judge(values, *_bid(values, graph))
    values = distance = auction_cost.compute_distances(steps, start, goals)
    if cost == "fuel":
        transfer = TransferProblem(steps, LIMIT)
        values = STEPS / 2 * auction_cost.compute_transfer_costs(transfer, start, goals).cost
    least_bid = TIE_BREAK / 2 * cKDTree(targets).query(targets, k=2)[0][:, 1].min() ** 2
    held = _first_assignment(start, targets, graph, cost)
    return _judge(values + TIE_BREAK * distance**2, held, count, least_bid)


def _first_assignment(start: Array, targets: Array, graph: CommunicationGraph, cost: str) -> Array:
    way = np.linalg.norm(start[:, None, :2] - start[:, :2], axis=2)
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        start=start,
        legs=[sato.Leg(targets, STEPS)],
        step=1.0,
        comm_radius=1.001 * way[graph.adjacency].max(initial=1.0),
        collision_radius=0.5,
        max_control=LIMIT,
        cost=cost,
        allow_undetectable=True,
    )
    return next(sato.simulate(mission)).target_index


def _bid(cost: Array, graph: CommunicationGraph) -> tuple[Array, int, float]:
    """Run an auction with ε of 1e-3 of the range of the costs; return targets, count and ε."""
    count, least_bid = cost.shape[1], 1e-3 * float(np.ptp(cost))
    auction = VsdaaAuction(cost, graph, np.full(len(cost), count), least_bid)
    return run_vsdaa(auction).target_index, count, least_bid


def _judge(cost: Array, held: Array, count: int, least_bid: float) -> dict[str, Any]:
    """Compare with the optimum over the first `count` targets: the gap in units of N ε."""
    everyone = np.arange(len(cost))
    best = cost[everyone, solve_assignment(cost[:, :count])].sum()
    gap = (cost[everyone, held].sum() - best) / (len(cost) * least_bid)
    is_optimal = -ROUNDING <= gap <= 1 + ROUNDING
    return {"unique": len(set(held.tolist())) == len(cost), "optimal": is_optimal, "gap": gap}


def _draw_spaced_points(rng: np.random.Generator, count: int, apart: float, side: float) -> Array:
    """Draw points in a square, and keep those that are far enough from all others."""
    points = np.empty((0, 2))
    while len(points) < count:
        point = rng.uniform(0, side, 2)
        if np.all(np.linalg.norm(points - point, axis=1) >= apart):
            points = np.vstack([points, point])
    return points


def _draw_positions(
    rng: np.random.Generator, layout: str, agents: int, targets: int
) -> tuple[Array, Array]:
    if layout == "random":
        side = 1.6 * np.sqrt(targets)
        start = _draw_spaced_points(rng, agents, 0.8, side)
        return start, _draw_spaced_points(rng, targets, 0.9, side)
    width = int(np.ceil(np.sqrt(targets)))
    grid = np.stack(np.divmod(np.arange(width**2), width), axis=1).astype(float)
    return rng.permutation(grid)[:agents], rng.permutation(grid)[:targets]


def _connect(position: Array) -> CommunicationGraph:
    """Return the connected graph of least radius, from about 7 neighbors per agent on."""
    side = np.ptp(position, axis=0).max() + 1.0
    radius, alive = side * np.sqrt(7 / np.pi / len(position)), np.full(len(position), True)
    while (graph := CommunicationGraph.from_positions(position, radius, alive)).component.max() > 0:
        radius *= 1.1
    return graph


def _draw_graph(rng: np.random.Generator, agents: int, share: float) -> CommunicationGraph:
    """Draw a random tree and a share of all other edges."""
    order = rng.permutation(agents)
    hears = np.triu(rng.random((agents, agents)) < share, 1)
    for k in range(1, agents):
        hears[order[k], order[rng.integers(k)]] = True
    return CommunicationGraph(hears | hears.T, np.full(agents, True))
