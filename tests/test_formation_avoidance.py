"""Collision avoidance: the paper's sectors and their fault, and half-planes of velocities."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sato.formation import avoidance
from sato.formation.avoidance import avoid_collisions, limit_approach
from sato.formation.sectors import leave_sectors
from sato.formation.settings import CollisionAvoidance

KEEP_OUT, MAX_SPEED = 1.2, 0.5
OURS = CollisionAvoidance()
LEGACY = CollisionAvoidance(avoidance_range=1.5, legacy=True)
FAULTY = LEGACY._replace(unwrapped_angles=True)
SEEDS = st.integers(0, 2**32 - 1)
MANY = settings(max_examples=200)


def avoided(u, others, rules, v=(0.0, 0.0), velocities=0.0):
    """Return the velocity after avoidance, and whether it was changed."""
    w, others = np.array([*u, 0.1]), np.asarray(others, dtype=float)
    seen = np.hstack([others, np.broadcast_to(velocities, others.shape)])
    own = seen, len(seen), KEEP_OUT, rules
    if rules.legacy:
        changed = leave_sectors(w, *own, planes())
    else:
        changed = avoid_collisions(w, np.array(v, dtype=float), *own, MAX_SPEED, planes())
    return w[:2], bool(changed)


def planes():
    return np.zeros((50, 3))


def max_approach_speed(distance):
    return avoidance.max_approach_speed(distance, KEEP_OUT, OURS)


def limited(u, others, rules=OURS):
    v = np.array(u, dtype=float)
    limit_approach(v, others, len(others), KEEP_OUT, rules, planes())
    return v


def random_others(seed, most=8, nearest=0.9):
    """Draw a velocity, and relative positions of agents that are apart from each other."""
    rng = np.random.default_rng(seed)
    others = []
    for _ in range(rng.integers(1, 40)):
        there = rng.uniform(-3.5, 3.5, 2)
        far = [np.linalg.norm(there - other) > 1.0 for other in others]
        if np.linalg.norm(there) > nearest and all(far) and len(others) < most:
            others.append(there)
    return rng.uniform(-0.5, 0.5, 2), np.array(others).reshape(-1, 2)


def angle(u):
    return np.arctan2(u[1], u[0])


def wrapped(turn):
    return (turn + np.pi) % (2 * np.pi) - np.pi


def headed(degrees, speed=0.4):
    return speed * np.array([np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))])


def towards(other, half):
    """Position in that direction [°], so far that its sector has that half-angle [°]."""
    return headed(other, KEEP_OUT / np.sin(np.deg2rad(half)))


def bounds(others, least=-np.inf):
    """Directions in which the speed is bounded, and by what."""
    far = np.linalg.norm(others, axis=1)
    near = far < OURS.avoidance_range
    most = np.array([max(least, max_approach_speed(d)) for d in far[near]])
    return others[near] / far[near, None], most


def nearest_of_all(u, normals, most):
    """Find the closest point of an intersection of half-planes: u, on an edge, or a corner."""
    found = [u] + [u - (n @ u - b) * n for n, b in zip(normals, most, strict=True)]
    for i in range(len(most)):
        for j in range(i):
            pair = normals[[i, j]]
            if abs(np.linalg.det(pair)) > 1e-9:
                found.append(np.linalg.solve(pair, most[[i, j]]))
    good = [x for x in found if np.all(normals @ x <= most + 1e-9)]
    return min(good, key=lambda x: np.linalg.norm(x - u), default=None)


@MANY
@given(SEEDS)
def test_legacy_takes_the_closest_allowed_direction_or_stops(seed):
    u, others = random_others(seed)
    heading = np.linspace(-np.pi, np.pi, 20_001)
    forbidden = np.zeros(len(heading), dtype=bool)
    for other in others:
        far = np.linalg.norm(other)
        if far < LEGACY.avoidance_range:
            half = np.arcsin(min(1.0, KEEP_OUT / far))
            forbidden |= np.abs(wrapped(heading - angle(other))) < half
    least = np.abs(wrapped(heading[~forbidden] - angle(u))).min(initial=np.inf)
    assume(abs(least - np.pi / 2) > 1e-3)
    v, changed = avoided(u, others, LEGACY)
    assert changed == (least > 1e-3)
    if least > np.pi / 2:
        assert not v.any()
    else:
        assert np.linalg.norm(v) == pytest.approx(np.linalg.norm(u))
        assert abs(wrapped(angle(v) - angle(u))) == pytest.approx(least, abs=1e-3)


def test_unwrapped_angles_turn_to_the_wrong_side_or_stop_an_agent():
    u = headed(170)
    for other, half, right, faulty in ((160, 70, 230, headed(90)), (150, 75, 225, [0, 0])):
        others = [towards(other, half)]
        assert avoided(u, others, LEGACY)[0] == pytest.approx(headed(right))
        assert avoided(u, others, FAULTY)[0] == pytest.approx(faulty)
    # Turned by a half turn it is no fault any more.
    assert avoided(-u, -np.array(others), FAULTY)[0] == pytest.approx(-headed(225))


@given(SEEDS, st.floats(-np.pi, np.pi), st.sampled_from([OURS, LEGACY]))
def test_avoidance_rotates_with_the_surroundings(seed, yaw, rules):
    u, others = random_others(seed)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    v, changed = avoided(turn @ u, others @ turn.T, rules)
    plain, once = avoided(u, others, rules)
    assert changed == once
    assert v == pytest.approx(turn @ plain, abs=1e-9)


@pytest.mark.parametrize("gap", [0.01, 0.3, 1.5])
def test_two_agents_braking_from_the_allowed_speed_stop_at_keep_out(gap):
    allowed = max_approach_speed(KEEP_OUT + OURS.margin + gap)
    assert 2 * allowed**2 / (2 * OURS.braking) == pytest.approx(gap)


def test_closer_agents_must_separate_faster():
    least = KEEP_OUT + OURS.margin
    assert max_approach_speed(least) == pytest.approx(0, abs=1e-8)  # rounded in a square root
    assert max_approach_speed(least - 0.2) < max_approach_speed(least - 0.1) < 0


@MANY
@given(SEEDS)
def test_limited_velocity_is_the_projection_onto_the_half_planes(seed):
    u, others = random_others(seed)
    best = nearest_of_all(u, *bounds(others))
    if best is None:  # between two that are too close, it is enough to approach neither
        best = nearest_of_all(u, *bounds(others, least=0.0))
    assert limited(u, others) == pytest.approx(best, abs=1e-8)


@MANY
@given(SEEDS)
def test_no_agent_is_approached_too_fast_where_that_is_possible(seed):
    u, others = random_others(seed)
    normals, most = bounds(others)
    assume(nearest_of_all(u, normals, most) is not None)
    rng = np.random.default_rng(seed)
    flown, velocities = rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.5, 0.5, others.shape)
    v, changed = avoided(u, others, OURS, flown, velocities)
    assert np.all(normals @ v <= most + 1e-8)
    assert changed == (v.tolist() != u.tolist())


@given(SEEDS)
def test_between_agents_too_close_none_is_approached(seed):
    u, others = random_others(seed, most=12, nearest=0.3)
    v, _ = avoided(u, others * 0.5, OURS)
    normals, most = bounds(others * 0.5, least=0.0)
    assert np.all(normals @ v <= most + 1e-8)


def test_agents_out_of_range_change_nothing():
    far = np.array([[OURS.avoidance_range + 0.01, 0.0]])
    assert limited([0.3, 0.1], far).tolist() == [0.3, 0.1]
    assert avoided([0.3, 0.1], far, LEGACY) == (pytest.approx([0.3, 0.1]), False)


def least_distance(p, w, horizon):
    """Least distance of two within a time, one at p that is approached with a velocity w."""
    t = np.clip(p @ w / max(w @ w, 1e-300), 0.0, horizon)
    return np.linalg.norm(p - w * t)


def shared(p, v, other, horizon=8.0, radius=1.25):
    """Normal n and bound b of the velocities n·u ≤ b of one of two agents."""
    plane = np.zeros(3)
    avoidance._share_avoidance(np.array(v), np.array([*p, *other]), radius, horizon, plane)
    return plane[:2], plane[2]


@MANY
@given(SEEDS)
def test_two_that_share_the_avoidance_keep_clear_for_its_time(seed):
    rng = np.random.default_rng(seed)
    p, v, other = rng.uniform(-4, 4, 2), *rng.uniform(-0.5, 0.5, (2, 2))
    assume(np.linalg.norm(p) > 1.26)
    (n, b), (m, c) = shared(p, v, other), shared(-p, other, v)
    one, two = rng.uniform(-0.6, 0.6, (2, 2))
    one -= max(n @ one - b, 0.0) * n  # projected onto what each may fly
    two -= max(m @ two - c, 0.0) * m
    assert least_distance(p, one - two, 8.0) >= 1.25 - 1e-9
    # Each does no more than half: together they just pass.
    both = v - other - 2 * (n @ v - b) * n
    assert n == pytest.approx(-m) and least_distance(p, both, 8.0) == pytest.approx(1.25)


def passing(u, v, others, velocities, horizon):
    """Normals and bounds of all that a velocity has to keep: approach, passing, speed."""
    normals, most = bounds(others)
    shares = [shared(p, v, w, horizon) for p, w in zip(others, velocities, strict=True)]
    sides = angle(u) + 2 * np.pi * np.arange(8) / 8
    normals = [*normals, *(n for n, _ in shares), *np.stack([np.cos(sides), np.sin(sides)], axis=1)]
    most = [*most, *(b for _, b in shares), *[MAX_SPEED] * 8]
    kept = np.isfinite(most)
    return np.array(normals)[kept], np.array(most)[kept]


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_velocity_is_the_nearest_with_which_all_are_passed_for_longest(seed):
    u, others = random_others(seed, most=5)
    near = np.linalg.norm(others, axis=1) < OURS.avoidance_range
    assume(near.any())
    others, rng = others[near], np.random.default_rng(seed)
    v, velocities = rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.4, 0.4, others.shape)
    turned = np.array([[np.cos(0.2), np.sin(0.2)], [-np.sin(0.2), np.cos(0.2)]]) @ u
    normals, most = passing(u, v, others, velocities, OURS.horizon)
    expected = u if np.all(normals @ u <= most) else None
    for halved in range(4):
        if expected is None:
            own = passing(u, v, others, velocities, OURS.horizon / 2**halved)
            expected = nearest_of_all(turned, *own)
    if expected is None:
        expected = limited([0.0, 0.0], others)
    assert avoided(u, others, OURS, v, velocities)[0] == pytest.approx(expected, abs=1e-6)


def test_command_that_passes_all_others_is_flown():
    p, v, other = np.array([[2.5, 0.0]]), np.array([0.4, 0.0]), np.array([0.45, 0.0])
    assert avoided(v, p, OURS, v, other) == (pytest.approx(v), False)  # they fly ahead, and faster
    assert avoided(v, p, OURS, v, -other)[1]


def test_two_that_meet_head_on_turn_to_the_right_alike():
    p, v = np.array([[2.5, 0.0]]), np.array([0.4, 0.0])
    one, two = avoided(v, p, OURS, v, -v)[0], avoided(-v, -p, OURS, -v, v)[0]
    assert one == pytest.approx(-two) and one[1] < -0.02
    assert least_distance(p[0], one - two, OURS.horizon) >= KEEP_OUT


def test_agent_at_rest_too_close_to_another_separates():
    for other in ([1.0, 0.0], [-1.0, 0.0], [0.0, 1.0]):
        v, changed = avoided([0.0, 0.0], [other], OURS)
        assert changed and v == pytest.approx(max_approach_speed(1.0) * np.array(other))
