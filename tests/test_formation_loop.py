"""Whole flights of small swarms: convergence in own frames, poor radio, events, gridlock."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sato
from problems.alignment import compute_shape_error
from sato.formation.leg import FormationLeg, SparseGraph
from sato.formation.loop import simulate
from sato.formation.mission import Formation, legacy_formation
from sato.formation.settings import (
    AssignmentSettings,
    FrameSettings,
    OperatorCommand,
    SupervisorSettings,
)
from sato.formation.supervisor import Phase
from sato.network.link import Link
from sato.network.radio import Radio
from sato.shapes.formation_library import load_formation
from sato.shapes.random_points import sample_formation, sample_positions

N = 8
BRIEF = SupervisorSettings(hover_time=1.0)


@cache
def leg(seed):
    """Draw a random formation, once with its gains."""
    rng = np.random.default_rng(seed)
    points = sample_formation(N, (8.0, 8.0, 2.0), 2.0, rng)
    return FormationLeg(points, SparseGraph(0.7)).draw(N, 1.2, rng)


def mission(*legs, seed=0, **changed):
    """Draw a flight from a random start, in random frames that drift, with noise."""
    rng = np.random.default_rng(seed)
    if not legs or isinstance(legs[0], int):
        legs = [leg(number) for number in legs]
    agents = N if isinstance(legs[0].formation, str) else len(legs[0].formation.positions)
    start = np.column_stack([sample_positions(agents, (8.0, 8.0), 1.6, rng), np.ones(agents)])
    settings = {"supervision": BRIEF, "frames": FrameSettings(offset=20.0)} | changed
    return Formation(start=start, legs=legs, **settings).draw(rng)


def fly(mission, seed=1):
    return list(simulate(mission, np.random.default_rng(seed)))


def shape_error(frame, mission):
    points = mission.gains[frame.leg_index].formation.points
    return compute_shape_error(frame.position[np.argsort(frame.point_index)], points)


def events(frames, *kinds):
    return [e for frame in frames for e in frame.events if e["kind"] in kinds]


@pytest.mark.parametrize("method", ["vsdaa", "cbaa", "hungarian"])
def test_swarm_takes_up_formations_in_turn_in_frames_of_its_own(method):
    flight = mission(0, 1, assignment=AssignmentSettings(method))
    frames = fly(flight)
    assert frames[-1].phase is Phase.COMPLETED and frames[-1].leg_index == 1
    for number in (0, 1):
        found = shape_error([f for f in frames if f.leg_index == number][-1], flight)
        assert found.error <= 0.1 and not found.inverted
    assert np.linalg.norm(frames[-1].frame_drift, axis=1).min() > 0.01  # after some meters


@pytest.mark.parametrize("seed", range(3))
def test_swarm_converges_with_lost_and_late_messages(seed):
    radio = Radio(loss_probability=0.2, delay=0.1)
    flight = mission(seed, seed=seed, radio=radio, assignment=AssignmentSettings("cbaa"))
    frames = fly(flight)
    assert frames[-1].phase is Phase.COMPLETED
    assert shape_error(frames[-1], flight).error <= 0.1


@pytest.mark.parametrize("seed", range(2))
def test_swarm_converges_where_links_are_down_half_of_the_time(seed):
    link = Link(loss_probability=0.1, outage=0.1, outage_share=0.5)
    flight = mission(seed, seed=seed, link=link, assignment=AssignmentSettings("cbaa"))
    frames = fly(flight)
    assert frames[-1].phase is Phase.COMPLETED
    assert shape_error(frames[-1], flight).error <= 0.1
    without = fly(replace(flight, link=Link(loss_probability=0.1)))
    assert not np.array_equal(frames[-1].position, without[-1].position)


def test_faults_of_the_link_are_those_of_the_radio():
    settings = AssignmentSettings("cbaa")
    same = {"radio": Radio(loss_probability=0.2, delay=0.1)}, {"link": Link(1, 5, 0.2)}
    one, other = (fly(mission(0, assignment=settings, **faults)) for faults in same)
    assert len(one) == len(other)
    assert np.array_equal(one[-1].position, other[-1].position)


def test_same_seed_gives_the_same_flight():
    flight = mission(2, radio=Radio(loss_probability=0.1), assignment=AssignmentSettings("cbaa"))
    one, again, other = fly(flight), fly(flight), fly(flight, seed=2)
    assert len(one) == len(again)
    for a, b in zip(one, again, strict=True):
        assert np.array_equal(a.position, b.position)
        assert np.array_equal(a.frame_drift, b.frame_drift)
        assert a.events == b.events and a.phase is b.phase
    assert not np.array_equal(one[-1].position, other[-1].position)


def test_formation_follows_a_commanded_agent_and_keeps_its_shape():
    command = OperatorCommand(2, 42.0, 52.0, (0.2, 0.1, 0.0))
    hover = SupervisorSettings(hover_time=25.0)  # the command comes while they hold the formation
    flight = mission(4, operator_commands=[command], supervision=hover)
    frames = fly(flight)
    by_time = {round(f.time, 2): f for f in frames}
    before, during, after = (by_time[t] for t in (41.9, 51.9, round(frames[-1].time, 2)))
    assert before.phase is Phase.COMPLETED and after.time > 57
    velocity = flight.coordinate_frames.rotation[2] * (0.2 + 0.1j)
    assert during.velocity[2] == pytest.approx([velocity.real, velocity.imag, 0])
    moved = during.position - before.position
    # It takes all others along, though not as fast as it is moved itself.
    along = moved.mean(axis=0) @ [velocity.real, velocity.imag, 0]
    assert along > 0.2 * abs(velocity) ** 2 * 9.9
    assert np.linalg.norm(moved, axis=1).min() > 0.2
    assert shape_error(after, flight).error <= 0.1
    assert np.linalg.norm(after.velocity[:, :2], axis=1).max() < 0.1


def test_agents_hover_until_the_first_assignment_is_known():
    flight = mission(5)
    frames = fly(flight)
    first = next(i for i, f in enumerate(frames) if events([f], "assignment"))
    # The assignment is in the frame after the step that begins with it, which is when the
    # messages of the auction have been exchanged.
    [event] = events([frames[first]], "assignment")
    known = 1.0 + flight.assignment.first_delay + event["rounds"] / flight.radio.message_rate
    assert frames[first - 1].time == pytest.approx(known)
    for frame in frames[:first]:
        assert not frame.velocity_command.any() and frame.phase is Phase.WAITING
    assert frames[first].phase is Phase.FLYING


def legacy_pyramid(method):
    """From a prism in order to a pyramid, where agents must pass through each other."""
    start = load_formation("Triangular Prism").points * [1, 1, 0] + [0, 0, 1]
    settings = SupervisorSettings(convergence_speed=1.0, gridlock_timeout=5.0, hover_time=1.0)
    pyramid = [FormationLeg("Pentagonal Pyramid", "own")]
    rng = np.random.default_rng(0)
    return legacy_formation(
        start, pyramid, assignment=AssignmentSettings(method), supervision=settings
    ).draw(rng)


def test_legacy_swarm_without_assignment_ends_in_a_gridlock():
    frames = fly(legacy_pyramid("none"))
    (gridlock,) = events(frames, "gridlock")
    assert len(gridlock["agents"]) >= 2
    assert frames[-1].phase is Phase.ABORTED
    assert frames[-1].events[-1]["kind"] == "given_up"
    times = [f.time for f in frames if f.phase is Phase.GRIDLOCKED]
    assert times[-1] - times[0] == pytest.approx(5.0, abs=0.05)
    assert not events(frames, "leg_end")


@pytest.mark.parametrize("method", ["cbaa", "hungarian"])
def test_legacy_swarm_with_assignment_completes(method):
    frames = fly(legacy_pyramid(method))
    assert frames[-1].phase is Phase.COMPLETED
    assert len(events(frames, "leg_end")) == 1


def test_resolved_gridlock_has_a_start_and_an_end():
    frames = fly(legacy_pyramid("cbaa"))
    assert frames[-1].phase is Phase.COMPLETED
    kinds = [e["kind"] for e in events(frames, "gridlock", "gridlock_end")]
    assert kinds == ["gridlock", "gridlock_end"] * (len(kinds) // 2)
    assert kinds


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_vehicles_that_change_places_on_a_ring_arrive_without_an_auction(noise):
    angle = 2 * np.pi * np.arange(10) / 10
    ring = 2.4 * 10 / (2 * np.pi) * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    leg = FormationLeg(ring[np.random.default_rng(1).permutation(10)])
    given, sensors = AssignmentSettings("none"), FrameSettings(noise=noise, drift=0.0)
    flown = sato.run(Formation(start=ring, legs=[leg], assignment=given, frames=sensors))
    assert flown.summary["success"]
    assert flown.summary["min_separation_m"] >= (1.15 if noise else 1.2)
