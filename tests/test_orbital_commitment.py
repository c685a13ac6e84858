"""Commitment in orbit: to whole plans, clear of each other for two orbits after them."""

from itertools import combinations

import numpy as np
import pytest
from commitment_examples import random_spacecraft
from messages import run_rounds
from orbit_examples import propagate_relative
from reconfiguration_runs import fly, leg_to, make_mission

import sato
from dynamics.j2 import J2, invariant_velocity
from dynamics.orbit import Orbit
from dynamics.trajectory_geometry import control_points
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.agent_stages import Choosing, Holding
from sato.reconfiguration.free_motion import free_motion, simulate, simulate_nonlinear
from sato.reconfiguration.offers import Offers
from sato.reconfiguration.orbital_commitment import choose_in_orbit

ALL = np.ones(6, dtype=bool)
ORBIT = Orbit.from_elements(6878e3, 0.02, np.pi / 4)


def random_swarm(rng, count):
    places = rng.uniform(-1500, 1500, (count, 3)) * [1, 1, 0]
    return np.hstack([places, invariant_velocity(ORBIT, places, 0.0)])


def test_cubics_through_simulated_states_follow_free_motion():
    x, h = random_swarm(np.random.default_rng(1), 5), ORBIT.period / 50
    states = simulate_nonlinear(J2(ORBIT), x, np.zeros((5, 100, 3)), 0.0, h)
    thirds = np.arange(1, 100) * h + h / 3
    exact = propagate_relative(ORBIT, x, thirds)[..., :3]
    b = np.array([8, 12, 6, 1]) / 27  # Bernstein polynomials at a third
    pieces = control_points(states[..., :3], states[..., 3:], h)
    found = np.einsum("i,apid->pad", b, pieces[:, 1:])
    assert np.abs(found - exact).max() <= 1e-4 * np.abs(exact).max()


def random_offers(rng, count):
    """Two straight paths each, of several pieces, that often meet."""
    start, way = rng.uniform(0, 6, (count, 2, 1, 1, 2)), rng.normal(0, 2, (count, 2, 1, 1, 2))
    time = np.arange(3)[:, None, None] + np.linspace(0, 1, 4)[:, None]
    allowed = np.ones((count, 2), dtype=bool)
    agents, u = np.arange(count), np.zeros((count, 2, 3, 2))
    paths = start + time * way / 3
    return Offers(agents, (3, 0), np.full(count, 3), None, u, paths, allowed, np.ones(count))


def least_distance(offers, i, j, choice):
    """Least distance of the straight paths that two have chosen."""
    ends = [offers.paths[a, choice[a]][[0, -1], [0, -1]] for a in (i, j)]
    begin, end = ends[0] - ends[1]
    share = np.linspace(0, 1, 2000)[:, None]
    return np.linalg.norm(begin + share * (end - begin), axis=1).min()


def test_choices_in_orbit_are_clear_of_all_whose_held_paths_were():
    met, last = 0, np.ones(6, dtype=int)
    for seed in range(200):
        rng = np.random.default_rng([1, seed])
        offers = random_offers(rng, 6)
        graph = CommunicationGraph.from_positions(rng.uniform(0, 6, (6, 2)), 4.0, ALL)
        choice, *_ = choose_in_orbit(offers, graph, rng.permutation(6))
        pairs = [pair for pair in combinations(range(6), 2) if graph.adjacency[pair]]
        unclear = {a for pair in pairs if least_distance(offers, *pair, last) < 1 for a in pair}
        for i, j in pairs:
            if not {i, j} & unclear:
                assert least_distance(offers, i, j, choice) >= 1 - 1e-9
                met += choice[i] + choice[j] > 0
        assert (choice[list(unclear)] == 0).all()
    assert met > 100


def test_choice_in_orbit_by_messages_is_that_of_all_at_once():
    for seed in range(100):
        rng = np.random.default_rng([2, seed])
        offers, rank = random_offers(rng, 6), rng.permutation(6)
        graph = CommunicationGraph.from_positions(rng.uniform(0, 6, (6, 2)), 4.0, ALL)
        held = {}
        for a in range(6):
            own = [part[[a]] for part in (offers.agents, offers.steps)]
            rest = [part[[a]] for part in (offers.u, offers.paths, offers.is_allowed)]
            rest.append(offers.clearance[[a]])
            held[a] = Holding(Offers(own[0], offers.plan_steps, own[1], None, *rest))
        (*_, held) = run_rounds(graph, held, Holding.update, lambda s: s.message, is_over)
        states = {
            a: Choosing(stage.kept_offers, (0.0, 0.0, int(rank[a])), int(graph.diameter[a]), 0)
            for a, stage in held.items()
        }
        (*_, chosen) = run_rounds(graph, states, Choosing.update, lambda s: s.message, is_over)
        keeps = [chosen[a].choice == 1 and not held[a].is_unclear for a in range(6)]
        assert keeps == (choose_in_orbit(offers, graph, rank)[0] == offers.last).tolist()


def is_over(state):
    """Tell whether an agent has decided."""
    return state.is_finished


def test_free_motion_is_checked_as_long_as_targets_keep_their_distance():
    # At rest about a circular orbit, a vehicle that is 10 m above another drifts past it, to the
    # west, within 49 m.
    rate = 1.1e-3
    still = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [10.0, 55.0, 0.0, 0.0, 0.0, 0.0]])
    places = np.array([[0.0, 0.0, 0.0], [100.0, 400.0, 0.0]])
    bounded = np.hstack([places, rate * places[:, [1, 0, 2]] * [0.5, -2, 0]])
    for targets, share in ((still, (0.05, 0.2)), (bounded, (1.0, 1.0))):
        leg = leg_to(targets, 20)
        options = {"step": 30.0, "comm_radius": 3e3, "collision_radius": 50.0}
        options |= {"max_control": 0.01, "max_speed": 3.0, "model": sato.ClohessyWiltshire(rate)}
        mission = make_mission(bounded, leg, **options)
        count, h = free_motion(mission, mission.legs[0], mission.legs[0].steps)
        assert share[0] <= count * h * rate / (4 * np.pi) <= share[1] + 1e-9


def test_free_motion_is_checked_from_the_instant_of_arrival():
    # About an oblate Earth targets at rest cross at other times if they are taken up later.
    across = np.stack(np.meshgrid(80.0 * np.arange(5), 110.0 * np.arange(5)), axis=-1)
    across = across.reshape(-1, 2) + np.random.default_rng(0).normal(0.0, 8.0, (25, 2))
    targets = np.pad(across, ((0, 0), (0, 4)))
    options = {"step": 60.0, "comm_radius": 3e3, "collision_radius": 20.0, "max_speed": 5.0}
    options |= {"max_control": 0.05, "model": J2(ORBIT)}
    mission = make_mission(targets, leg_to(targets, 20), **options)
    leg, d = mission.legs[0], mission.axes
    counts = []
    for arrival in (20, 45, 60, 75):
        count, h = free_motion(mission, leg, arrival)
        rest = np.zeros((25, count, d))
        x = simulate(mission, leg.targets, rest, arrival * mission.step, h)
        apart = np.linalg.norm(x[:, None, :, :d] - x[None, :, :, :d], axis=-1)
        assert apart[np.triu_indices(25, 1)].min() >= 20.0
        counts.append(count)
    assert len(set(counts)) > 1


@pytest.mark.parametrize("seed", range(6))
def test_spacecraft_never_come_closer_than_their_distance(seed):
    mission = random_spacecraft(np.random.default_rng([5, seed]))
    run = sato.run(mission, seed=seed)
    assert run.summary["min_separation_m"] >= run.mission.collision_radius * (1 - 1e-6)
    assert run.summary["reached"]


def test_starts_that_can_neither_drift_nor_fly_apart_are_refused():
    # They meet at 2 m/s within the first step, whatever they do.
    start = np.array([[0.0, -80.0, 0, 0, 2.0, 0], [0.0, 80.0, 0, 0, -2.0, 0]])
    targets = np.array([[0.0, 300.0, 0, 0, 0, 0], [0.0, -300.0, 0, 0, 0, 0]])
    options = {"step": 60.0, "comm_radius": 3e3, "collision_radius": 50.0, "max_speed": 4.0}
    options |= {"max_control": 5e-3, "model": sato.ClohessyWiltshire(1.1e-3)}
    mission = make_mission(start, leg_to(targets, 40), assignment="given", **options)
    with pytest.raises(sato.InputError, match="agents 0 and 1 can neither drift nor fly"):
        fly(mission)
