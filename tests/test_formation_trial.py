"""What is said of a trial, added up from its frames by hand."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.distance import pdist

from sato.formation import Formation, SupervisorSettings, draw_frames, simulate
from sato.formation.mission import legacy_formation
from sato.formation.shape_error import compute_shape_error
from sato.formation.supervisor import Phase
from sato.formation.trial import draw_trial, evaluate_trial, run_trial


@cache
def mission(seed=0):
    rng = np.random.default_rng(seed)
    start, shapes = draw_trial(rng, agents=8)
    frames = draw_frames(8, 10.0, 0.01, 0.02, rng)
    return Formation(start, shapes, frames, supervision=SupervisorSettings(hover_time=1.0))


@cache
def flown(seed=0):
    return tuple(simulate(mission(seed), np.random.default_rng(seed)))


@cache
def trial(seed=0):
    return run_trial(mission(seed), np.random.default_rng(seed))


def moment(leg, kind):
    """When something first happened on a leg, and what all had flown by then."""
    for last, frame in pairwise(flown()):
        if frame.leg_index == leg and any(e["kind"] == kind for e in frame.events):
            # What is decided before a step shows in the frame after it.
            shown = last if kind == "assignment" else frame
            return shown.time, shown.path_length.mean()
    raise AssertionError(f"no {kind} on leg {leg}")


def test_a_trial_is_judged_by_its_frames_alone():
    assert evaluate_trial(mission(), flown()) == trial()


def test_time_and_path_count_from_the_first_assignment_until_settled():
    spans = [(moment(leg, "assignment"), moment(leg, "leg_end")) for leg in (0, 1)]
    assert trial().time == pytest.approx(sum(end[0] - begin[0] for begin, end in spans))
    assert trial().path_length == pytest.approx(sum(end[1] - begin[1] for begin, end in spans))
    assert (
        trial().path_length < flown()[-1].path_length.mean()
    )  # it goes on a little while it hovers


def test_paths_are_the_lengths_of_what_was_flown_in_the_plane():
    steps = [np.linalg.norm((b.position - a.position)[:, :2], axis=1) for a, b in pairwise(flown())]
    assert flown()[-1].path_length == pytest.approx(np.sum(steps, axis=0), abs=1e-9)


def test_assignments_are_the_first_of_each_formation_and_changes():
    changes, point = 0, flown()[0].assignment
    for last, frame in pairwise(flown()):
        begun = frame.phase is not Phase.WAITING and last.phase in (Phase.WAITING, Phase.COMPLETED)
        if begun and not (last.leg_index == frame.leg_index and last.phase is Phase.COMPLETED):
            changes += 1
        elif frame.leg_index == last.leg_index and not np.array_equal(frame.point_index, point):
            changes += 1
        point = frame.point_index
    assert trial().assignments == changes >= 2


def test_separation_is_the_least_that_ever_was():
    least = min(pdist(frame.position[:, :2]).min() for frame in flown())
    assert trial().min_separation == pytest.approx(least, abs=1e-9)


def test_time_in_gridlock_is_that_of_the_frames_that_show_it():
    seed = next(s for s in range(20) if trial(s).gridlock_time > 0)
    shown = sum(frame.phase is Phase.GRIDLOCKED for frame in flown(seed))
    assert trial(seed).gridlock_time == pytest.approx(shown * mission().frame_period)


def test_shapes_are_judged_after_hovering_in_them():
    assert trial().completed and len(trial().shape_errors) == 2
    for leg, found in enumerate(trial().shape_errors):
        last = [frame for frame in flown() if frame.leg_index == leg][-1]
        points = mission().gains[leg].formation.points
        assert found == compute_shape_error(last.position[np.argsort(last.point_index)], points)
    assert trial().shape_error == max(found.error for found in trial().shape_errors)


def test_who_does_not_settle_in_time_has_no_shape():
    brief = replace(mission(), protocol=SupervisorSettings(hover_time=1.0, time_limit=3.0))
    found = run_trial(brief, np.random.default_rng(0))
    assert not found.completed and found.shape_errors == () and found.shape_error == np.inf


def test_a_draw_is_of_the_trials_of_the_paper():
    start, shapes = draw_trial(np.random.default_rng(5), remove_edges=True)
    assert pdist(start[:, :2]).min() >= 1.5 and start[:, :2].max() <= 20
    for gains in shapes:
        points = gains.formation.points
        assert points.shape == (30, 3) and pdist(points[:, :2]).min() >= 2
        assert points.max(axis=0) == pytest.approx([15, 15, 2], abs=2) and points.min() >= 0
    graph = shapes[0].formation.graph
    assert np.array_equal(graph, shapes[1].formation.graph)
    assert 0 < (~graph).sum() - 30 <= 2 * 26
    assert draw_trial(np.random.default_rng(5), agents=8).gains[0].formation.graph.sum() == 8 * 7


@pytest.mark.parametrize("kind", ["hungarian", "cbaa"])
def test_the_paper_s_own_flight_settles_with_its_assignments(kind):
    printed = legacy_formation(mission().start, mission().gains, kind)
    found = run_trial(printed, np.random.default_rng(0))
    assert found.completed and found.assignments >= 2
