"""Whole flights of small swarms: shapes taken up, in own frames and by a poor radio, and events."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.formation import (
    AssignmentSettings,
    Formation,
    OperatorCommand,
    SupervisorSettings,
    aligned_frames,
    draw_frames,
    simulate,
)
from sato.formation.mission import legacy_formation
from sato.formation.shape_error import compute_shape_error
from sato.formation.supervisor import Phase
from sato.network.radio import Radio
from sato.shapes.formation_library import load_formation
from sato.shapes.graphs import random_sparse_graph
from sato.shapes.random_points import sample_formation, sample_positions

BRIEF = SupervisorSettings(hover_time=1.0)


@cache
def gains(name, graph="own"):
    return design_gains(load_formation(name, graph))


@cache
def some(seed, agents=8, share=0.7):
    rng = np.random.default_rng(seed)
    points = sample_formation(agents, (8.0, 8.0, 2.0), 2.0, rng)
    return design_gains(DesiredFormation(points, random_sparse_graph(points, share, rng)))


def flight(*shapes, seed=0, **other):
    """A flight from anywhere, in frames turned and shifted that drift, with noise."""
    rng = np.random.default_rng(seed)
    agents = len(shapes[0].formation.points)
    start = np.column_stack([sample_positions(agents, (8.0, 8.0), 1.6, rng), np.ones(agents)])
    frames = draw_frames(agents, 20.0, 0.01, 0.02, rng)
    return Formation(start, shapes, frames, supervision=BRIEF, **other)


def frames_of(mission, seed=1):
    return list(simulate(mission, np.random.default_rng(seed)))


def error(frame, mission):
    holder = np.argsort(frame.point)
    return compute_shape_error(frame.position[holder], mission.gains[frame.leg_index].formation.points)


def told(frames, kind=None):
    events = [event for frame in frames for event in frame.events]
    return events if kind is None else [e for e in events if e["kind"] == kind]


@pytest.mark.parametrize("kind", ["vsdaa", "cbaa", "hungarian"])
def test_a_swarm_takes_up_one_shape_after_another_in_frames_of_its_own(kind):
    mission = flight(some(0), some(1), assigning=AssignmentSettings(kind))
    frames = frames_of(mission)
    assert frames[-1].phase is Phase.COMPLETED and frames[-1].leg_index == 1
    for leg in (0, 1):
        found = error([f for f in frames if f.leg_index == leg][-1], mission)
        assert found.error <= 0.1 and not found.inverted
    assert frames[-1].min_separation.min() >= mission.avoidance.keep_out - 0.05
    assert np.linalg.norm(frames[-1].frame_drift, axis=1).min() > 0.01  # some metres were flown


@pytest.mark.parametrize("seed", range(3))
def test_with_lost_and_late_messages_it_still_does(seed):
    radio = Radio(loss_probability=0.2, delay=0.1)
    mission = flight(some(seed), seed=seed, radio=radio, assigning=AssignmentSettings("cbaa"))
    frames = frames_of(mission)
    assert frames[-1].phase is Phase.COMPLETED
    assert error(frames[-1], mission).error <= 0.1


def test_the_same_seed_gives_the_same_flight_and_another_one_another():
    mission = flight(
        some(2), radio=Radio(loss_probability=0.1), assigning=AssignmentSettings("cbaa")
    )
    one, again, other = frames_of(mission), frames_of(mission), frames_of(mission, seed=2)
    assert len(one) == len(again)
    for a, b in zip(one, again, strict=True):
        assert np.array_equal(a.position, b.position) and np.array_equal(a.frame_drift, b.frame_drift)
        assert a.events == b.events and a.phase is b.phase
    assert not np.array_equal(one[-1].position, other[-1].position)


@pytest.mark.parametrize("every", [1, 5])
def test_frames_come_in_step_and_positions_are_what_velocities_add_up_to(every):
    mission = replace(flight(some(3)), every=every)
    frames = frames_of(mission)
    time = np.array([f.time for f in frames])
    assert time == pytest.approx(np.arange(len(frames)) * every * mission.control_step)
    if every == 1:
        for last, now in pairwise(frames):
            step = mission.control_step * now.velocity
            assert now.position - last.position == pytest.approx(step, abs=1e-12)


def test_the_formation_follows_who_is_pushed_and_keeps_its_shape():
    push = OperatorCommand(agent=2, start=42.0, end=52.0, velocity=np.array([0.2, 0.1, 0.0]))
    mission = flight(some(4), pushes=(push,))
    mission = replace(
        mission, protocol=SupervisorSettings(hover_time=25.0)
    )  # and go on holding the shape
    frames = frames_of(mission)
    moments = {round(f.time, 2): f for f in frames}
    before, during, after = (moments[t] for t in (41.9, 51.9, round(frames[-1].time, 2)))
    assert before.phase is Phase.COMPLETED and after.time > 57
    way = mission.coordinate_frames.rotation[2] * (0.2 + 0.1j)
    assert during.velocity[2] == pytest.approx([way.real, way.imag, 0])
    centre = (during.position - before.position).mean(axis=0)
    # It drags all others along, though not as fast as it is pushed itself.
    along = centre[0] * way.real + centre[1] * way.imag
    assert along > 0.2 * abs(way) ** 2 * 9.9
    assert np.linalg.norm(during.position - before.position, axis=1).min() > 0.2
    assert error(after, mission).error <= 0.1
    assert np.linalg.norm(after.velocity[:, :2], axis=1).max() < 0.1


def test_before_the_first_assignment_all_hover():
    mission = flight(some(5))
    frames = frames_of(mission)
    first = next(
        i for i, f in enumerate(frames) if any(e["kind"] == "assignment" for e in f.events)
    )
    # The assignment shows in the frame after the step that it begins with, as soon as the
    # messages of the auction have gone round.
    rounds = next(e["rounds"] for e in frames[first].events if e["kind"] == "assignment")
    known = 1.0 + mission.assignment.first_delay + rounds / mission.radio.message_rate
    assert frames[first - 1].time == pytest.approx(known)
    for frame in frames[:first]:
        assert not frame.velocity_command.any() and frame.phase is Phase.WAITING
    assert frames[first].phase is Phase.FLYING


def test_events_tell_the_legs_in_order_and_who_has_another_point():
    mission = flight(some(6), some(7))
    frames = frames_of(mission)
    kinds = [e["kind"] for e in told(frames) if e["kind"].startswith("leg")]
    assert kinds == ["leg_start", "leg_end", "leg_start", "leg_end"]
    point = np.arange(8)
    for frame in frames:
        for event in frame.events:
            if event["kind"] == "leg_start":
                point = np.arange(8)
            if event["kind"] == "assignment":
                changed = np.flatnonzero(point != event["point"])
                assert changed.tolist() == event["agents"]
                point = np.array(event["point"])
                assert np.array_equal(frame.point_index, point)


def stuck(kind):
    """From a prism in order to a pyramid, where vehicles must pass through each other."""
    start = load_formation("Triangular Prism").points * [1, 1, 0] + [0, 0, 1]
    mission = legacy_formation(start, (gains("Pentagonal Pyramid"),), kind)
    return replace(
        mission, supervision=mission.supervision._replace(gridlock_timeout=5.0, hover_time=1.0)
    )


def test_without_assignment_the_pyramid_ends_in_a_gridlock():
    mission = stuck("none")
    frames = frames_of(mission)
    (gridlock,) = told(frames, "gridlock")
    assert len(gridlock["agents"]) >= 2
    assert frames[-1].phase is Phase.ABORTED
    assert frames[-1].events[-1]["kind"] == "given_up"
    shown = [f.time for f in frames if f.phase is Phase.GRIDLOCKED]
    assert shown[-1] - shown[0] == pytest.approx(5.0, abs=0.05)
    assert not told(frames, "leg_end")


def test_with_assignment_it_does_not():
    frames = frames_of(stuck("cbaa"))
    assert frames[-1].phase is Phase.COMPLETED
    assert len(told(frames, "leg_end")) == 1


def test_who_has_no_more_time_gives_up():
    mission = replace(flight(some(8)), protocol=SupervisorSettings(hover_time=1.0, time_limit=4.0))
    frames = frames_of(mission)
    assert frames[-1].time == pytest.approx(4.0)
    assert frames[-1].events[-1]["kind"] == "given_up"
    assert frames[-1].phase is not Phase.COMPLETED


def test_a_gridlock_that_passes_has_an_end():
    mission = flight(*[gains(n) for n in ("Pentagonal Pyramid", "Triangular Prism")], seed=3)
    frames = frames_of(mission)
    assert frames[-1].phase is Phase.COMPLETED
    kinds = [e["kind"] for e in told(frames) if e["kind"].startswith("gridlock")]
    assert kinds == ["gridlock", "gridlock_end"] * (len(kinds) // 2)
    assert kinds


def test_a_flight_that_cannot_be_is_refused():
    shape = gains("Pentagonal Pyramid")
    with pytest.raises(ValueError, match="5 vehicles cannot take up a shape of 6 points"):
        Formation(np.zeros((5, 3)), (shape,), aligned_frames(5))
    near = DesiredFormation.with_complete_graph(np.array([[0.0, 0, 0], [1, 0, 5], [5, 5, 0]]))
    with pytest.raises(ValueError, match=r"1 m apart in the plane, nearer than the keep-out"):
        Formation(np.zeros((3, 3)), (design_gains(near),), aligned_frames(3))
