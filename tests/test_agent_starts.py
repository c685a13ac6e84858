"""Agents that start in motion: how they stop, and starts that are refused."""

import numpy as np
import pytest
from agents import fly_by_messages
from commitment_examples import stop_at_once
from reconfiguration_runs import make_mission

import sato
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
        with pytest.raises(
            ValueError, match=r"state: agent 0 needs .* m to stop, and within 4\.25"
        ):
            agent.step(0.0, state, [])
    with pytest.raises(ValueError, match="commitment: must be a Commitment, got an array"):
        sato.Agent(mission, 0, commitment=np.zeros((3, 2)))
