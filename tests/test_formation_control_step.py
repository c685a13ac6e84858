"""Control steps: frames, messages, limits, avoidance and wandering."""

from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import pdist, squareform

from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.formation.control_law import FormationData
from sato.formation.control_step import (
    FormationState,
    Roles,
    StepParameters,
    simulate_steps,
)
from sato.formation.sensing import compute_track_gains
from sato.formation.settings import CollisionAvoidance, ControlLaw, CoordinateFrames, FrameSettings
from sato.shapes.formation_library import random_sparse_graph
from sato.shapes.random_points import sample_formation, sample_positions

STEP, KEEP_OUT, MAX_SPEED = 0.02, 1.2, 0.5
RULES = CollisionAvoidance()


@cache
def gains(agents=8, share=0.7):
    rng = np.random.default_rng(agents)
    points = sample_formation(agents, (9.0, 9.0, 3.0), 2.0, rng)
    return design_gains(DesiredFormation(points, random_sparse_graph(points, share, rng)))


def frames(agents=8, offset=10.0, drift=0.01, seed=None):
    """Random frames; aligned ones without a seed."""
    if seed is None:
        zero = np.zeros((agents, 3))
        return CoordinateFrames(np.ones(agents, dtype=complex), zero, zero.copy())
    drawn = FrameSettings("random", offset, drift).draw(agents, np.random.default_rng(seed))
    return CoordinateFrames(np.exp(1j * drawn.yaw), np.array(drawn.offset), np.array(drawn.drift))


def swarm(frames, data=None, noise=0.0, every=1, delay=0, loss=0.0, **changes):
    """Constants of a swarm of eight without noise, loss and delay, but for the changes."""
    mission = {
        "coordinate_frames": frames,
        "control_law": ControlLaw(),
        "avoidance": RULES,
        "keep_out": KEEP_OUT,
        "max_speed": MAX_SPEED,
        "max_climb": 0.3,
        "max_acceleration": 0.5,
        "max_climb_acceleration": 0.8,
        "step": STEP,
        "frames": SimpleNamespace(noise=noise),
        "timed_link": SimpleNamespace(late=delay, loss_probability=loss),
    }
    formation = FormationData.from_gains(gains()) if data is None else data
    tracking = compute_track_gains(noise, 0.5, STEP)
    return StepParameters(SimpleNamespace(**mission | changes), formation, tracking, every)


def roles(agents=8, active=None, commanded=-1, velocity=(0.0, 0.0, 0.0)):
    points = np.arange(agents)
    active = np.full(agents, True) if active is None else active
    return Roles(points, np.tile(points, (agents, 1)), active, commanded, np.array(velocity))


def crowded(seed, agents=8, separation=1.5):
    rng = np.random.default_rng(seed)
    flat = sample_positions(agents, (7.0, 7.0), separation, rng)
    return np.column_stack([flat, rng.uniform(0, 3, agents)])


def step(state, held, parameters, number, rng):
    simulate_steps(state, held, held.find_neighbors(parameters), parameters, number, 1, rng)


def simulate(parameters, start, count, own_roles=None, seed=0):
    """Yield a copy of the state after every step."""
    delay, rng = parameters.mission.timed_link.late, np.random.default_rng(seed)
    state, held = FormationState.at_rest(start, delay), own_roles or roles(len(start))
    for number in range(count):
        step(state, held, parameters, number, rng)
        yield FormationState(*(array.copy() for array in state))


def separations(position):
    return squareform(pdist(position[:, :2])) + np.diag(np.full(len(position), np.inf))


@pytest.mark.parametrize("seed", range(5))
def test_motion_does_not_depend_on_the_coordinate_frames(seed):
    # Step by step from the same state: in a crowd, rounding errors grow.
    rng = np.random.default_rng(seed)
    aligned, turned = swarm(frames()), swarm(frames(offset=50.0, drift=0.0, seed=seed))
    rotation = turned.mission.coordinate_frames.rotation
    one, length = FormationState.at_rest(crowded(seed), 0), 0.0
    for number in range(300):
        other = FormationState(*(array.copy() for array in one))
        turn = np.conj(rotation)[:, None, None]  # of what each remembers in its own frame
        seen = turn * (one.tracks @ [[1, 0], [1j, 0], [0, 1], [0, 1j]])
        other.tracks[..., ::2], other.tracks[..., 1::2] = seen.real, seen.imag
        other.wander_direction[:] *= np.conj(rotation)
        step(one, roles(), aligned, number, rng)
        step(other, roles(), turned, number, rng)
        assert other.velocity == pytest.approx(one.velocity, abs=1e-10)
        assert np.array_equal(one.avoiding, other.avoiding)
        found, expected = (u.velocity_command[:, :2] @ [1, 1j] for u in (other, one))
        assert rotation * found == pytest.approx(expected, abs=1e-10)
        length += STEP * np.linalg.norm(one.velocity[:, :2], axis=1)
    assert length.min() > 0.5


def test_measured_position_is_the_true_one_with_drift_by_the_distance():
    own, position = frames(seed=3), crowded(3)
    drift, flown = np.zeros((8, 3)), np.zeros(8)
    for state in simulate(swarm(own), position, 200):
        found = state.measured_position - drift  # measured at the beginning of the step
        flat = own.rotation * (found[:, 0] + 1j * found[:, 1])
        seen = np.column_stack([flat.real, flat.imag, found[:, 2]]) + own.origin
        assert seen == pytest.approx(position, abs=1e-9)
        flown += np.linalg.norm(state.position - position, axis=1)
        position, drift = state.position, state.drift
        assert drift == pytest.approx(flown[:, None] * own.drift_rate, abs=1e-12)
    assert np.linalg.norm(own.drift_rate, axis=1) == pytest.approx(np.full(8, 0.01))
    assert flown.min() > 0.3


def test_measured_coordinates_have_the_standard_deviation_of_the_noise():
    hovering = roles(active=np.zeros(8, dtype=bool))
    start = crowded(0) * [10, 10, 1]  # too far apart to avoid each other
    noisy = swarm(frames(), noise=0.02)
    errors = [state.measured_position - start for state in simulate(noisy, start, 500, hovering)]
    assert np.std(errors) == pytest.approx(0.02, rel=0.03)
    assert np.abs(np.mean(errors, axis=0)).max() <= 5 * 0.02 / 500**0.5


@pytest.mark.parametrize("noise", [1e-3, 0.02, 0.5])
def test_track_gains_are_those_of_the_steady_kalman_filter(noise):
    A, H = np.array([[1.0, STEP], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    push = 0.5 * np.array([[STEP**2 / 2], [STEP]])
    P = solve_discrete_are(A.T, H.T, push @ push.T, np.array([[noise**2]]))
    gain = P @ H.T / (H @ P @ H.T + noise**2)
    alpha, beta = compute_track_gains(noise, 0.5, STEP)
    assert [alpha, beta / STEP] == pytest.approx(gain[:, 0], rel=1e-6)
    assert compute_track_gains(0.0, 0.5, STEP) == (1.0, 1.0)


@pytest.mark.parametrize(("noise", "most"), [(0.0, 1e-9), (0.02, 0.03)])
def test_tracks_follow_others_more_closely_than_measurements(noise, most):
    own_roles = roles(active=np.zeros(8, dtype=bool), commanded=2, velocity=(0.2, 0.1, 0.0))
    start, errors = np.column_stack([2.4 * np.arange(8), np.zeros(8), np.ones(8)]), []
    own = swarm(frames(seed=5, drift=0.0), noise=noise)
    states = list(simulate(own, start, 200, own_roles))
    turn = own.mission.coordinate_frames.rotation
    for before, state in pairwise(states[100:]):  # tracked before the last motion
        x, v = (part[:, 0] + 1j * part[:, 1] for part in (before.position, before.velocity))
        for i, j in np.argwhere(~np.isnan(state.tracks[..., 0])):
            track = turn[i] * (state.tracks[i, j] @ [[1, 0], [1j, 0], [0, 1], [0, 1j]])
            errors.append([abs(track[0] - (x[j] - x[i])), abs(track[1] - v[j])])
    assert len(errors) > 500 and np.sqrt(np.mean(np.square(errors), axis=0)).max() <= most


@pytest.mark.parametrize(("delay", "every"), [(0, 1), (3, 1), (2, 5)])
def test_messages_arrive_late_and_at_neighbors_alone(delay, every):
    graph, sent = gains().formation.graph, []
    delayed = swarm(frames(), every=every, delay=delay)
    for number, state in enumerate(simulate(delayed, crowded(1), 40)):
        if number % every == 0:
            sent.append(state.measured_position)
        assert np.isnan(state.heard(*np.nonzero(~graph))).all()
        if len(sent) <= delay:
            assert np.isnan(state.received_flat).all() and np.isnan(state.received_height).all()
        else:
            i, j = np.nonzero(graph)
            assert np.array_equal(state.heard(i, j), sent[-1 - delay][j])


def test_lost_message_leaves_the_last_one_received():
    i, j = np.nonzero(gains().formation.graph)
    sent, ages = [], []
    lossy = swarm(frames(), noise=0.01, loss=0.3)
    for state in simulate(lossy, crowded(1), 500):
        sent.append(state.measured_position)
        if len(sent) >= 12:  # no two of them are equal
            latest = np.array(sent[:-13:-1])[:, j]
            same = (latest == state.heard(i, j)).all(axis=-1)
            ages.append(same.argmax(axis=0)[same.any(axis=0)])
    share = np.bincount(np.concatenate(ages)) / (len(ages) * len(i))
    assert share[:4] == pytest.approx(0.7 * 0.3 ** np.arange(4), abs=0.01)
    assert share.sum() == pytest.approx(1, abs=1e-4)


def test_agents_hover_until_the_first_message_arrives():
    *before, after = simulate(swarm(frames(), delay=5), crowded(1) * [10, 10, 1], 6)
    assert not any(state.velocity.any() for state in before)
    assert np.linalg.norm(after.velocity, axis=1).min() > 0


def test_disturbance_spreads_one_hop_a_message():
    n = 12
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = np.column_stack([20 * np.cos(turn), 20 * np.sin(turn), np.arange(n) % 3])
    gap = np.abs(np.arange(n) - np.arange(n)[:, None])
    graph = np.isin(np.minimum(gap, n - gap), (1, 2))
    data = FormationData.from_gains(design_gains(DesiredFormation(ring, graph)))
    start = ring + np.random.default_rng(7).normal(0, 0.5, (n, 3))
    moved = start.copy()
    moved[0] += [0.3, -0.2, 0.1]  # still out of range of all others
    own = swarm(frames(n, seed=7), data)
    hops = shortest_path(graph, unweighted=True)[0]
    assert hops.max() == 3
    pairs = zip(simulate(own, start, 3), simulate(own, moved, 3), strict=True)
    for step, (one, other) in enumerate(pairs, start=1):
        touched = (one.velocity != other.velocity).any(axis=1)
        assert touched.tolist() == (hops <= step).tolist()
        far = hops > step
        assert np.array_equal(one.velocity_command[far], other.velocity_command[far])


def test_agents_that_are_no_neighbors_matter_within_range_alone():
    i, j = np.argwhere(~gains().formation.graph & ~np.eye(8, dtype=bool))[0]
    start = gains().formation.points * [20, 20, 1]  # all out of range of each other
    (alone,) = simulate(swarm(frames()), start, 1)
    ahead = alone.velocity_command[i] * [1, 1, 0]
    after = []
    for distance in (2.0, 3.1, 7.0):
        start[j] = start[i] + distance * ahead / np.linalg.norm(ahead)
        after += simulate(swarm(frames()), start, 1)
    near, far, farther = after
    assert [bool(state.avoiding[i]) for state in after] == [True, False, False]
    assert np.array_equal(far.velocity[i], farther.velocity[i])
    assert np.array_equal(far.velocity_command[i], near.velocity_command[i])


@pytest.mark.parametrize("separation", [1.5, 0.4])
def test_limits_of_speed_and_acceleration_hold_even_in_a_crowd(separation):
    limits = {"max_speed": 0.4, "max_climb": 0.2, "max_acceleration": 0.6, "noise": 0.02}
    crowd = swarm(frames(seed=2), **limits, max_climb_acceleration=0.7)
    start = crowded(2, separation=separation) * ([1, 1, 1] if separation > 1 else [0.5, 0.5, 1])
    velocity = np.array([np.zeros((8, 3)), *(s.velocity for s in simulate(crowd, start, 500))])
    change = np.diff(velocity, axis=0) / STEP
    assert np.linalg.norm(velocity[..., :2], axis=2).max() == pytest.approx(0.4)
    assert np.abs(velocity[..., 2]).max() <= 0.2 + 1e-12
    assert np.linalg.norm(change[..., :2], axis=2).max() <= 0.6 + 1e-9
    assert np.abs(change[..., 2]).max() <= 0.7 + 1e-9


def test_legacy_acceleration_is_limited_on_each_axis():
    legacy = swarm(frames(), avoidance=CollisionAvoidance(legacy=True))
    velocity = [np.zeros((8, 3)), *(state.velocity for state in simulate(legacy, crowded(2), 200))]
    change = np.diff(velocity, axis=0)[..., :2] / STEP
    assert np.abs(change).max() <= 0.5 + 1e-9
    assert np.linalg.norm(change, axis=2).max() == pytest.approx(2**0.5 * 0.5)


def towards(anchors):
    """Return formation data and roles of agents that fly to anchors, which hover."""
    n = len(anchors)
    none = np.zeros((2 * n, 1))
    neighbors = np.append(np.arange(n, 2 * n), np.full(n, -1))[:, None]
    data = FormationData(neighbors, (neighbors >= 0) + 0j, none, none, none, none)
    return data, roles(2 * n, active=np.arange(2 * n) < n)


def test_two_agents_that_meet_pass_on_the_right():
    ends = np.array([[0.0, 0, 1], [10, 0, 1]])
    anchors = np.array([[60.0, 0, 1], [-50, 0, 1]])
    data, own_roles = towards(anchors)
    met, length = False, np.zeros(2)
    for state in simulate(swarm(frames(4), data), np.concatenate([ends, anchors]), 2000, own_roles):
        one, other = state.position[:2, :2]
        length += STEP * np.linalg.norm(state.velocity[:2, :2], axis=1)
        if not met and one[0] >= other[0]:
            met = True
            assert one[1] < other[1]
        assert np.linalg.norm(one - other) >= KEEP_OUT
    assert met and np.linalg.norm(one - other) > 5
    assert length[0] == pytest.approx(length[1])  # both give way alike


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_agents_that_cross_from_all_sides_keep_out_to_5_cm(seed, noise):
    n, rng = 6, np.random.default_rng(seed)
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False) + rng.uniform(-0.1, 0.1, n)
    start = np.column_stack([6 * np.cos(turn), 6 * np.sin(turn), np.full(n, 1.0)])
    anchors = -start * [5, 5, -1]
    data, own_roles = towards(anchors)
    own = swarm(frames(2 * n, drift=0.0, seed=seed), data, noise=noise)
    least = np.full(2 * n, np.inf)
    for state in simulate(own, np.concatenate([start, anchors]), 2500, own_roles, seed):
        least = np.minimum(least, separations(state.position).min(axis=1))
    assert least[:n].max() < KEEP_OUT + 0.3  # each of them met another
    assert least.min() >= KEEP_OUT - (0.05 if noise else 0.0)
    assert np.linalg.norm(state.position[:n] - start, axis=1).min() > 4


def blocked_flight(blocked_time):
    """States of an agent that flies at a wall of three hovering ones."""
    start = np.array([[0.0, 0, 1], [3, 0, 1], [2.6, 1.6, 1], [2.6, -1.6, 1]])
    data, _ = towards(np.zeros((4, 3)))
    own_roles = roles(active=np.arange(8) == 0)
    own = swarm(frames(), data, avoidance=RULES._replace(blocked_time=blocked_time))
    places = np.concatenate([start, start + np.array([60.0, 0, 0])])
    return list(simulate(own, places, 1500, own_roles))


def test_blocked_agent_wanders_for_a_while_in_one_direction():
    states, slow = blocked_flight(RULES.blocked_time), 0.2 * MAX_SPEED
    blocked = np.array([state.blocked_time[0] for state in states])
    speed = np.array([np.linalg.norm(state.velocity[0, :2]) for state in states])
    begins = int(np.argmax(blocked < 0))
    waited, ends = round(RULES.blocked_time / STEP), begins + round(RULES.wander_time / STEP)
    assert (speed[begins - waited + 1 : begins + 1] < slow).all()
    assert speed[blocked < 0].max() > slow  # perhaps not the first time
    assert (blocked[begins : ends - 1] < 0).all() and blocked[ends] == 0
    # It flies in one direction, away from their middle, and keeps out of them.
    away = -np.sum(states[begins].position[1:4, :2] - states[begins].position[0, :2], axis=0)
    direction = states[begins].wander_direction[0]
    assert abs(np.angle(direction / complex(*away))) <= np.pi / 4 + 0.01
    assert len({state.wander_direction[0] for state in states[begins:ends]}) == 1
    assert min(separations(state.position[:4]).min() for state in states) >= KEEP_OUT


@pytest.mark.parametrize(("before", "times"), [(0, 1), (1, 2), (6, 7), (7, 8), (8, 8)])
def test_agent_that_is_blocked_again_wanders_for_longer(before, times):
    start = np.array([[0.0, 0, 1], [1.26, 0, 1], [0, 1.26, 1], [0, -1.26, 1]])
    data, _ = towards(np.zeros((4, 3)))
    state = FormationState.at_rest(np.concatenate([start, start + np.array([60.0, 0, 0])]), 0)
    state.avoiding[0], state.blocked_time[0] = True, RULES.blocked_time
    state.wander_count[0] = before
    own_roles, rng = roles(active=np.arange(8) == 0), np.random.default_rng(0)
    step(state, own_roles, swarm(frames(), data), 0, rng)
    assert state.blocked_time[0] == pytest.approx(-times * RULES.wander_time)
    state.begin_way(np.array([0]))
    assert state.blocked_time[0] == state.wander_count[0] == 0


def test_agent_that_never_wanders_stays_blocked():
    states = blocked_flight(np.inf)
    assert np.linalg.norm(states[-1].velocity[0]) < 0.01
    assert np.linalg.norm(states[-1].position[0] - states[-500].position[0]) < 0.05


def test_operator_commands_one_agent_in_its_own_frame_and_others_hover():
    own = frames(drift=0.0, seed=5)
    own_roles = roles(active=np.zeros(8, dtype=bool), commanded=2, velocity=(0.3, 0.1, 0.2))
    (*_, state) = simulate(swarm(own), crowded(5) * [10, 10, 1], 100, own_roles)
    expected = own.rotation[2] * (0.3 + 0.1j)
    assert state.velocity[2] == pytest.approx([expected.real, expected.imag, 0.2])
    assert not np.delete(state.velocity, 2, axis=0).any()
