"""Frames, messages, limits and encounters: what a vehicle has to go on, and what it then does."""

from functools import cache

import numpy as np
import pytest
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import pdist, squareform

from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.formation.avoidance import CollisionAvoidance
from sato.formation.control_law import ControlLaw
from sato.formation.kernel import (
    FormationData,
    FormationLimits,
    FormationState,
    KernelParameters,
    Roles,
    Timing,
    simulate_steps,
)
from sato.formation.mission import aligned_frames, draw_frames
from sato.shapes.graphs import random_sparse_graph
from sato.shapes.random_points import sample_formation, sample_positions

STEP = 0.02
RULES = CollisionAvoidance()
LIMITS = FormationLimits()


@cache
def gains(agents=8, share=0.7):
    rng = np.random.default_rng(agents)
    points = sample_formation(agents, (9.0, 9.0, 3.0), 2.0, rng)
    return design_gains(DesiredFormation(points, random_sparse_graph(points, share, rng)))


def told(gains):
    """What every vehicle was told of a shape."""
    shape = gains.formation
    n, degree = len(shape.points), shape.graph.sum(axis=1)
    neighbours = np.full((n, degree.max()), -1)
    for i, row in enumerate(shape.graph):
        neighbours[i, : degree[i]] = np.flatnonzero(row)
    weight = shape.graph / np.maximum(degree, degree[:, None])
    return FormationData(gains.xy, gains.z, shape.points, neighbours, weight)


def swarm(frames, formed=None, rules=RULES, limits=LIMITS, every=1, late=0, loss=0.0):
    pace = Timing(STEP, every, late, loss)
    return KernelParameters(formed or told(gains()), frames, ControlLaw(), rules, limits, pace)


def roles(agents=8, follows=None, pushed=-1, push=(0.0, 0.0, 0.0)):
    point = np.arange(agents)
    follows = np.full(agents, True) if follows is None else follows
    return Roles(point, np.tile(point, (agents, 1)), follows, pushed, np.array(push))


def crowded(seed, agents=8, apart=1.5):
    rng = np.random.default_rng(seed)
    flat = sample_positions(agents, (7.0, 7.0), apart, rng)
    return np.column_stack([flat, rng.uniform(0, 3, agents)])


def steps(flock, start, count, who=None, seed=0):
    """The states after every step; each is a copy."""
    state, rng = FormationState.at_rest(start, flock.timing.late), np.random.default_rng(seed)
    for number in range(count):
        simulate_steps(state, who or roles(len(start)), flock, number, 1, rng)
        yield FormationState(*(array.copy() for array in state))


@pytest.mark.parametrize("seed", range(5))
def test_however_frames_are_turned_and_shifted_the_same_happens_in_the_world(seed):
    # Step by step from the same places: in a crowd, rounding grows.
    rng = np.random.default_rng(seed)
    anyhow = swarm(draw_frames(8, 50.0, 0.0, 0.0, rng))
    one = FormationState.at_rest(crowded(seed), 0)
    for number in range(300):
        other = FormationState(*(array.copy() for array in one))
        simulate_steps(one, roles(), swarm(aligned_frames(8)), number, 1, rng)
        simulate_steps(other, roles(), anyhow, number, 1, rng)
        assert other.velocity == pytest.approx(one.velocity, abs=1e-10)
        assert np.array_equal(one.avoiding, other.avoiding)
        flat = anyhow.coordinate_frames.rotation * (
            other.velocity_command[:, 0] + 1j * other.velocity_command[:, 1]
        )
        assert flat == pytest.approx(
            one.velocity_command[:, 0] + 1j * one.velocity_command[:, 1], abs=1e-10
        )
    assert one.path_length.min() > 0.5


def test_reckoning_drifts_by_its_share_of_the_distance_flown():
    frames = draw_frames(8, 10.0, 0.01, 0.0, np.random.default_rng(3))
    start = crowded(3)
    before, flown = start, np.zeros(8)
    for state in steps(swarm(frames), start, 200):
        flown += np.linalg.norm(state.position - before, axis=1)
        before = state.position
    assert np.linalg.norm(frames.drift_rate, axis=1) == pytest.approx(np.full(8, 0.01))
    assert state.drift == pytest.approx(flown[:, None] * frames.drift_rate, abs=1e-12)
    assert flown.min() > 0.3


def test_a_vehicle_reckons_where_it_is_in_its_own_axes_as_far_as_it_has_not_drifted():
    frames = draw_frames(8, 10.0, 0.01, 0.0, np.random.default_rng(4))
    position, drifted = crowded(4), np.zeros((8, 3))
    for state in steps(swarm(frames), position, 100):
        own = state.measured_position - drifted  # it looks at the beginning of a step
        flat = frames.rotation * (own[:, 0] + 1j * own[:, 1])
        seen = np.column_stack([flat.real, flat.imag, own[:, 2]]) + frames.origin
        assert seen == pytest.approx(position, abs=1e-9)
        position, drifted = state.position, state.drift


def test_every_measured_coordinate_is_off_by_as_much_noise_as_is_said():
    frames = aligned_frames(8, noise=0.02)
    resting = roles(follows=np.zeros(8, dtype=bool))
    apart = crowded(0) * [10, 10, 1]  # nobody has to avoid anybody
    errors = [
        state.measured_position - apart for state in steps(swarm(frames), apart, 500, resting)
    ]
    assert np.std(errors) == pytest.approx(0.02, rel=0.03)
    assert np.abs(np.mean(errors, axis=0)).max() <= 5 * 0.02 / 500**0.5


@pytest.mark.parametrize(("late", "every"), [(0, 1), (3, 1), (2, 5)])
def test_a_message_comes_so_many_messages_late_and_to_neighbours_alone(late, every):
    graph, sent = gains().formation.graph, []
    for number, state in enumerate(
        steps(swarm(aligned_frames(8), every=every, late=late), crowded(1), 40)
    ):
        if number % every == 0:
            sent.append(state.measured_position)
        heard = state.received
        assert np.isnan(heard[~graph]).all()
        if len(sent) <= late:
            assert np.isnan(heard).all()
        else:
            for i, j in np.argwhere(graph):
                assert np.array_equal(heard[i, j], sent[-1 - late][j])


def test_where_a_message_is_lost_the_last_one_that_was_heard_stays():
    i, j = np.nonzero(gains().formation.graph)
    sent, ages = [], []
    for state in steps(swarm(aligned_frames(8, noise=0.01), loss=0.3), crowded(1), 500):
        sent.append(state.measured_position)
        if len(sent) >= 12:  # no two of them are alike
            latest = np.array(sent[:-13:-1])[:, j]
            same = (latest == state.received[i, j]).all(axis=-1)
            ages.append(same.argmax(axis=0)[same.any(axis=0)])
    share = np.bincount(np.concatenate(ages)) / (len(ages) * len(i))
    assert share[:4] == pytest.approx(0.7 * 0.3 ** np.arange(4), abs=0.01)
    assert share.sum() == pytest.approx(1, abs=1e-4)


def test_before_anything_is_heard_nobody_moves():
    for state in steps(swarm(aligned_frames(8), late=5), crowded(1) * [10, 10, 1], 5):
        assert not state.velocity.any()
    (*_, state) = steps(swarm(aligned_frames(8), late=5), crowded(1) * [10, 10, 1], 6)
    assert np.linalg.norm(state.velocity, axis=1).min() > 0


def test_what_happens_to_one_reaches_others_by_messages_alone():
    n = 12
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False)
    ring = np.column_stack([20 * np.cos(turn), 20 * np.sin(turn), np.arange(n) % 3])
    gap = np.abs(np.arange(n) - np.arange(n)[:, None])
    graph = np.isin(np.minimum(gap, n - gap), (1, 2))
    formed = told(design_gains(DesiredFormation(ring, graph)))
    rng = np.random.default_rng(7)
    start = ring + rng.normal(0, 0.5, (n, 3))
    moved = start.copy()
    moved[0] += [0.3, -0.2, 0.1]  # still nobody is near anybody
    flock = swarm(draw_frames(n, 10.0, 0.01, 0.0, rng), formed)
    hops = shortest_path(graph, unweighted=True)[0]
    assert hops.max() == 3
    pairs = zip(steps(flock, start, 3), steps(flock, moved, 3), strict=True)
    for step, (one, other) in enumerate(pairs, start=1):
        touched = (one.velocity != other.velocity).any(axis=1)
        assert touched.tolist() == (hops <= step).tolist()
        assert np.array_equal(
            one.velocity_command[hops > step], other.velocity_command[hops > step]
        )


def test_who_is_no_neighbour_matters_where_it_is_noticed_alone():
    i, j = np.argwhere(~gains().formation.graph & ~np.eye(8, dtype=bool))[0]
    start = gains().formation.points * [20, 20, 1]  # nobody is near anybody
    (alone,) = steps(swarm(aligned_frames(8)), start, 1)
    ahead = alone.velocity_command[i] * [1, 1, 0]
    ahead /= np.linalg.norm(ahead)
    after = {}
    for away in (2.0, 3.1, 7.0):
        close = start.copy()
        close[j] = start[i] + away * ahead
        (after[away],) = steps(swarm(aligned_frames(8)), close, 1)
    assert [bool(state.avoiding[i]) for state in after.values()] == [True, False, False]
    assert np.array_equal(after[3.1].velocity[i], after[7.0].velocity[i])
    assert np.array_equal(after[3.1].command[i], after[2.0].command[i])


@pytest.mark.parametrize("apart", [1.5, 0.4])
def test_limits_of_speed_and_acceleration_are_kept_also_among_who_are_too_near(apart):
    limits = FormationLimits(speed=0.4, climb=0.2, acceleration=0.6, climb_acceleration=0.7)
    start = crowded(2, apart=apart) * ([1, 1, 1] if apart > 1 else [0.5, 0.5, 1])
    frames = draw_frames(8, 10.0, 0.01, 0.02, np.random.default_rng(2))
    before, fastest = np.zeros((8, 3)), 0.0
    for state in steps(swarm(frames, limits=limits), start, 500):
        change = (state.velocity - before) / STEP
        before = state.velocity
        fastest = max(fastest, np.linalg.norm(before[:, :2], axis=1).max())
        assert np.linalg.norm(change[:, :2], axis=1).max() <= limits.acceleration + 1e-9
        assert np.abs(change[:, 2]).max() <= limits.climb_acceleration + 1e-9
        assert np.abs(before[:, 2]).max() <= limits.climb + 1e-12
    assert fastest == pytest.approx(limits.speed)


def test_printed_each_axis_has_its_limit_of_acceleration():
    limits = FormationLimits(per_axis=True)
    before, most = np.zeros((8, 3)), 0.0
    flock = swarm(aligned_frames(8), rules=CollisionAvoidance(legacy=True), limits=limits)
    for state in steps(flock, crowded(2), 200):
        change = (state.velocity - before)[:, :2] / STEP
        before, most = state.velocity, max(most, np.linalg.norm(change, axis=1).max())
        assert np.abs(change).max() <= limits.acceleration + 1e-9
    assert most == pytest.approx(2**0.5 * limits.acceleration)


def bound_for(anchors):
    """Movers that fly to anchors, who are vehicles too and hover; and who follows."""
    n = len(anchors)
    xy, z = np.zeros((2 * n, 2 * n), dtype=complex), np.zeros((2 * n, 2 * n))
    xy[np.arange(n), np.arange(n, 2 * n)] = 1.0
    neighbours = np.full((2 * n, 1), -1)
    neighbours[:n, 0] = np.arange(n, 2 * n)
    formed = FormationData(xy, z, np.zeros((2 * n, 3)), neighbours, np.zeros((2 * n, 2 * n)))
    return formed, roles(2 * n, follows=np.arange(2 * n) < n)


def test_two_who_meet_pass_each_other_on_the_right():
    ends = np.array([[0.0, 0, 1], [10, 0, 1]])
    anchors = np.array([[60.0, 0, 1], [-50, 0, 1]])
    formed, who = bound_for(anchors)
    flock = swarm(aligned_frames(4), formed)
    met = False
    for state in steps(flock, np.concatenate([ends, anchors]), 2000, who):
        one, other = state.position[:2, :2]
        if not met and one[0] >= other[0]:
            met = True
            assert one[1] < other[1]
        assert np.linalg.norm(one - other) >= RULES.keep_out
    assert met and np.linalg.norm(one - other) > 5
    assert state.path_length[:2] == pytest.approx(
        np.full(2, state.path_length[0])
    )  # both give way alike


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_who_fly_through_each_other_from_all_sides_keep_out_to_5_cm(seed, noise):
    n, rng = 6, np.random.default_rng(seed)
    turn = np.linspace(0, 2 * np.pi, n, endpoint=False) + rng.uniform(-0.1, 0.1, n)
    start = np.column_stack([6 * np.cos(turn), 6 * np.sin(turn), np.full(n, 1.0)])
    anchors = -start * [5, 5, -1]
    formed, who = bound_for(anchors)
    frames = draw_frames(2 * n, 10.0, 0.0, noise, rng)
    state = FormationState.at_rest(np.concatenate([start, anchors]), 0)
    simulate_steps(state, who, swarm(frames, formed), 0, 2500, rng)
    assert state.min_separation[:n].max() < RULES.keep_out + 0.1  # all of them met somebody
    assert state.min_separation.min() >= RULES.keep_out - (0.05 if noise else 0.0)
    assert np.linalg.norm(state.position[:n] - start, axis=1).min() > 4


def walled(patience):
    """One flies at a wall of three who hover; its states, step by step."""
    start = np.array([[0.0, 0, 1], [3, 0, 1], [2.6, 1.6, 1], [2.6, -1.6, 1]])
    formed, _ = bound_for(np.zeros((4, 3)))
    who = roles(follows=np.arange(8) == 0)
    rules = RULES._replace(blocked_time=patience)
    places = np.concatenate([start, start + np.array([60.0, 0, 0])])
    return list(steps(swarm(aligned_frames(8), formed, rules), places, 1500, who))


def test_who_is_stopped_for_its_patience_goes_anywhere_for_a_moment():
    states = walled(RULES.blocked_time)
    blocked = np.array([state.blocked_time[0] for state in states])
    speed = np.array([np.linalg.norm(state.velocity[0, :2]) for state in states])
    begins = int(np.argmax(blocked < 0))
    waited, wanders = round(RULES.blocked_time / STEP), round(RULES.wander_time / STEP)
    assert (speed[begins - waited + 1 : begins + 1] < 0.2 * LIMITS.speed).all()
    assert speed[begins : begins + wanders].max() > 0.2 * LIMITS.speed
    assert (blocked[begins : begins + wanders - 1] < 0).all()
    assert blocked[begins + wanders] == 0
    # It flies one way, as far as the others let it, and comes no nearer to anybody.
    assert len({state.wander_direction[0] for state in states[begins : begins + wanders]}) == 1
    assert states[-1].min_separation[:4].min() >= RULES.keep_out


def test_who_has_more_patience_stays_where_it_is():
    states = walled(np.inf)
    assert np.linalg.norm(states[-1].velocity[0]) < 0.01
    assert np.linalg.norm(states[-1].position[0] - states[-500].position[0]) < 0.01


def test_who_does_not_follow_hovers_and_who_is_pushed_goes_as_asked_in_its_own_frame():
    frames = draw_frames(8, 10.0, 0.0, 0.0, np.random.default_rng(5))
    who = roles(follows=np.zeros(8, dtype=bool), pushed=2, push=(0.3, 0.1, 0.2))
    (*_, state) = steps(swarm(frames), crowded(5) * [10, 10, 1], 100, who)
    asked = frames.rotation[2] * (0.3 + 0.1j)
    assert state.velocity[2] == pytest.approx([asked.real, asked.imag, 0.2])
    assert not np.delete(state.velocity, 2, axis=0).any()


def test_paths_and_nearest_encounters_are_what_the_positions_say():
    start = crowded(6)
    before, flown, nearest = start, np.zeros(8), np.full(8, np.inf)
    for state in steps(swarm(aligned_frames(8)), start, 300):
        apart = squareform(pdist(before[:, :2])) + np.diag(np.full(8, np.inf))
        nearest = np.minimum(nearest, apart.min(axis=1))
        flown += np.linalg.norm(state.position[:, :2] - before[:, :2], axis=1)
        before = state.position
    assert state.path_length == pytest.approx(flown, abs=1e-12)
    assert state.min_separation == pytest.approx(nearest, abs=1e-12)
