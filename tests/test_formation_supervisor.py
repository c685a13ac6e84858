"""Supervisor: convergence and gridlock, from given speeds and avoidance."""

from itertools import groupby

import numpy as np
import pytest

from sato.formation.leg import FormationLeg
from sato.formation.mission import Formation, legacy_formation
from sato.formation.settings import SupervisorSettings
from sato.formation.supervisor import Phase, Supervisor, find_blocked

SETTINGS = SupervisorSettings(
    convergence_speed=1.0,
    averaging_window=1.0,
    convergence_time=1.0,
    gridlock_share=0.95,
    gridlock_timeout=3.0,
)
PERIOD = 0.1
SLOW, FAST = np.array([0.2, 0.9]), np.array([0.2, 1.5])
FREE, AVOIDING = np.array([False, False]), np.array([False, True])


def assigned_supervisor():
    """Return a supervisor whose swarm has just been assigned."""
    supervisor = Supervisor(SETTINGS, PERIOD)
    supervisor.mark_assigned()
    return supervisor


def observe(supervisor, time, speed=SLOW, avoiding=FREE):
    """Phases while nothing changes for a time [s]."""
    return [supervisor.observe(speed, avoiding) for _ in range(round(time / PERIOD))]


def test_swarm_waits_until_it_is_assigned():
    supervisor = Supervisor(SETTINGS, PERIOD)
    phases = observe(supervisor, 5) + observe(supervisor, 5, FAST, AVOIDING)
    assert set(phases) == {Phase.WAITING}


CASES = {  # time [s], speeds and avoidance one after another; phases and their observations
    "slow from a window on": ([(4, SLOW, FREE)], "flying 9, converged 10, completed 21"),
    "one is fast": ([(5, FAST, FREE)], "flying 50"),
    "one avoids": ([(6, FAST, AVOIDING)], "flying 9, gridlocked 30, given up 21"),
    "slow before gridlocked": ([(3, SLOW, AVOIDING)], "flying 9, converged 10, completed 11"),
    "slow in a gridlock": ([(1, FAST, AVOIDING), (2, SLOW, AVOIDING)], "flying 9, gridlocked 21"),
    # One of 1.5 among 0.9 is 0.96 in the mean, two would be 1.02; the window slides on.
    "converged for a while": (
        [(1, FAST, FREE), (0.9, SLOW, FREE), (0.2, FAST, FREE)],
        "flying 18, converged 2, flying 1",
    ),
    # The window is full again after 5 more, and without what was fast after 9.
    "fast again": (
        [(1.5, SLOW, FREE), (0.5, 5 * FAST, FREE), (3, SLOW, FREE)],
        "flying 9, converged 6, flying 14, converged 10, completed 11",
    ),
    # One free observation in ten is 90 % of the window, and less than stuck.
    "two gridlocks": (
        [(3, FAST, AVOIDING), (0.1, FAST, FREE), (5, FAST, AVOIDING)],
        "flying 9, gridlocked 21, flying 10, gridlocked 30, given up 11",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_phases_follow_from_speeds_and_avoidance(case):
    flown, expected = CASES[case]
    supervisor, phases = assigned_supervisor(), []
    for part in flown:
        phases += observe(supervisor, *part)
    found = [(phase.value, len(list(each))) for phase, each in groupby(phases)]
    assert ", ".join(f"{name} {count}" for name, count in found) == expected


@pytest.mark.parametrize(("legacy", "expected"), [(True, "gridlocked"), (False, "flying")])
def test_one_blocked_among_moving_agents_is_a_gridlock_as_printed_alone(legacy, expected):
    supervisor = Supervisor(SETTINGS, PERIOD, legacy)
    supervisor.mark_assigned()
    assert observe(supervisor, 2, 5 * FAST, AVOIDING)[-1].value == expected
    assert observe(supervisor, 1, 5 * FAST, ~FREE)[-1].value == "gridlocked"


def test_blocked_agents_avoid_others_and_hardly_move():
    points = np.array([[0.0, 0, 1], [3, 0, 1], [0, 3, 1], [3, 3, 1]])
    ours = Formation(start=points, legs=[FormationLeg(points)])
    velocity = np.array([[0.09, 0, 0.3], [0, 0.11, 0], [0.0, 0, 0], [0.09, 0, 0]])
    avoiding = np.array([True, True, False, True])
    assert find_blocked(ours, velocity, avoiding).tolist() == [True, False, False, True]
    printed = legacy_formation(points, [FormationLeg(points)])
    assert find_blocked(printed, velocity, avoiding).tolist() == avoiding.tolist()


def test_convergence_is_of_the_mean_over_the_window():
    supervisor = assigned_supervisor()
    # 9 observations at 0.9 and then one at 1.8: 0.99 in the mean.
    observe(supervisor, 0.9)
    assert supervisor.observe(np.array([0.2, 1.8]), FREE) is Phase.CONVERGED
    supervisor = assigned_supervisor()
    observe(supervisor, 0.9)
    assert supervisor.observe(np.array([0.2, 2.0]), FREE) is Phase.FLYING


def test_avoiding_by_turns_is_no_gridlock():
    supervisor, turns = assigned_supervisor(), [np.array([True, False]), np.array([False, True])]
    phases = [supervisor.observe(FAST, turns[k // 3 % 2]) for k in range(100)]
    assert set(phases) == {Phase.FLYING}


@pytest.mark.parametrize("period", [0.02, 0.1, 0.5])
def test_times_do_not_depend_on_the_period_of_observation(period):
    supervisor = Supervisor(SETTINGS, period)
    supervisor.mark_assigned()
    phases = [supervisor.observe(SLOW, FREE) for _ in range(round(4 / period))]
    assert phases.index(Phase.CONVERGED) + 1 == round(1 / period)
    assert phases.index(Phase.COMPLETED) + 1 == round(2 / period)


def test_later_assignments_change_no_phase():
    supervisor = assigned_supervisor()
    observe(supervisor, 1.5)
    supervisor.mark_assigned()
    assert supervisor.phase is Phase.CONVERGED
