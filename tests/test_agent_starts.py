"""Agents that start in motion: how they stop, and starts that are refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from agents import decide, fly_by_messages
from commitment_examples import stop_at_once
from reconfiguration_runs import make_mission

import sato
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.loop import simulate


def head_on():
    """Two vehicles that would meet if both stopped at once."""
    start = np.array([[-1.3, 0.15, 0.7, 0.0], [1.3, -0.15, -0.7, 0.0]])
    goal = sato.Points([[3.0, 0.5], [-3.0, -0.5]], keep_order=True)
    limits = {"max_control": 0.2, "max_speed": 1.0, "comm_radius": 9.0, "assignment": "given"}
    return make_mission(start, sato.Leg(goal, 40), **limits)


def test_agents_with_their_commitments_fly_from_motion_as_the_loop_does():
    mission = head_on()
    stops = sato.find_first_commitments(mission)
    at_once = stop_at_once(mission.control_limit(0), mission.initial_states[0, 2:], 1.0)
    assert not np.allclose(stops[0].u[: len(at_once)], at_once)
    frames, least = simulate(mission, np.random.default_rng(0)), np.inf
    for _, frame, (x, control, *_) in zip(
        range(15), frames, fly_by_messages(mission), strict=False
    ):
        np.testing.assert_allclose(x[:, :2], frame.position, rtol=0, atol=1e-9)
        np.testing.assert_allclose(control, frame.control, rtol=0, atol=1e-9)
        least = min(least, np.linalg.norm(x[0, :2] - x[1, :2]))
    assert least >= mission.collision_radius


def test_mission_at_rest_has_first_commitments_before_it_is_drawn():
    limits = {"model": sato.DoubleIntegrator(2), "max_control": 0.5, "max_speed": 1.0}
    limits |= {"comm_radius": 20.0, "collision_radius": 1.0, "step": 1.0}
    legs = (sato.Leg(np.array([[0.0, 5.0], [5.0, 5.0]]), 20),)
    start = np.array([[0.0, 0.0, 0.0, 0.0], [5.0, 0.0, 0.0, 0.0]])
    still = sato.Reconfiguration(start=start, legs=legs, **limits)
    assert sato.find_first_commitments(still) == {}
    moving = sato.Reconfiguration(start=start + np.array([0.0, 0.0, 0.1, 0.0]), legs=legs, **limits)
    with pytest.raises(ValueError, match="mission: must be drawn"):
        sato.find_first_commitments(moving)


def test_first_states_from_which_agents_do_not_stop_in_reach_are_refused():
    mission = head_on()
    for speed in (1.0, 3.0):
        agent = sato.Agent(mission, 0)
        state = [-1.3, 0.15, speed, 0.0]
        if speed**2 / (2 * 0.2) < 4.25:
            assert len(agent.step(0.0, state, [])) == 2
            continue
        reason = r"state: agent 0 needs .* m to stop, and within 4\.25.*a speed of ([\d.]+) m/s"
        with pytest.raises(ValueError, match=reason) as told:
            agent.step(0.0, state, [])
        state[2] = float(re.search(reason, str(told.value))[1])  # that would do
        assert len(sato.Agent(mission, 0).step(0.0, state, [])) == 2
    with pytest.raises(ValueError, match="commitment: must be a Commitment, got an array"):
        sato.Agent(mission, 0, commitment=np.zeros((3, 2)))


@pytest.mark.parametrize("is_moving", [False, True])
def test_agent_that_starts_in_a_known_obstacle_is_refused_as_by_run(is_moving):
    mission, time = head_on(), 4.0 if is_moving else 0.0
    away = {"center": (0.0, 4.0), "velocity": (0.0, -1.0)} if is_moving else {"center": (0.0, 0.0)}
    mission = replace(mission, obstacles=(sato.Sphere(radius=0.6, **away),))
    fault = "agent 0 starts 0.4 m from obstacle 0, a sphere, and has to keep "
    with pytest.raises(sato.InputError, match=f"state: {fault}"):
        sato.Agent(mission, 0, leg_start=0.0).step(time, [1.0, 0.0, 0.0, 0.0], [])
    if not is_moving:
        start = np.array([[1.0, 0.0], [3.0, 0.0]])
        with pytest.raises(sato.InputError, match=f"start: {fault}"):
            replace(mission, start=sato.Points(start)).draw(np.random.default_rng(0))


def test_agents_that_start_within_each_others_radius_are_refused_as_by_run():
    mission, fault = head_on(), r"agent [01] starts 0.1 m from agent [01], closer than the"
    start = np.array([[0.0, 0.0, 0.0, 0.0], [0.1, 0.0, 0.0, 0.0]])
    with pytest.raises(sato.InputError, match=f"state: {fault}"):
        agents = {i: sato.Agent(mission, i) for i in range(2)}
        graph = CommunicationGraph(~np.eye(2, dtype=bool), np.ones(2, dtype=bool))
        list(decide(agents, 0.0, start, graph))
    with pytest.raises(sato.InputError, match=f"swarm.start: {fault}"):
        replace(mission, start=sato.Points(start[:, :2])).draw(np.random.default_rng(0))
