"""What is said of a trial, added up from its frames by hand."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from sato.formation import FormationFlight, Protocol, fly, misaligned
from sato.formation.mission import as_printed
from sato.formation.shape import likeness
from sato.formation.supervisor import Phase
from sato.formation.trial import draw, fly_trial, judged


@cache
def mission(seed=0):
    rng = np.random.default_rng(seed)
    start, shapes = draw(rng, agents=8)
    frames = misaligned(8, 10.0, 0.01, 0.02, rng)
    return FormationFlight(start, shapes, frames, protocol=Protocol(hover=1.0))


@cache
def flown(seed=0):
    return tuple(fly(mission(seed), np.random.default_rng(seed)))


@cache
def trial(seed=0):
    return fly_trial(mission(seed), np.random.default_rng(seed))


def moment(leg, kind):
    """When something first happened on a leg, and what all had flown by then."""
    for last, frame in pairwise(flown()):
        if frame.leg == leg and any(e["kind"] == kind for e in frame.events):
            # What is decided before a step shows in the frame after it.
            shown = last if kind == "assignment" else frame
            return shown.time, shown.path.mean()
    raise AssertionError(f"no {kind} on leg {leg}")


def test_a_trial_is_judged_by_its_frames_alone():
    assert judged(mission(), flown()) == trial()


def test_time_and_path_count_from_the_first_assignment_until_settled():
    spans = [(moment(leg, "assignment"), moment(leg, "leg_end")) for leg in (0, 1)]
    assert trial().time == pytest.approx(sum(end[0] - begin[0] for begin, end in spans))
    assert trial().path == pytest.approx(sum(end[1] - begin[1] for begin, end in spans))
    assert trial().path < flown()[-1].path.mean()  # it goes on a little while it hovers


def test_paths_are_the_lengths_of_what_was_flown_in_the_plane():
    steps = [np.linalg.norm((b.position - a.position)[:, :2], axis=1) for a, b in pairwise(flown())]
    assert flown()[-1].path == pytest.approx(np.sum(steps, axis=0), abs=1e-9)


def test_assignments_are_the_first_of_each_formation_and_changes():
    changes, point = 0, flown()[0].point
    for last, frame in pairwise(flown()):
        begun = frame.phase is not Phase.WAITING and last.phase in (Phase.WAITING, Phase.DONE)
        if begun and not (last.leg == frame.leg and last.phase is Phase.DONE):
            changes += 1
        elif frame.leg == last.leg and not np.array_equal(frame.point, point):
            changes += 1
        point = frame.point
    assert trial().assignments == changes >= 2


def test_separation_is_the_least_that_ever_was():
    least = min(pdist(frame.position[:, :2]).min() for frame in flown())
    assert trial().separation == pytest.approx(least, abs=1e-9)


def test_time_in_gridlock_is_that_of_the_frames_that_show_it():
    seed = next(s for s in range(20) if trial(s).gridlocked > 0)
    shown = sum(frame.phase is Phase.GRIDLOCKED for frame in flown(seed))
    assert trial(seed).gridlocked == pytest.approx(shown * mission().sample)


def test_shapes_are_judged_after_hovering_in_them():
    assert trial().settled and len(trial().likeness) == 2
    for leg, found in enumerate(trial().likeness):
        last = [frame for frame in flown() if frame.leg == leg][-1]
        points = mission().shapes[leg].formation.points
        assert found == likeness(last.position[np.argsort(last.point)], points)
    assert trial().error == max(found.error for found in trial().likeness)


def test_who_does_not_settle_in_time_has_no_shape():
    brief = replace(mission(), protocol=Protocol(hover=1.0, limit=3.0))
    found = fly_trial(brief, np.random.default_rng(0))
    assert not found.settled and found.likeness == () and found.error == np.inf


def test_a_draw_is_of_the_trials_of_the_paper():
    start, shapes = draw(np.random.default_rng(5), thin=True)
    assert pdist(start[:, :2]).min() >= 1.5 and start[:, :2].max() <= 20
    for gains in shapes:
        points = gains.formation.points
        assert points.shape == (30, 3) and pdist(points[:, :2]).min() >= 2
        assert points.max(axis=0) == pytest.approx([15, 15, 2], abs=2) and points.min() >= 0
    graph = shapes[0].formation.graph
    assert np.array_equal(graph, shapes[1].formation.graph)
    assert 0 < (~graph).sum() - 30 <= 2 * 26
    assert draw(np.random.default_rng(5), agents=8).shapes[0].formation.graph.sum() == 8 * 7


@pytest.mark.parametrize("kind", ["hungarian", "cbaa"])
def test_the_paper_s_own_flight_settles_with_its_assignments(kind):
    printed = as_printed(mission().start, mission().shapes, kind)
    found = fly_trial(printed, np.random.default_rng(0))
    assert found.settled and found.assignments >= 2
