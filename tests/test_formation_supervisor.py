"""Supervisor: convergence and gridlock, from given speeds and avoidance."""

import numpy as np
import pytest

from sato.formation.settings import SupervisorSettings
from sato.formation.supervisor import Phase, Supervisor

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


def changes(phases):
    """Phases in order, each with its number of observations in a row."""
    found = []
    for phase in phases:
        if found and found[-1][0] is phase:
            found[-1][1] += 1
        else:
            found.append([phase, 1])
    return [(phase, count) for phase, count in found]


def test_swarm_waits_until_it_is_assigned():
    supervisor = Supervisor(SETTINGS, PERIOD)
    phases = observe(supervisor, 5) + observe(supervisor, 5, FAST, AVOIDING)
    assert set(phases) == {Phase.WAITING}


def test_slow_swarm_converges_after_a_window_and_completes_after_another():
    assert changes(observe(assigned_supervisor(), 4)) == [
        (Phase.FLYING, 9),
        (Phase.CONVERGED, 10),
        (Phase.COMPLETED, 21),
    ]


def test_one_fast_agent_prevents_convergence():
    assert set(observe(assigned_supervisor(), 5, FAST)) == {Phase.FLYING}


def test_convergence_is_of_the_mean_over_the_window():
    supervisor = assigned_supervisor()
    # 9 observations at 0.9 and then one at 1.8: 0.99 in the mean.
    observe(supervisor, 0.9)
    assert supervisor.observe(np.array([0.2, 1.8]), FREE) is Phase.CONVERGED
    supervisor = assigned_supervisor()
    observe(supervisor, 0.9)
    assert supervisor.observe(np.array([0.2, 2.0]), FREE) is Phase.FLYING


def test_window_keeps_sliding_while_converged():
    supervisor = assigned_supervisor()
    observe(supervisor, 1, FAST)
    # One of 1.5 among 0.9 is 0.96 in the mean, two would be 1.02.
    assert observe(supervisor, 0.9)[-2:] == [Phase.FLYING, Phase.CONVERGED]
    assert supervisor.observe(FAST, FREE) is Phase.CONVERGED  # the other one has left the window
    assert supervisor.observe(FAST, FREE) is Phase.FLYING


def test_swarm_that_speeds_up_again_starts_a_new_window():
    supervisor = assigned_supervisor()
    assert observe(supervisor, 1.5)[-1] is Phase.CONVERGED
    assert observe(supervisor, 0.5, 5 * FAST)[0] is Phase.FLYING  # the mean is 1.5 by then
    # The window is full again after 5 more, and without what was fast after 9.
    assert changes(observe(supervisor, 3)) == [
        (Phase.FLYING, 9),
        (Phase.CONVERGED, 10),
        (Phase.COMPLETED, 11),
    ]


def test_gridlock_that_lasts_is_given_up():
    assert changes(observe(assigned_supervisor(), 6, FAST, AVOIDING)) == [
        (Phase.FLYING, 9),
        (Phase.GRIDLOCKED, 30),
        (Phase.ABORTED, 21),
    ]


def test_convergence_precedes_gridlock_and_does_not_end_it():
    assert changes(observe(assigned_supervisor(), 3, SLOW, AVOIDING))[1][0] is Phase.CONVERGED
    supervisor = assigned_supervisor()
    observe(supervisor, 1, FAST, AVOIDING)
    assert set(observe(supervisor, 2, SLOW, AVOIDING)) == {Phase.GRIDLOCKED}


def test_timeout_starts_again_with_each_gridlock():
    supervisor = assigned_supervisor()
    observe(supervisor, 1, FAST, AVOIDING)
    assert set(observe(supervisor, 2, FAST, AVOIDING)) == {Phase.GRIDLOCKED}
    # One free observation in ten is 90 % of the window, and less than stuck.
    assert observe(supervisor, 0.1, FAST, FREE) == [Phase.FLYING]
    assert changes(observe(supervisor, 5, FAST, AVOIDING)) == [
        (Phase.FLYING, 9),
        (Phase.GRIDLOCKED, 30),
        (Phase.ABORTED, 11),
    ]


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
