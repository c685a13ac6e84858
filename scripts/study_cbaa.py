"""CBAA on many random connected graphs: python scripts/study_cbaa.py --instances 1000.

2 to 50 agents and as many points, uniform in a cube, in two kinds of scores: by distance,
1 / d², and at random, uniform in (0, 1). Graphs are a random tree and a share of all other
edges: 0, 5, 20, 50, 100 %. Every fourth auction is repeated with a message in five lost and
all others a round late, and has to end the same.
"""

import argparse
import sys
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import linear_sum_assignment

from sato.auctions import CbaaAuction, run_cbaa
from sato.network.graph import CommunicationGraph

EDGE_SHARES = (0.0, 0.05, 0.2, 0.5, 1.0)
SCORE_KINDS = ("1 / d²", "random")
SIZES = ((2, 10), (11, 20), (21, 35), (36, 50))


class CbaaTrial(NamedTuple):
    """Outcome of an auction."""

    agents: int
    edge_share: float
    score_kind: str
    passed: bool  # conflict-free, agreed, in time, at least half of the optimum, losses only delay
    ratio: float  # total score over the optimum
    distance_ratio: float  # total distance over the least; NaN for random scores
    rounds: int
    bound_ratio: float  # rounds of listening over n D
    fixed_rounds_ratio: float  # rounds of listening over 2 n
    seconds: float


def draw_graph(rng: np.random.Generator, agents: int, share: float) -> CommunicationGraph:
    """Draw a random tree and a share of all other edges."""
    order = rng.permutation(agents)
    hears = np.triu(rng.random((agents, agents)) < share, 1)
    for k in range(1, agents):
        hears[order[k], order[rng.integers(k)]] = True
    return CommunicationGraph(hears | hears.T, np.full(agents, True))


def run_trial(seed: int, number: int) -> CbaaTrial:
    """Run one auction and verify its guarantees."""
    rng = np.random.default_rng((seed, number))
    agents = int(rng.integers(2, 51))
    share, scores = (
        EDGE_SHARES[number % len(EDGE_SHARES)],
        SCORE_KINDS[number // len(EDGE_SHARES) % len(SCORE_KINDS)],
    )
    network = draw_graph(rng, agents, share)
    apart = rng.random((agents, 1, 3)) - rng.random((agents, 3))
    distance = np.linalg.norm(apart, axis=2)
    by_distance = 1 / (distance**2 + 1e-8)
    score = by_distance if scores == SCORE_KINDS[0] else rng.random((agents, agents)) + 1e-12

    begin = time.perf_counter()
    auction = run_cbaa(CbaaAuction(score, network))
    seconds = time.perf_counter() - begin

    best = score[linear_sum_assignment(score, maximize=True)].sum()
    ratio = score[np.arange(agents), auction.point].sum() / best
    way = distance[np.arange(agents), auction.point].sum()
    detour = way / distance[linear_sum_assignment(distance)].sum()
    listened, bound = auction.round_count - 1, agents * int(network.diameter[0])
    good = auction.is_conflict_free and auction.has_consensus and ratio >= 0.5 and listened <= bound
    if number % 4 == 0:
        rough = run_cbaa(CbaaAuction(score, network, rounds=20 * bound, loss=0.2, delay=1, rng=rng))
        good &= rough.has_consensus and np.array_equal(rough.point, auction.point)
    return CbaaTrial(
        agents,
        share,
        scores,
        bool(good),
        float(ratio),
        float(detour) if score is by_distance else np.nan,
        auction.round_count,
        listened / bound,
        listened / (2 * agents),
        seconds,
    )


def make_table(outcomes: list[CbaaTrial]) -> Table:
    """Tabulate by number of agents, by graph, by scores, and overall."""
    result = Table(title=f"CBAA, {len(outcomes)} connected graphs")
    heads = ("good", "score / optimum", "way / least", "rounds", "of n D", "of 2 n", "ms")
    hints = (
        "",
        "least, mean, median",
        "mean, most",
        "median, most",
        "median, most",
        "median, most",
        "median",
    )
    for head, hint in zip(("", *heads), ("", *hints), strict=True):
        result.add_column(f"{head}\n{hint}", justify="right")
    groups: list[Callable[[CbaaTrial], str]] = [
        lambda one: "n = {} … {}".format(*next(s for s in SIZES if s[0] <= one.agents <= s[1])),
        lambda one: f"tree + {100 * one.edge_share:g} %",
        lambda one: one.score_kind,
        lambda one: "all",
    ]
    for name in groups:
        rows: dict[str, list[CbaaTrial]] = {}
        for one in sorted(outcomes):
            rows.setdefault(name(one), []).append(one)
        for key, members in rows.items():
            result.add_row(key, *summary_cells(members))
        result.add_section()
    return result


def summary_cells(rows: list[CbaaTrial]) -> list[str]:
    """Format statistics of some auctions as table cells."""
    _, _, _, good, ratio, detour, rounds, of_bound, of_fixed, seconds = map(
        np.array, zip(*rows, strict=True)
    )
    flown = detour[np.isfinite(detour)]
    return [
        f"{good.sum()}/{len(rows)}",
        f"{ratio.min():.3f}  {ratio.mean():.3f}  {np.median(ratio):.3f}",
        f"{np.mean(flown):.3f}  {flown.max():.3f}" if len(flown) else "",
        f"{np.median(rounds):.0f}  {rounds.max()}",
        f"{np.median(of_bound):.3f}  {of_bound.max():.3f}",
        f"{np.median(of_fixed):.2f}  {of_fixed.max():.2f}",
        f"{1e3 * np.median(seconds):.2f}",
    ]


def main() -> int:
    """Run the study; return 1 if any auction violated a guarantee."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--instances", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()

    run_trial(options.seed, 0)  # compiles
    work = track(range(options.instances), "auctions", console=Console(stderr=True), transient=True)
    outcomes = [run_trial(options.seed, number) for number in work]
    Console(width=124).print(make_table(outcomes))
    broken = [n for n, one in enumerate(outcomes) if not one.passed]
    for n in broken:
        print(f"instance {n}: {outcomes[n]}", file=sys.stderr)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
