"""VSDAA on many connected swarms: python scripts/study_auction.py --instances 1000.

Random starts to random targets, and grids (ties of cost); m too small, right and too large;
bids of 1e-2 and 1e-3 of the range of the cost, and of ½ w s². The cost is that of
`sato run`: |Δx| + |Δy| + w d², with s the least spacing of the targets.
"""

import argparse
import sys
import time
from collections.abc import Callable
from itertools import cycle, islice, product
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial import cKDTree

from problems.assignment import solve_assignment
from sato.auctions import VsdaaAuction, run_vsdaa
from sato.network.graph import CommunicationGraph

SIZES = (5, 10, 20, 40, 60, 90, 123)
LAYOUTS = ("random", "grid")
TARGET_COUNT_FACTORS = (0.3, 1.0, 1.25)  # m at the start, over N
EPSILON_RULES = ("1e-2 range", "1e-3 range", "½ w s²")
TIE_BREAK = 0.2  # w [1/m]


class AuctionCase(NamedTuple):
    """Parameters of an instance."""

    agents: int
    layout: str
    target_count_factor: float
    epsilon_rule: str


class VsdaaTrial(NamedTuple):
    """Outcome of an auction."""

    passed: bool
    rounds: int
    bound_ratio: float  # round of the last bid over the bound of [Morgan2016, eq. 20]
    gap: float  # cost above the optimum, over N ε
    seconds: float


def draw_spaced_points(
    rng: np.random.Generator, count: int, apart: float, side: float
) -> np.ndarray:
    """Draw points in a square, and keep those that are far enough from all others."""
    points = np.empty((0, 2))
    while len(points) < count:
        point = rng.uniform(0, side, 2)
        if np.all(np.linalg.norm(points - point, axis=1) >= apart):
            points = np.vstack([points, point])
    return points


def draw_positions(
    rng: np.random.Generator, kind: str, agents: int, targets: int
) -> list[np.ndarray]:
    """Draw starts and targets."""
    if kind == "random":
        side = 1.6 * np.sqrt(targets)
        return [
            draw_spaced_points(rng, agents, 0.8, side),
            draw_spaced_points(rng, targets, 0.9, side),
        ]
    side = int(np.ceil(np.sqrt(targets)))
    grid = np.stack(np.divmod(np.arange(side**2), side), axis=1).astype(float)
    return [rng.permutation(grid)[:agents], rng.permutation(grid)[:targets]]


def connected_graph(position: np.ndarray) -> CommunicationGraph:
    """Return the connected graph of least radius, from about 7 neighbors per agent on."""
    side = np.ptp(position, axis=0).max() + 1.0
    radius, alive = side * np.sqrt(7 / np.pi / len(position)), np.full(len(position), True)
    while (
        network := CommunicationGraph.from_positions(position, radius, alive)
    ).component.max() > 0:
        radius *= 1.1
    return network


def run_trial(seed: int, number: int, kind: AuctionCase) -> VsdaaTrial:
    """Run one auction and verify its guarantees."""
    rng = np.random.default_rng((seed, number))
    agents, m = kind.agents, max(1, round(kind.target_count_factor * kind.agents))
    start, goal = draw_positions(rng, kind.layout, agents, max(agents, m) + max(10, agents // 4))
    move = goal - start[:, None]
    cost = np.abs(move).sum(axis=2) + TIE_BREAK * (move**2).sum(axis=2)
    spacing = cKDTree(goal).query(goal, k=2)[0][:, 1].min()
    epsilon = {
        "1e-2 range": 1e-2 * np.ptp(cost),
        "1e-3 range": 1e-3 * np.ptp(cost),
        "½ w s²": 0.5 * TIE_BREAK * spacing**2,
    }[kind.epsilon_rule]
    network, everyone, used = connected_graph(start), np.arange(agents), max(agents, m)

    begin = time.perf_counter()
    auction = run_vsdaa(VsdaaAuction(cost, network, np.full(agents, m), float(epsilon)))
    seconds = time.perf_counter() - begin

    best = cost[everyone, solve_assignment(cost[:, :used])].sum()
    gap = (cost[everyone, auction.target_index].sum() - best) / (agents * epsilon)
    steps = np.ceil(np.ptp(cost[:, :used], axis=1) / epsilon).max()
    bound = network.diameter[0] * (agents - 1) * steps
    good = len(set(auction.target_index)) == agents and np.all(auction.target_count == used)
    return VsdaaTrial(
        bool(good and -1e-9 <= gap <= 1 + 1e-9),
        auction.round_count,
        auction.last_bid_round / bound,
        gap,
        seconds,
    )


def summary_cells(rows: list[VsdaaTrial]) -> list[str]:
    """Format statistics of some auctions as table cells."""
    good, rounds, of_bound, gap, seconds = (np.array(column) for column in zip(*rows, strict=True))
    return [
        f"{good.sum()}/{len(rows)}",
        f"{np.median(rounds):.0f} / {rounds.max()}",
        f"{np.median(of_bound):.4f} / {of_bound.max():.4f}",
        f"{np.median(gap):.3f} / {gap.max():.3f}",
        f"{1e3 * np.median(seconds):.1f} / {1e3 * seconds.max():.1f}",
    ]


def make_table(kinds: list[AuctionCase], outcomes: list[VsdaaTrial]) -> Table:
    """Tabulate by size, by belief and bid, by geometry, and overall: median / worst."""
    result = Table(title=f"VSDAA, {len(kinds)} connected instances: median / worst")
    for column in ("", "good", "rounds", "last bid / Prop. 1", "gap / Nε", "ms"):
        result.add_column(column, justify="right")
    groups: list[Callable[[AuctionCase], str]] = [
        lambda kind: f"N = {kind.agents}",
        lambda kind: f"m = {kind.target_count_factor} N, ε = {kind.epsilon_rule}",
        lambda kind: kind.layout,
        lambda kind: "all",
    ]
    for name in groups:
        rows: dict[str, list[VsdaaTrial]] = {}
        for kind, outcome in zip(kinds, outcomes, strict=True):
            rows.setdefault(name(kind), []).append(outcome)
        for key, members in rows.items():
            result.add_row(key, *summary_cells(members))
        result.add_section()
    return result


def main() -> int:
    """Run the study; return 1 if any auction violated a guarantee."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--instances", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    kinds = [
        AuctionCase(*k)
        for k in islice(
            cycle(product(SIZES, LAYOUTS, TARGET_COUNT_FACTORS, EPSILON_RULES)), options.instances
        )
    ]
    run_trial(options.seed, 0, kinds[0])  # compiles
    work = track(kinds, "auctions", console=Console(stderr=True), transient=True)
    outcomes = [run_trial(options.seed, number, kind) for number, kind in enumerate(work)]
    Console(width=110).print(make_table(kinds, outcomes))
    broken = [n for n, outcome in enumerate(outcomes) if not outcome.passed]
    for n in broken:
        print(f"instance {n}, {kinds[n]}: {outcomes[n]}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
