"""Errors of Method 1 of [Morgan2016], Remark 4, and Propositions 1 and 2, in numbers."""

from math import pi
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from morgan2016_auctions import (
    Reading,
    draw_case,
    draw_cases,
    excess,
    is_good,
    is_unique,
    rounds_over_bound,
    run_printed,
    run_reading,
)
from numpy import ndarray as Array

from sato.shapes.ordering import farthest_point_sampling

EPSILON = 0.01  # bid increment of the auctions
SHARES = (0.3, 0.5, 0.7, 0.9)  # m at the start over the number of agents, where it has to grow
LITERAL_SIZE = 40  # most agents of an auction that is run line by line
EXCESS_SHARE = 1.25  # m over the number of agents, where there are targets to spare
TARGETS = 10  # M of Remark 4


class Finding(NamedTuple):
    """Row of the table."""

    printed: str
    goes_wrong: str
    works: str


def judge_auctions(trials: int, share: float, ids: bool) -> tuple[int, int]:
    """Count the wrong auctions, and those of them that leave a target for sale."""
    wrong = for_sale = 0
    for case, count in draw_cases(trials, share, seed=1):
        outcome = run_printed(case, count, EPSILON, ids)
        if not is_good(case, outcome, count, EPSILON):
            wrong += 1
            for_sale += bool((outcome.prices < 0).any())
    return wrong, for_sale


def tied_bids(trials: int) -> Finding:
    """Count what ties after line 12 spoil."""
    total = len(SHARES) * trials
    (bare, for_sale), (numbered, _) = (
        np.sum([judge_auctions(trials, share, ids) for share in SHARES], axis=0)
        for ids in (False, True)
    )
    return Finding(
        "Line 8: a bid stands while no larger one is heard",
        f"m from {SHARES[0]:g} to {SHARES[-1]:g} N: {bare} of {total} auctions wrong. "
        "Line 12 leaves every holder the same slack: two bid the same number, and both win. "
        f"In {for_sale} a target stays for sale, and line 31 counts it as a bidder",
        f"bids carry the bidder's number, the smaller wins: {numbered} of {total} wrong",
    )


def one_target(trials: int) -> Finding:
    """Count the auctions that begin with a single target."""
    bare, numbered = (judge_auctions(trials, 0.0, ids)[0] for ids in (False, True))
    return Finding(
        "Line 16, m = 1: the least over no target",
        f"undefined; with w = v alone, {bare} of {trials} auctions wrong: all bid ε",
        f"w = v and numbers of bidders: {numbered} of {trials} wrong",
    )


def good_readings(trials: int, share: float, reading: Reading) -> tuple[int, int]:
    """Count the auctions in a reading that are right, and that end with unique targets."""
    found = [
        (is_good(case, outcome, count, EPSILON), is_unique(outcome))
        for case, count in draw_cases(trials, share, seed=2, largest=LITERAL_SIZE)
        for counts in [np.full(case.agents, count)]
        for outcome in [run_reading(case, counts, EPSILON, reading)]
    ]
    return tuple(np.sum(found, axis=0).tolist())


def merged_prices(trials: int) -> Finding:
    """Merge the first m prices alone, as line 27 has it."""
    wrong, unique = good_readings(trials, 0.7, Reading(merges_all_targets=False))
    right, _ = good_readings(trials, 0.7, Reading())
    return Finding(
        "Line 27: j = 1 … mⁱ",
        f"m from 0.7 N: {trials - wrong} of {trials} wrong, {trials - unique} with two agents on "
        "one target; an m that has grown does not reach the others",
        f"all prices that any neighbor sends: {trials - right} of {trials} wrong",
    )


def own_price(trials: int) -> Finding:
    """Leave the agent out of its own neighbors, as below (32)."""
    wrong, _ = good_readings(trials, 1.0, Reading(hears_itself=False))
    right, _ = good_readings(trials, 1.0, Reading())
    return Finding(
        "Line 28: s in N_i, with N_i = {j | j ≠ i} of Sec. IV",
        f"m = N: {trials - wrong} of {trials} wrong; an agent forgets its own bid",
        f"N_i contains i, as in (65): {trials - right} of {trials} wrong",
    )


def quiet_rounds(trials: int) -> Finding:
    """Stop after D quiet rounds in place of 2 D."""
    counts = [good_readings(trials, share, Reading(quiet_diameters=1))[0] for share in (0.7, 1.0)]
    total = 2 * trials
    right = sum(good_readings(trials, share, Reading())[0] for share in (0.7, 1.0))
    return Finding(
        "Line 7: 2 D, where D is known to nobody, and 0 for a lone agent",
        f"a D that is half of the true one: {total - sum(counts)} of {total} wrong; a lone agent "
        "never enters the loop, and j is undefined",
        f"2 D: {total - right} of {total} wrong; D from a census by messages, one round at least",
    )


def different_counts(trials: int) -> Finding:
    """Let agents begin with different m."""
    rng = np.random.default_rng(3)
    free, agreed = [], []
    for case, _ in draw_cases(trials, 1.2, seed=3, largest=LITERAL_SIZE):
        n = case.agents
        counts = rng.integers(max(1, round(0.7 * n)), round(1.2 * n) + 1, n)
        for found, is_agreed in ((free, False), (agreed, True)):
            outcome = run_reading(case, counts, EPSILON, Reading(agrees_on_count=is_agreed))
            found.append(is_good(case, outcome, int(counts.max()), EPSILON))
    return Finding(
        "Line 3: mⁱ of each agent, which may differ after networks meet",
        f"m from 0.7 to 1.2 N: {trials - sum(free)} of {trials} wrong, in cost or in m",
        f"the largest m is agreed on first: {trials - sum(agreed)} of {trials} wrong",
    )


def too_few_targets() -> Finding:
    """Bid with fewer targets than agents."""
    case = draw_case(12, 1, np.random.default_rng(4))
    few = case._replace(cost=case.cost[:, :11])
    outcome = run_printed(few, 11, EPSILON, ids=True)
    assert (outcome.target_counts < 0).all(), outcome
    return Finding(
        "Line 11: m without a limit; the text asks that M is large enough",
        "12 agents, 11 targets: m = 12, an index out of range",
        "the auction ends with an error that names the agent (`OutOfTargets`)",
    )


def remark_4() -> Finding:
    """Count the points that coincide in the example of Remark 4, and compare prefixes."""
    step = pi / TARGETS
    printed = np.r_[2 * step * np.arange(TARGETS + 1), step * np.arange(1, 2 * TARGETS)]
    meant = np.r_[2 * step * np.arange(TARGETS), step * np.arange(1, 2 * TARGETS, 2)]
    ours = 2 * pi / (2 * TARGETS) * np.arange(2 * TARGETS)
    order = farthest_point_sampling(_on_circle(ours), 2 * TARGETS)
    distinct = len(np.unique(np.round(np.exp(1j * printed), 9)))
    few = TARGETS // 2
    gaps = [_widest_gap(meant[:few]), _widest_gap(ours[order][:few])]
    return Finding(
        "Remark 4: θ = {0 : 2π/M : 2π, π/M : π/M : (2M−1)π/M}",
        f"M = {TARGETS}: {len(printed)} points, {distinct} distinct. With 2π/M for the second step "
        f"and without 2π all {len(meant)} are, but the first {few} leave a gap of {gaps[0]:.0f}°",
        f"farthest-point order keeps the shape: the first {few} leave a gap of {gaps[1]:.0f}°",
    )


def _on_circle(angle: Array) -> Float[Array, "points 2"]:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _widest_gap(angle: Array) -> float:
    ordered = np.sort(angle)
    return float(np.degrees(np.diff(np.r_[ordered, ordered[0] + 2 * pi]).max()))


def proposition_1(trials: int) -> Finding:
    """Compare rounds with the bound of Proposition 1."""

    def ratios(share: float, epsilon: float) -> Array:
        cases = draw_cases(trials, share, seed=5)
        return np.array(
            [rounds_over_bound(c, run_printed(c, m, epsilon, ids=True), epsilon) for c, m in cases]
        )

    fine, coarse, coarsest = ratios(0.3, EPSILON), ratios(0.3, 1.0), ratios(0.3, 3.0)
    enough = ratios(1.0, 3.0)
    return Finding(
        "Proposition 1: the last bid is within D (N − 1) ⌈range/ε⌉ rounds",
        f"m from 0.3 N, costs from 0 to about 1: at ε = 1 exceeded in {(coarse > 1).sum()} of "
        f"{trials}, at 3 in {(coarsest > 1).sum()}, up to {coarsest.max():.1f} times; rounds in "
        "which m grows are not counted",
        f"ε = 0.01: {fine.max():.2f} of the bound at most; m = N, ε = 3: {enough.max():.2f}",
    )


def proposition_2(trials: int) -> Finding:
    """Begin with the prices of an earlier auction, with targets to spare."""
    gaps: dict[bool, list[float]] = {True: [], False: []}
    for case, count in draw_cases(trials, EXCESS_SHARE, seed=6, largest=LITERAL_SIZE):
        rng = np.random.default_rng(count)
        counts = np.full(case.agents, count)
        before = case._replace(cost=rng.permutation(case.cost, axis=1))
        kept = -np.abs(run_reading(before, counts, EPSILON, Reading()).prices)  # for sale
        for is_warm in (True, False):
            found = run_reading(case, counts, EPSILON, Reading(), kept if is_warm else 0.0)
            gaps[is_warm].append(excess(case, found, count) / (case.agents * EPSILON))
    return Finding(
        "(25), (26): a sum over all m prices is one over the assigned",
        "true if no target that nobody holds has a price. m = 1.25 N, prices of another auction "
        f"kept: {np.sum(np.array(gaps[True]) > 1)} of {trials} beyond N ε, up to "
        f"{max(gaps[True]):.1f} N ε",
        f"prices from zero (line 4): {max(gaps[False]):.2f} N ε at most",
    )


def method_1(trials: int) -> list[Finding]:
    """Return all findings, of so many auctions each."""
    return [
        tied_bids(trials),
        one_target(trials),
        merged_prices(trials),
        own_price(trials),
        quiet_rounds(trials),
        different_counts(trials),
        too_few_targets(),
        remark_4(),
        proposition_1(trials),
        proposition_2(trials),
    ]
