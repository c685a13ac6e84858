"""Drifts after a loss of thrust: their motion, and half-spaces that keep them from others."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from dynamics import ClohessyWiltshire
from dynamics.discretize import discretize_zoh
from dynamics.trajectory_geometry import divide_pieces, evaluate_bezier
from problems.convexify import AvoidanceHorizon
from problems.drifts import DriftHorizon, Drifts
from problems.transfer import Trajectory

N, DT, STEPS, H, LATER = 0.001, 60.0, 6, 120.0, 30
MODEL = ClohessyWiltshire(N)
RATES = np.block([[np.zeros((3, 3)), np.eye(3)], [np.zeros((3, 6))]])
RATES[3, 0], RATES[3, 4], RATES[4, 3], RATES[5, 2] = 3 * N**2, 2 * N, -2 * N, -(N**2)


def make_horizon(distance=50.0, time=300.0, count=STEPS):
    plan, later = discretize_zoh(MODEL, DT, count), discretize_zoh(MODEL, H, LATER)

    def move(x, t, length):
        return x @ expm(RATES * length).T

    steps = AvoidanceHorizon(plan, plan, distance)
    return DriftHorizon(steps, later, move, time, LATER * H - 2 * DT, distance)


HORIZON = make_horizon()


def draw_plan(rng, like=None, size=1e-3):
    """States and controls from a start, that of another plan if given."""
    start = np.append(rng.uniform(-300, 300, 3), rng.normal(0, 0.3, 3)) if like is None else like
    u = rng.uniform(-size, size, (STEPS, 3))
    return HORIZON.steps.discrete_model.simulate(start, u), u


def test_parts_of_a_piece_lie_on_it():
    points = np.random.default_rng(1).normal(size=(5, 4, 3))
    shares = np.linspace(0, 1, 7)
    for part, own in enumerate(np.moveaxis(divide_pieces(points, 3), 1, 0)):
        for share in shares:
            there = evaluate_bezier(points, np.full(5, (part + share) / 3))
            assert np.allclose(evaluate_bezier(own, np.full(5, share)), there, atol=1e-12)


def test_drifts_are_free_motion_from_the_states_of_the_plan():
    x, u = draw_plan(np.random.default_rng(2))
    found = HORIZON.follow(x, u)
    for k, p, points in zip(HORIZON.step, HORIZON.piece, found.drifts, strict=True):
        for at, point in (
            (HORIZON.begins[p], points[0]),
            (HORIZON.begins[p] + HORIZON.lengths[p], points[3]),
        ):
            since = at - HORIZON.time - k * DT
            assert np.allclose(point, (expm(RATES * since) @ x[k])[:3], atol=1e-6)
    after = HORIZON.follow(x[-1:], u[:0]).path[:, 0]
    rest = [(expm(RATES * q * H) @ x[-1])[:3] for q in range(LATER)]
    assert np.allclose(found.path[STEPS:, 0], rest, atol=1e-6)
    assert np.allclose(after[0], x[-1, :3])


def test_drifts_last_as_long_as_asked_from_each_loss():
    for k in range(STEPS):
        pieces = HORIZON.piece[HORIZON.step == k]
        lost = HORIZON.time + k * DT
        ends = HORIZON.begins[pieces] + HORIZON.lengths[pieces]
        assert pieces[0] == k and (np.diff(pieces) == 1).all()
        assert lost + HORIZON.duration <= ends[-1] < lost + HORIZON.duration + H


def test_prediction_is_exact_for_a_linear_model():
    rng = np.random.default_rng(3)
    x, u = draw_plan(rng)
    other = draw_plan(rng, x[0])
    plans = Trajectory(x, u, 0.0), Trajectory(*other, 0.0)
    predicted = HORIZON.predict(HORIZON.follow(x, u), *plans)
    exact = HORIZON.follow(*other)
    assert np.allclose(predicted.drifts, exact.drifts, atol=1e-6)
    assert np.allclose(predicted.path[:STEPS], exact.path[:STEPS], atol=1e-6)


def least(relative):
    """Least distance of sampled pieces from the origin, of each."""
    shares = np.linspace(0, 1, 41)
    points = [evaluate_bezier(relative, np.full(len(relative), share)) for share in shares]
    return np.linalg.norm(points, axis=-1).min(axis=0)


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.sampled_from(["same", "opposite", "above", "below"]))
def test_plans_within_the_half_spaces_keep_their_distance(seed, side):
    rng = np.random.default_rng(seed)
    x, u = draw_plan(rng)
    own, others = HORIZON.follow(x, u), [HORIZON.follow(*draw_plan(rng)) for _ in range(4)]
    stacked = Drifts(*(np.stack(parts) for parts in zip(*others, strict=True)))
    above = rng.random(4) < 0.6
    met = HORIZON.find_encounters(own, stacked, above, 4.0)
    rows = HORIZON.constrain(own, stacked, met, Trajectory(x, u, 0.0), side)
    for size in (1e-5, 1e-4, 1e-3, 1e-2):
        plan = draw_plan(rng, x[0], size)
        kept = rows.violation(*plan) <= 0
        moved = HORIZON.follow(*plan)
        # Encounter by encounter, as each has rows of its own: 16, of its control points.
        is_kept = kept.reshape(-1, 16).all(axis=1)
        first = len(met[0].row)
        drifting = moved.drifts[met[0].row] - stacked.path[met[0].other, HORIZON.piece[met[0].row]]
        following = moved.path[HORIZON.piece[met[1].row]] - stacked.drifts[met[1]]
        for relative, safe in ((drifting, is_kept[:first]), (following, is_kept[first:])):
            assert (least(relative)[safe] >= HORIZON.distance).all()


def test_nominal_that_keeps_the_distance_satisfies_its_half_spaces():
    found = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        (x, u), other = draw_plan(rng), HORIZON.follow(*draw_plan(rng))
        own, others = HORIZON.follow(x, u), Drifts(*(part[None] for part in other))
        met = HORIZON.find_encounters(own, others, np.ones(1, dtype=bool), 4.0)
        if any(len(e.row) for e in HORIZON.find_encounters(own, others, np.ones(1, bool), 1.001)):
            continue
        found += sum(len(each.row) for each in met)
        rows = HORIZON.constrain(own, others, met, Trajectory(x, u, 0.0))
        assert rows.violation(x, u).max(initial=-1) <= 1e-9
    assert found > 50


def test_encounters_are_all_that_sampling_finds():
    for seed in range(30):
        rng = np.random.default_rng(seed)
        own, other = (HORIZON.follow(*draw_plan(rng)) for _ in range(2))
        others = Drifts(*(part[None] for part in other))
        drifting, following = HORIZON.find_encounters(own, others, np.ones(1, dtype=bool), 1.0)
        for found, relative, asked in (
            (drifting, own.drifts - other.path[HORIZON.piece], HORIZON.step > 0),
            (following, own.path[HORIZON.piece] - other.drifts, HORIZON.piece < STEPS),
        ):
            near = np.flatnonzero((least(relative) < HORIZON.distance) & asked)
            assert np.isin(near, found.row).all()


def test_those_below_count_from_now_on_and_after_their_plans():
    rng = np.random.default_rng(4)
    x, u = draw_plan(rng)
    own = HORIZON.follow(x, u)
    others = Drifts(own.path[None], own.drifts[None])  # at the same places at all times
    drifting, following = HORIZON.find_encounters(own, others, np.zeros(1, dtype=bool), 1.0)
    assert (HORIZON.piece[drifting.row] >= STEPS).all() and len(drifting.row)
    assert (HORIZON.step[following.row] == 0).all()
    assert (HORIZON.piece[following.row] < STEPS).all() and len(following.row)


@pytest.mark.parametrize("begin", [0.1, 61.7, 7140.3])
def test_instants_after_the_plan_are_the_same_whenever_it_is_made(begin):
    times = [begin + k * DT for k in range(STEPS)]
    late = [make_horizon(time=t, count=STEPS - k).begins[STEPS - k :] for k, t in enumerate(times)]
    assert np.ptp(late, axis=0).max() <= 1e-9
