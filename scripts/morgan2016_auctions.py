"""Method 1 of [Morgan2016] in several readings, on random swarms, against the optimal assignment.

`run_vsdaa` of the toolkit is the printed method, without or with the numbers of bidders. All other
readings are `run_reading`, line by line; there the bid increments of the agents differ a little, so
that no tie of two bids disturbs the comparison.
"""

from collections.abc import Iterator
from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from sato.auctions.vsdaa import OutOfTargets, VsdaaAuction, run_vsdaa
from sato.network.graph import CommunicationGraph

MEAN_DEGREE = 7.0
MAX_ROUNDS = 20_000
SIZES = (10, 20, 40, 60, 90)  # numbers of agents, one after another


class Case(NamedTuple):
    """Agents, their costs and their network."""

    cost: Float[Array, "agents targets"]
    graph: CommunicationGraph

    @property
    def agents(self) -> int:
        """Number of agents."""
        return len(self.cost)


class Outcome(NamedTuple):
    """Outcome of an auction; no targets where it failed."""

    targets: Int[Array, " agents"]
    target_counts: Int[Array, " agents"]  # m of each agent
    last_bid_round: int = 0
    prices: Float[Array, " targets"] = np.zeros(0)  # negative: for sale again

    @classmethod
    def failed(cls, agents: int) -> "Outcome":
        """Return the outcome of an auction that did not end, or ran out of targets."""
        return cls(np.zeros(agents, dtype=int), np.full(agents, -1))


class Reading(NamedTuple):
    """Reading of Method 1, as it works where nothing is changed."""

    merges_all_targets: bool = True  # line 27; as printed only the first m of each agent
    hears_itself: bool = True  # line 28
    quiet_diameters: int = 2  # line 7: quiet rounds before an agent stops, over D
    agrees_on_count: bool = True  # on the largest m first


def draw_case(agents: int, target_count: int, rng: np.random.Generator) -> Case:
    """Draw a connected network in the unit square, and the distances to random targets."""
    radius = np.sqrt(MEAN_DEGREE / (np.pi * agents))
    targets = max(agents, target_count) + max(10, agents // 4)
    while True:
        position = rng.uniform(0, 1, (agents, 2))
        graph = CommunicationGraph.from_positions(position, radius, np.ones(agents, dtype=bool))
        if graph.component.max() == 0:
            break
    cost = np.linalg.norm(position[:, None] - rng.uniform(0, 1, (targets, 2)), axis=-1)
    return Case(cost, graph)


def draw_cases(
    trials: int, share: float, seed: int, largest: int = max(SIZES)
) -> Iterator[tuple[Case, int]]:
    """Draw cases of all sizes, with the m that agents begin with, a share of their number."""
    rng = np.random.default_rng(seed)
    sizes = [size for size in SIZES if size <= largest]
    for trial in range(trials):
        agents = sizes[trial % len(sizes)]
        count = max(1, round(share * agents))
        yield draw_case(agents, count, rng), count


def run_printed(case: Case, count: int, epsilon: float, ids: bool) -> Outcome:
    """Run the auction of the toolkit, without or with the numbers of bidders."""
    counts = np.full(case.agents, count)
    try:
        found = run_vsdaa(VsdaaAuction(case.cost, case.graph, counts, epsilon, bidder_ids=ids))
    except OutOfTargets:
        return Outcome.failed(case.agents)
    return Outcome(found.target_index, found.target_count, found.last_bid_round, found.price[0])


def run_reading(
    case: Case,
    counts: Int[Array, " agents"],
    epsilon: float,
    reading: Reading,
    prices: Float[Array, " targets"] | float = 0.0,
) -> Outcome:
    """Run Method 1 line by line in a reading, from prices that all know, negative as for sale."""
    n, targets = case.cost.shape
    increments = epsilon * (1 - np.arange(n) / (2 * n))
    quiet = reading.quiet_diameters * int(case.graph.diameter.max())
    m = np.full(n, counts.max()) if reading.agrees_on_count else counts.copy()
    p = np.zeros((n, targets)) + prices
    old, choice, count = np.full((n, targets), -1.0), np.full(n, -1), np.zeros(n, dtype=int)
    hears = [np.append(near, i) for i, near in enumerate(case.graph.neighbors)]
    if not reading.hears_itself:
        hears = list(case.graph.neighbors)
    last = 0
    for number in range(1, MAX_ROUNDS):
        running = np.flatnonzero(count < quiet)
        if not len(running):
            return Outcome(choice, m, last, p[0])
        for i in running:
            j = choice[i]
            if j < 0 or abs(p[i, j]) > old[i, j]:
                m[i] = max(m[i], np.count_nonzero(p[i]))
                if np.count_nonzero(p[i] > 0) >= m[i]:
                    m[i] = np.count_nonzero(p[i] > 0) + 1
                    if m[i] > targets:
                        return Outcome.failed(n)
                    p[i, : m[i]] = -(np.abs(p[i, : m[i]]) + increments[i])
                total = case.cost[i, : m[i]] + np.abs(p[i, : m[i]])
                j = choice[i] = int(np.argmin(total))
                second = np.partition(total, 1)[1] if m[i] > 1 else total[j]
                p[i, j] = abs(p[i, j]) + second - total[j] + increments[i]
                count[i], last = 0, number
            elif (p[i] != old[i]).any():
                m[i] = max(m[i], np.count_nonzero(p[i]))
                count[i] = 0
            else:
                count[i] += 1
        old[running] = p[running]
        merged = p.copy()
        for i in running:
            known = slice(None) if reading.merges_all_targets else slice(m[i])
            heard = p[hears[i], known]
            standing, sold = heard.max(axis=0), (-heard).max(axis=0)
            merged[i, known] = np.where(sold >= standing, -sold, standing)
        p = merged
    return Outcome.failed(n)


def is_unique(outcome: Outcome) -> bool:
    """Return True where no two agents hold one target."""
    return len(np.unique(outcome.targets)) == len(outcome.targets)


def excess(case: Case, outcome: Outcome, count: int) -> float:
    """Return the cost beyond the optimum over the first max(N, m) targets."""
    best = case.cost[:, : max(case.agents, count)]
    optimum = best[linear_sum_assignment(best)].sum()
    return float(case.cost[np.arange(case.agents), outcome.targets].sum() - optimum)


def is_good(case: Case, outcome: Outcome, count: int, epsilon: float) -> bool:
    """Return True for unique targets, within N ε of the optimum, and one m of all, max(N, m)."""
    is_agreed = (outcome.target_counts == max(case.agents, count)).all()
    is_near = excess(case, outcome, count) <= case.agents * epsilon + 1e-9
    return bool(is_agreed and is_unique(outcome) and is_near)


def rounds_over_bound(case: Case, outcome: Outcome, epsilon: float) -> float:
    """Return the last round in which an agent bid, over the bound of Proposition 1."""
    cost = case.cost[:, : case.agents]
    steps = max(ceil(spread / epsilon) for spread in np.ptp(cost, axis=1))
    return outcome.last_bid_round / (int(case.graph.diameter.max()) * (case.agents - 1) * steps)
