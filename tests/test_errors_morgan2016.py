"""Errors of [Morgan2016]: each reading of Method 1 and 2 fails, or works, as the page says."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

from morgan2016_auctions import (
    Reading,
    draw_cases,
    is_good,
    rounds_over_bound,
    run_printed,
    run_reading,
)
from morgan2016_trajectories import (
    MAX_ITERATIONS,
    RADIUS,
    Encounter,
    as_printed,
    draw_encounter,
    fly,
    with_tolerance,
)

EPSILON = 0.01


def wrong_auctions(reading, share, trials=6):
    """Count the auctions that a reading of Method 1 gets wrong."""
    wrong = 0
    for case, count in draw_cases(trials, share, seed=2, largest=20):
        outcome = run_reading(case, np.full(case.agents, count), EPSILON, reading)
        wrong += not is_good(case, outcome, count, EPSILON)
    return wrong


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0, 1.25])
def test_method_1_as_read_here_gives_all_their_own_target(share):
    assert wrong_auctions(Reading(), share) == 0


@pytest.mark.parametrize(
    ("reading", "share"),
    [(Reading(merges_all_targets=False), 0.7), (Reading(hears_itself=False), 1.0)],
    ids=["line 27", "line 28"],
)
def test_method_1_with_a_line_as_printed_fails_always(reading, share):
    assert wrong_auctions(reading, share) == 6


def test_half_the_diameter_is_too_little_patience():
    assert 0 < wrong_auctions(Reading(quiet_diameters=1), 1.0, 12)


def test_proposition_1_fails_for_coarse_increments_alone():
    for epsilon, expected in ((EPSILON, False), (3.0, True)):
        ratios = [
            rounds_over_bound(case, run_printed(case, count, epsilon, ids=True), epsilon)
            for case, count in draw_cases(8, 0.3, seed=5, largest=40)
        ]
        assert (max(ratios) > 1) == expected


def test_method_2_ends_with_a_tolerance_and_not_as_printed(rng):
    encounters = [draw_encounter(rng) for _ in range(6)]
    pairs = [(fly(each, with_tolerance), fly(each, as_printed)) for each in encounters]
    solved = [pair for pair in pairs if np.isfinite(pair[0].separation)]
    assert solved
    for ended, never in solved:
        assert ended.between < RADIUS - 1e-6 <= ended.separation
        assert ended.iterations < MAX_ITERATIONS == never.iterations


def test_vehicles_that_meet_head_on_pass_through_each_other():
    ends = np.array([[-3.0, 0], [3, 0]])
    assert fly(Encounter(ends, -ends), with_tolerance).between < 1e-6
