"""Free choice among more targets than agents: python scripts/study_free_choice.py.

Connected swarms of 2 to 60 agents with up to 3 N targets, in a list of the user's own. The
targets that the first auction assigns are compared with the asymmetric optimum over all M
targets [Bertsekas1992]. Costs of fuel and distance are those of missions in motion, energy and
random costs are given to the auction as they are.
"""

import argparse
import sys
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from study_auction import TIE_BREAK, connected_graph, draw_spaced_points

import sato
from dynamics import discretize_zoh
from problems import auction_cost
from problems.assignment import solve_assignment
from problems.transfer import TransferProblem
from sato.auctions import VsdaaAuction, run_vsdaa
from sato.network.graph import CommunicationGraph

STEPS, LIMIT = 60, 1.0  # of 1 s, and of the acceleration [m/s²]: every target is within reach
MODEL = sato.DoubleIntegrator(2)

Auction = tuple[np.ndarray, np.ndarray, float]  # costs, targets assigned, ε


def fly(cost: str) -> Callable[[np.random.Generator, np.ndarray, np.ndarray], Auction]:
    """Return the first auction of a mission with this cost."""

    def assign(rng: np.random.Generator, start: np.ndarray, targets: np.ndarray) -> Auction:
        start = np.hstack([start, rng.normal(0, 0.3, start.shape)])
        leg, graph = sato.Leg(targets, STEPS), connected_graph(start[:, :2])
        way = np.linalg.norm(start[:, None, :2] - start[:, :2], axis=2)
        mission = sato.Reconfiguration(
            model=MODEL,
            start=start,
            legs=[leg],
            step=1.0,
            comm_radius=1.001 * way[graph.adjacency].max(initial=1.0),
            collision_radius=0.5,
            max_control=LIMIT,
            cost=cost,
            allow_undetectable=True,
        )
        held = next(sato.simulate(mission)).target_index
        goals = np.hstack([targets, np.zeros_like(targets)])
        steps = discretize_zoh(MODEL, 1.0, STEPS)
        distance = auction_cost.compute_distances(steps, start, goals)
        found = auction_cost.compute_transfer_costs(TransferProblem(steps, LIMIT), start, goals)
        scaled = STEPS / 2 * found.fuel if cost == "fuel" else distance
        spacing = np.linalg.norm(targets[:, None] - targets, axis=2)[
            ~np.eye(len(targets), dtype=bool)
        ]
        return scaled + TIE_BREAK * distance**2, held, TIE_BREAK / 2 * spacing.min() ** 2

    return assign


def bid(cost: np.ndarray, graph: CommunicationGraph) -> Auction:
    """Run an auction over given costs, with ε of 1e-3 of their range."""
    epsilon, count = 1e-3 * float(np.ptp(cost)), np.full(len(cost), cost.shape[1])
    return cost, run_vsdaa(VsdaaAuction(cost, graph, count, epsilon)).target_index, epsilon


def bid_energy(rng: np.random.Generator, start: np.ndarray, targets: np.ndarray) -> Auction:
    """Run an auction over the least control energies."""
    start = np.hstack([start, rng.normal(0, 0.3, start.shape)])
    goals = np.hstack([targets, np.zeros_like(targets)])
    steps = discretize_zoh(MODEL, 1.0, STEPS)
    energy = auction_cost.compute_energies(steps, start, goals)
    return bid(STEPS**3 / 12 * energy, connected_graph(start[:, :2]))


def bid_random(rng: np.random.Generator, start: np.ndarray, targets: np.ndarray) -> Auction:
    """Run an auction over costs without any geometry."""
    cost = rng.uniform(0, 1, (len(start), len(targets))) ** rng.uniform(0.3, 3)
    return bid(cost, connected_graph(start))


KINDS = {
    "fuel": fly("fuel"),
    "distance": fly("distance"),
    "energy": bid_energy,
    "random": bid_random,
}


def main() -> int:
    """Run the study; return 1 if any result is not unique or beyond N ε."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--instances", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rows: dict[str, list[tuple[bool, float]]] = {name: [] for name in KINDS}
    work = track(range(options.instances), "auctions", console=Console(stderr=True))
    for number in work:
        rng = np.random.default_rng((options.seed, number))
        agents = int(rng.integers(2, 61))
        count = int(rng.integers(agents, 3 * agents + 1))
        side = 1.6 * np.sqrt(count)
        start, targets = (draw_spaced_points(rng, k, 0.8, side) for k in (agents, count))
        name = list(KINDS)[number % len(KINDS)]
        cost, held, epsilon = KINDS[name](rng, start, targets)
        everyone = np.arange(agents)
        best = cost[everyone, solve_assignment(cost)].sum()
        gap = (cost[everyone, held].sum() - best) / (agents * epsilon)
        rows[name].append((len(set(held.tolist())) == agents, float(gap)))
    table = Table("cost", "instances", "unique", "over the optimum, in N ε: median", "worst")
    passed = True
    for name, found in rows.items():
        unique, gap = (np.array(column) for column in zip(*found, strict=True))
        passed &= bool(unique.all() and np.all((gap >= -1e-9) & (gap <= 1 + 1e-9)))
        cells = len(gap), unique.sum(), f"{np.median(gap):.4f}", f"{gap.max():.4f}"
        table.add_row(name, *map(str, cells))
    Console(width=110).print(table)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
