"""Agents whose numbers the mission's start has not, timers that are off, and what is warned of."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from reconfiguration_runs import make_mission

import sato
from dynamics import ClohessyWiltshire
from sato.network.link import Link
from sato.reconfiguration.agent_inputs import as_instant

NUMBERS = (0, 1, 7)
ORBIT = sato.Orbit.from_elements(6878e3, inclination=0.8)
PLANE = {
    "plain": {},
    "known obstacle": {"obstacles": [sato.Sphere((0.0, 2.5), 0.5)]},
    "moving obstacle": {"obstacles": [sato.Sphere((6.0, 2.5), 0.4, velocity=(-0.1, 0.0))]},
    "hidden obstacle": {"obstacles": [sato.Sphere((0.0, 2.5), 0.4, known=False)]},
    "box": {"box": [[-6.0, -3.0], [6.0, 9.0]]},
    "box and obstacle": {
        "box": [[-6.0, -3.0], [6.0, 9.0]],
        "obstacles": [sato.Sphere((0.0, 2.5), 0.5)],
    },
    "ellipsoids": {"separation_axes": (1.0, 1.5), "box": [[-6.0, -3.0], [6.0, 9.0]]},
    "given": {"assignment": "given", "box": [[-6.0, -3.0], [6.0, 9.0]]},
    "noise": {"position_noise": 1e-3, "replan_steps": 1, "margin": 0.05},
    "energy": {"objective": "energy"},
    "ball of controls": {"control_norm": 2, "fuel_norm": 2},
    "limits of axes": {"max_control": None, "max_control_axes": (0.3, 0.2)},
}


def mission_of(changes, in_orbit=None):
    start = np.array([[-3.0, 0.0], [0.0, 0.0]])
    goal = np.array([[-3.0, 5.0], [0.0, 5.0], [3.0, 5.0]])
    own = dict(max_control=0.3, max_speed=0.5, comm_radius=30.0) | changes
    if own.get("assignment") == "given":
        goal = goal[:2]
    return make_mission(start, sato.Leg(goal, 20), **own)


def fly_step(mission, x, u, k):
    return mission.flown_plant.propagate(x[None], u[None], k * mission.step, mission.step)[-1][0]


def fly(mission, agents, x, seen=(), steps=25):
    """Fly agents in lock step, with all messages heard; return the least distance [m]."""
    sent, closest, d = {}, np.inf, mission.axes
    rounds = max(1, round(mission.step / (mission.link.round or mission.step)))
    for k in range(steps):
        for r in range(400 if rounds == 1 else rounds):
            time = k * mission.step + r * mission.link.round
            heard = {i: [sent[j] for j in agents if j != i and sent.get(j)] for i in agents}
            told = {i: agents[i].step(time, x[i], heard[i], seen) for i in agents}
            sent = {i: message for i, (_, message) in told.items()}
            if rounds == 1 and all(agent.is_finished for agent in agents.values()):
                break
        for i, (u, _) in told.items():
            x[i] = fly_step(mission, x[i], u, k)
        for i, j in itertools.combinations(agents, 2):
            closest = min(closest, np.linalg.norm(x[i][:d] - x[j][:d]))
    return closest


@pytest.mark.parametrize("name", PLANE)
def test_agents_of_numbers_beyond_the_start_fly_with_every_feature(name):
    mission = mission_of(PLANE[name])
    places = {i: np.array([3.0 * a - 3.0, 0.0, 0.0, 0.0]) for a, i in enumerate(NUMBERS)}
    own = {i: {"target_count": 3} for i in NUMBERS}
    if mission.assignment == "given":
        goals = {0: [[-3.0, 5.0]], 1: [[0.0, 5.0]], 7: [[3.0, 5.0]]}
        own = {i: {"leg": sato.Leg(goals[i], 20)} for i in NUMBERS}
    agents = {i: sato.Agent(mission, i, leg_start=0.0, **own[i]) for i in NUMBERS}
    seen = [(9, [20.0, 20.0, 0.0, 0.0])] + [one for one in mission.obstacles if not one.known]
    assert fly(mission, agents, places, seen) >= 0.5 * (1 - 1e-6)
    ends = np.array([x[:2] for x in places.values()])
    goal = np.array([[-3.0, 5.0], [0.0, 5.0], [3.0, 5.0]])
    away = np.linalg.norm(ends[:, None] - goal, axis=2)
    assert sorted(away.argmin(axis=1)) == [0, 1, 2] and away.min(axis=1).max() < 0.3


def test_agents_of_numbers_beyond_the_start_decide_over_slow_rounds():
    mission = mission_of({"link": Link(round=0.02)} | PLANE["box and obstacle"])
    agents = {i: sato.Agent(mission, i, target_count=3, leg_start=0.0) for i in NUMBERS}
    places = {i: np.array([3.0 * a - 3.0, 0.0, 0.0, 0.0]) for a, i in enumerate(NUMBERS)}
    assert fly(mission, agents, places, steps=4) >= 0.5 * (1 - 1e-6)


@pytest.mark.parametrize("obstacles", [[], [sato.Sphere((0.0, 900.0, 0.0), 50.0)]])
@pytest.mark.parametrize("model", [ClohessyWiltshire(1e-3), sato.J2(ORBIT)])
def test_agents_of_numbers_beyond_the_start_fly_in_orbit(model, obstacles):
    start = np.array([[0.0, 0.0, 0.0], [0.0, 300.0, 0.0]])
    goal = np.array([[0.0, 100.0, 0.0], [0.0, 400.0, 0.0], [0.0, 700.0, 0.0]])
    own = dict(step=60.0, comm_radius=5e3, max_control=0.01, max_speed=5.0, collision_radius=50.0)
    mission = make_mission(start, sato.Leg(goal, 12), model=model, obstacles=obstacles, **own)
    agents = {i: sato.Agent(mission, i, target_count=3, leg_start=0.0) for i in NUMBERS}
    places = {i: np.r_[0.0, 300.0 * a, np.zeros(4)] for a, i in enumerate(NUMBERS)}
    assert fly(mission, agents, places, steps=3) >= 50.0
    assert sorted(agent.target_index for agent in agents.values()) == [0, 1, 2]


@pytest.mark.parametrize("key", ["max_control", "max_speed", "collision_radius", "priority"])
def test_number_beyond_a_list_is_refused_with_the_last_of_the_list(key):
    value = (1, 0) if key == "priority" else (0.3, 0.4)
    with pytest.raises(ValueError, match="from 0 to 1, the last of the mission's lists"):
        sato.Agent(mission_of({key: value}), 2)


@pytest.mark.parametrize("step", [0.3, 1.0, 7.0, 60.0])
def test_time_that_is_a_little_early_or_late_is_of_the_nearest_instant(rng, step):
    mission = replace(mission_of({}), step=step, allow_undetectable=True)
    for k in (0, 1, 2, 17, 1000):
        for off in (0.0, -1e-3 * step, 1e-3 * step, *rng.uniform(-0.249, 0.249, 5) * step):
            assert as_instant(mission, "time", k * step + off) == k


def test_times_of_rounds_are_of_the_instant_whose_round_is_nearest(rng):
    mission = mission_of({"step": 1.0, "link": Link(round=0.03)})
    for k in (0, 1, 17):
        for r in range(34):  # the last begins 0.01 s before the next instant
            for off in rng.uniform(-0.0049, 0.0049, 3):
                assert as_instant(mission, "time", k + 0.03 * r + off) == k


@pytest.mark.parametrize("time", [0.3, 0.5, 0.74, 12.5])
def test_time_between_two_instants_is_refused_with_both(time):
    agent = sato.Agent(mission_of({}), 0)
    text = rf"time = {time:g} s lies between the instants {int(time)} .* {int(time) + 1} s"
    with pytest.raises(ValueError, match=text):
        agent.step(time, np.zeros(4), [])


def test_agent_with_a_jittering_timer_flies_as_one_without():
    ends = []
    for jitter in (np.zeros(25), np.random.default_rng(1).uniform(-0.2, 0.2, 25)):
        mission = mission_of({})
        agent, x = sato.Agent(mission, 0, target_count=1), np.array([-3.0, 0.0, 0.0, 0.0])
        for k, off in enumerate(jitter):
            u, finished = None, False
            while not finished:
                u, _ = agent.step(max(k + off, 0.0), x, [])
                finished = agent.is_finished
            x = fly_step(mission, x, u, k)
        ends.append(x)
    assert (ends[0] == ends[1]).all()


def test_agent_warns_of_what_a_run_warns_of():
    mission = mission_of({"link": Link(loss_probability=0.1)})
    with pytest.warns(UserWarning, match="messages that are lost or late change nothing"):
        sato.Agent(mission, 0)
    with pytest.warns(UserWarning, match="messages that are lost or late change nothing"):
        sato.run(mission)


@pytest.mark.parametrize("assignment", ["auction", "given"])
def test_agents_that_can_neither_drift_nor_part_are_refused_as_by_a_run(assignment):
    start = np.array([[0.0, 0.0, 0.0, 0.0, 1.7, 0.0], [0.0, 140.0, 0.0, 0.0, -1.7, 0.0]])
    leg = sato.Leg(np.array([[0.0, -400.0, 0.0], [0.0, 540.0, 0.0]]), 20)
    own = dict(step=60.0, comm_radius=5e3, max_control=0.02, max_speed=5.0, collision_radius=50.0)
    own |= {"model": ClohessyWiltshire(1e-3), "assignment": assignment}
    mission = make_mission(start, leg, **own)
    refusal = "swarm.start: agents 0 and 1 can neither drift nor fly to their targets 50 m apart"
    with pytest.raises(ValueError, match=refusal):
        sato.run(mission)
    agents = {i: sato.Agent(mission, i) for i in range(2)}
    with pytest.raises(ValueError, match=refusal):
        fly(mission, agents, dict(enumerate(start)), steps=1)
