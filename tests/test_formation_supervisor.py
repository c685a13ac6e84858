"""Settled and stuck by the protocol of the trials, on speeds and avoidance made by hand."""

import numpy as np
import pytest

from sato.formation.mission import SupervisorSettings
from sato.formation.supervisor import Phase, Supervisor

PROTOCOL = SupervisorSettings(
    convergence_speed=1.0,
    averaging_window=1.0,
    convergence_time=1.0,
    gridlock_share=0.95,
    gridlock_timeout=3.0,
)
SAMPLE = 0.1
SLOW, FAST = np.array([0.2, 0.9]), np.array([0.2, 1.5])
FREE, AVOIDS = np.array([False, False]), np.array([False, True])


def watch():
    """A supervisor whose swarm has just been assigned."""
    supervisor = Supervisor(PROTOCOL, SAMPLE, 2)
    supervisor.mark_assigned()
    return supervisor


def show(supervisor, time, speed=SLOW, avoids=FREE):
    """The phases of so many seconds in which all stays the same."""
    return [supervisor.observe(speed, avoids) for _ in range(round(time / SAMPLE))]


def changes(phases):
    """Phases in order, each with how often it was shown in a row."""
    found = []
    for phase in phases:
        if found and found[-1][0] is phase:
            found[-1][1] += 1
        else:
            found.append([phase, 1])
    return [(phase, count) for phase, count in found]


def test_without_an_assignment_it_waits_whatever_is_seen():
    supervisor = Supervisor(PROTOCOL, SAMPLE, 2)
    phases = show(supervisor, 5) + show(supervisor, 5, FAST, AVOIDS)
    assert set(phases) == {Phase.WAITING}


def test_who_is_slow_for_a_window_is_settled_and_for_as_long_again_done():
    assert changes(show(watch(), 4)) == [
        (Phase.FLYING, 9),
        (Phase.CONVERGED, 10),
        (Phase.COMPLETED, 21),
    ]


def test_one_fast_vehicle_keeps_all_flying():
    assert set(show(watch(), 5, FAST)) == {Phase.FLYING}


def test_it_is_the_mean_over_the_window_that_has_to_be_slow():
    supervisor = watch()
    # 9 observations at 0.9 and then one at 1.8: 0.99 in the mean.
    show(supervisor, 0.9)
    assert supervisor.observe(np.array([0.2, 1.8]), FREE) is Phase.CONVERGED
    supervisor = watch()
    show(supervisor, 0.9)
    assert supervisor.observe(np.array([0.2, 2.0]), FREE) is Phase.FLYING


def test_the_window_slides_on_over_who_is_settled():
    supervisor = watch()
    show(supervisor, 1, FAST)
    # One of 1.5 among 0.9 is 0.96 in the mean, two would be 1.02.
    assert show(supervisor, 0.9)[-2:] == [Phase.FLYING, Phase.CONVERGED]
    assert supervisor.observe(FAST, FREE) is Phase.CONVERGED  # for the other has left the window
    assert supervisor.observe(FAST, FREE) is Phase.FLYING


def test_who_does_not_stay_slow_flies_on_and_is_judged_on_what_comes_then():
    supervisor = watch()
    assert show(supervisor, 1.5)[-1] is Phase.CONVERGED
    assert show(supervisor, 0.5, 5 * FAST)[0] is Phase.FLYING  # the mean is 1.5 by then
    # The window is full again after 5 more, and without what was fast after 9.
    assert changes(show(supervisor, 3)) == [
        (Phase.FLYING, 9),
        (Phase.CONVERGED, 10),
        (Phase.COMPLETED, 11),
    ]


def test_who_does_nothing_but_avoid_is_gridlocked_and_after_so_long_given_up():
    assert changes(show(watch(), 6, FAST, AVOIDS)) == [
        (Phase.FLYING, 9),
        (Phase.GRIDLOCKED, 30),
        (Phase.ABORTED, 21),
    ]


def test_settled_is_asked_before_stuck_and_in_a_gridlock_not_at_all():
    assert changes(show(watch(), 3, SLOW, AVOIDS))[1][0] is Phase.CONVERGED
    supervisor = watch()
    show(supervisor, 1, FAST, AVOIDS)
    assert set(show(supervisor, 2, SLOW, AVOIDS)) == {Phase.GRIDLOCKED}


def test_who_gets_out_of_a_gridlock_flies_on_and_its_patience_begins_anew():
    supervisor = watch()
    show(supervisor, 1, FAST, AVOIDS)
    assert set(show(supervisor, 2, FAST, AVOIDS)) == {Phase.GRIDLOCKED}
    # One free observation in ten is 90 % of the window, and less than stuck.
    assert show(supervisor, 0.1, FAST, FREE) == [Phase.FLYING]
    assert changes(show(supervisor, 5, FAST, AVOIDS)) == [
        (Phase.FLYING, 9),
        (Phase.GRIDLOCKED, 30),
        (Phase.ABORTED, 11),
    ]


def test_avoiding_by_turns_is_no_gridlock():
    supervisor, turns = watch(), [np.array([True, False]), np.array([False, True])]
    phases = [supervisor.observe(FAST, turns[k // 3 % 2]) for k in range(100)]
    assert set(phases) == {Phase.FLYING}


@pytest.mark.parametrize("sample", [0.02, 0.1, 0.5])
def test_how_often_it_looks_changes_no_time(sample):
    supervisor = Supervisor(PROTOCOL, sample, 2)
    supervisor.mark_assigned()
    phases = [supervisor.observe(SLOW, FREE) for _ in range(round(4 / sample))]
    assert phases.index(Phase.CONVERGED) + 1 == round(1 / sample)
    assert phases.index(Phase.COMPLETED) + 1 == round(2 / sample)


def test_an_assignment_in_flight_changes_no_phase():
    supervisor = watch()
    show(supervisor, 1.5)
    supervisor.mark_assigned()
    assert supervisor.phase is Phase.CONVERGED
