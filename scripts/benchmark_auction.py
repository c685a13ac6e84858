"""Time of the auction for large networks, beside SciPy's central assignment of the same costs.

Costs are uniform, distances and squared distances; networks are complete, or connect positions in
a unit square within the least radius from a mean degree of 8 on that connects all. ε is a share of
the range of the costs, and all agents know the number of targets at the start.
"""

import time
from typing import Annotated

import numpy as np
import typer
from numpy.random import Generator
from rich.console import Console
from rich.table import Table

from problems.assignment import solve_assignment
from sato.auctions import VsdaaAuction, run_vsdaa
from sato.network.graph import CommunicationGraph

SHARES = 1e-2, 1e-3  # ε of the range of the costs
MEAN_DEGREE = 8
WIDEN = 1.05  # factor of a radius that does not connect all


def draw_networks(position: np.ndarray) -> dict[str, CommunicationGraph]:
    """Return the complete network and the geometric one."""
    n = len(position)
    alive = np.ones(n, dtype=bool)
    radius = np.sqrt(MEAN_DEGREE / (np.pi * n))
    while (near := CommunicationGraph.from_positions(position, radius, alive)).component.any():
        radius *= WIDEN
    return {"complete": CommunicationGraph(~np.eye(n, dtype=bool), alive), "geometric": near}


def draw_costs(position: np.ndarray, rng: Generator) -> dict[str, np.ndarray]:
    """Return costs of all pairs, by their kind."""
    n = len(position)
    distance = np.linalg.norm(position[:, None] - rng.random((n, 2)), axis=2)
    return {"uniform": rng.random((n, n)), "distance": distance, "distance²": distance**2}


def hold_auction(cost: np.ndarray, network: CommunicationGraph, share: float) -> None:
    """Assign as many targets as there are agents, with ε a share of the range of the costs."""
    m = np.full(len(cost), len(cost))
    run_vsdaa(VsdaaAuction(cost, network, m, share * float(np.ptp(cost))))


def main(
    agents: Annotated[int, typer.Option(help="agents, and targets")] = 1000,
    instances: Annotated[int, typer.Option(help="of each row")] = 5,
) -> None:
    """Time all rows, and print the worst of each."""
    few = CommunicationGraph(~np.eye(3, dtype=bool), np.ones(3, dtype=bool))
    hold_auction(np.random.default_rng(0).random((3, 3)), few, SHARES[0])  # compiles
    found: dict[tuple[str, str, float], list[tuple[float, float]]] = {}
    for seed in range(instances):
        rng = np.random.default_rng(seed)
        position = rng.random((agents, 2))
        networks, costs = draw_networks(position), draw_costs(position, rng)
        for kind, cost in costs.items():
            begin = time.perf_counter()
            solve_assignment(cost)
            central = time.perf_counter() - begin
            for (name, network), share in ((one, e) for one in networks.items() for e in SHARES):
                begin = time.perf_counter()
                hold_auction(cost, network, share)
                row = found.setdefault((kind, name, share), [])
                row.append((time.perf_counter() - begin, central))
    table = Table("costs", "network", "ε", "auction, worst [s]", "SciPy, worst [s]")
    for (kind, name, share), seconds in found.items():
        worst = np.max(seconds, axis=0)
        table.add_row(kind, name, f"{share:g}", f"{worst[0]:.2f}", f"{worst[1]:.3f}")
    Console().print(table)


if __name__ == "__main__":
    typer.run(main)
