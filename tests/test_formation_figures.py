"""Figures of formation flights: what is drawn is what was flown."""

from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise

import numpy as np
import pytest
from formation_runs import dataset
from matplotlib.collections import EllipseCollection, LineCollection
from pictures import check_layout, draw, line
from scipy.spatial.distance import pdist

from problems.alignment import Pose, compute_shape_error
from problems.gain_design import design_gains
from sato.formation.check.recorded import FormationRecord
from sato.formation.figures import AUCTION_FIGURES, FIGURES, make_figures
from sato.formation.figures.time_series import VEHICLE_DIAMETER, is_leg_active, phase_spans
from sato.formation.figures.trajectories import SHOWN_TIME
from sato.formation.leg import FormationLeg
from sato.formation.loop import simulate
from sato.formation.mission import Formation
from sato.formation.settings import AssignmentSettings, FrameSettings, SupervisorSettings
from sato.formation.supervisor import Phase

LINE = np.array([[3.0 * i, 0.0, 1.0] for i in range(6)])


def three_legs():
    """Six agents in random frames: a pyramid, a flat hexagon and the pyramid again."""
    legs = [FormationLeg(name, "own") for name in ("Pentagonal Pyramid", "Hex")]
    return Formation(
        start=LINE,
        legs=[*legs, legs[0]],
        frames=FrameSettings(offset=3.0, noise=0.01),
        supervision=SupervisorSettings(hover_time=1.0),
    ).draw(np.random.default_rng(3))


def flat(**changed):
    """One flat leg, without a name and without auctions."""
    points = LINE[:4, [1, 0, 2]] * [1, 1, 0] + [[1, 0, 0]]
    settings = {"supervision": SupervisorSettings(hover_time=0.5)} | changed
    return Formation(
        start=LINE[:4],
        legs=[FormationLeg(points)],
        frames=FrameSettings("aligned", 0.0, 0.0, 0.0),
        assignment=AssignmentSettings("none"),
        **settings,
    ).draw(np.random.default_rng(3))


def swap():
    """Four agents at the corners of a square, two of which change places across it."""
    square = np.array([[0.0, 0, 1], [2.5, 0, 1], [2.5, 2.5, 1], [0, 2.5, 1]])
    return Formation(
        start=square,
        legs=[FormationLeg(square[[2, 1, 0, 3]])],
        frames=FrameSettings("aligned", 0.0, 0.0, 0.0),
        assignment=AssignmentSettings("none"),
    ).draw(np.random.default_rng(0))


def fly(mission):
    return list(simulate(mission, np.random.default_rng(7)))


def record_of(mission, frames):
    return FormationRecord.from_data(dataset(mission, frames), mission)


@cache
def flown(name):
    make, count = RUNS[name]
    mission = make()
    return record_of(mission, fly(mission)[:count])


# Mission, and the number of instants that are recorded; all without one.
RUNS = {
    "three legs": (three_legs, None),
    "flat": (flat, None),
    "interrupted": (three_legs, 300),
    "only the start": (flat, 1),
    "swap": (swap, None),
}
ALL = FIGURES | AUCTION_FIGURES


@cache
def drawn(name, run="three legs"):
    return draw(ALL[name], flown(run))


@pytest.fixture(scope="module")
def legs():
    return flown("three legs")


@pytest.mark.parametrize("run", [run for run in RUNS if run != "swap"])
@pytest.mark.parametrize("name", ALL)
def test_text_stays_in_the_figure_and_does_not_overlap(name, run):
    check_layout(drawn(name, run))


@pytest.mark.parametrize(("run", "names"), [("three legs", ALL), ("flat", FIGURES)])
def test_auctions_are_drawn_only_where_there_are_any(run, names):
    mission = flown(run).mission
    assert list(make_figures(dataset(mission, fly(mission)[:3]), mission)) == list(names)


def discs(ax):
    [found] = [c for c in ax.collections if isinstance(c, EllipseCollection)]
    return found


def test_moved_formation_is_drawn_in_its_own_axes():
    mission = flat()
    points = mission.gains[0].formation.points
    there = Pose(1.1, np.array([5.0, -7.0, 3.0])).transform(points)
    frames = [frame._replace(position=there) for frame in fly(mission)[:100]]
    [ax] = draw(ALL["traces"], record_of(mission, frames)).axes
    np.testing.assert_allclose(discs(ax).get_offsets(), points[:, :2], atol=1e-9)
    assert ax.get_title() == "(a) leg 1\nnot converged, 0.000 m off, turned by 63°"


def test_vehicles_are_drawn_to_scale_at_their_relative_positions(legs):
    figure = drawn("traces")
    tops = [ax for ax in figure.axes if ax.get_title()]
    assert len(figure.axes) == 6 and len(tops) == 3
    for ax, leg in zip(tops, legs.replay.legs, strict=True):
        position = legs.frames.position[leg.last_instant, :, :2]
        np.testing.assert_allclose(pdist(discs(ax).get_offsets()), pdist(position), rtol=1e-9)
        assert (discs(ax).get_widths() == VEHICLE_DIAMETER).all()
        assert ax.get_aspect() == 1
    assert len({round(float(np.ptp(ax.get_xlim())), 9) for ax in figure.axes}) == 1


def test_traces_cover_the_last_forty_seconds():
    mission = flat(supervision=SupervisorSettings(hover_time=60.0))
    record = record_of(mission, fly(mission))
    [leg] = record.replay.legs
    [ax] = draw(ALL["traces"], record).axes
    [paths] = [c for c in ax.collections if isinstance(c, LineCollection) and c.get_zorder() == 2]
    pieces = np.array(paths.get_segments())
    np.testing.assert_allclose(pieces[-4:, 1], discs(ax).get_offsets(), atol=1e-9)
    first = np.searchsorted(record.time, record.time[leg.last_instant] - SHOWN_TIME)
    start = record.frames.position[first, :, :2]
    np.testing.assert_allclose(pdist(pieces[:4, 0]), pdist(start), rtol=1e-9)


def test_changed_assignments_under_way_are_marked_with_rings():
    mission = flat()
    frames = fly(mission)
    k = len(frames) // 2
    swapped = [f._replace(point_index=f.point_index[[1, 0, 2, 3]]) for f in frames[k:]]
    record = record_of(mission, frames[:k] + swapped)
    [ax] = draw(ALL["traces"], record).axes
    [rings] = [line for line in ax.lines if line.get_marker() == "o"]
    distance = np.hypot(*np.diff(rings.get_xydata(), axis=0)[0])
    assert len(rings.get_xydata()) == 2
    assert distance == pytest.approx(pdist(record.frames.position[k, :2, :2])[0])


def test_many_legs_are_named_by_their_numbers():
    mission = flat()
    mission = replace(mission, legs=mission.legs * 8)
    record = record_of(mission, fly(mission))
    [ax] = draw(ALL["separation"], record).axes
    assert [t.get_text() for t in ax.texts[-8:]] == list("12345678")


def test_drawn_shape_error_is_that_of_the_held_points(legs):
    error, avoid = drawn("convergence").axes
    time, found = line(error, "shape error")
    for k in np.linspace(0, len(time) - 1, 7).astype(int):
        i = int(np.argmin(np.abs(legs.time - time[k])))
        points = legs.mission.gains[legs.leg_index[i]].formation.points
        holder = np.argsort(legs.frames.point_index[i])
        expected = compute_shape_error(legs.frames.position[i][holder], points).error
        assert found[k] == pytest.approx(expected)
    marks, _ = line(error, "points are assigned")
    assert marks.tolist() == [e["time"] for _, e in legs.events.of_kind("assignment")]
    share = 100 * legs.frames.avoiding.mean(axis=1)
    np.testing.assert_allclose(avoid.lines[0].get_ydata(), share)


def test_phase_spans_cover_the_flight_without_gaps(legs):
    found = phase_spans(legs)
    assert found[0].start == 0 and found[-1].end == legs.time[-1]
    for before, after in pairwise(found):
        assert before.end == after.start and before.value != after.value
    phases = [span.value for span in found]
    assert phases[0] is Phase.WAITING and phases[-1] is Phase.COMPLETED
    assert phases.count(Phase.COMPLETED) == 3
    waits = [phase is Phase.WAITING for phase in legs.replay.phase]
    np.testing.assert_array_equal(~is_leg_active(legs), waits)


def test_gridlock_is_shaded_where_all_that_have_to_move_are_stopped():
    record = flown("swap")
    frames, mission = record.frames, record.mission
    phases = np.array([phase is Phase.GRIDLOCKED for phase in record.replay.phase])
    window = round(mission.supervision.averaging_window / mission.frame_period)
    command = np.linalg.norm(frames.velocity_command, axis=2)
    is_slow = np.hypot(*np.moveaxis(frames.velocity[..., :2], -1, 0)) < 0.2 * mission.max_speed
    stopped = frames.avoiding & is_slow
    stuck, share = np.flatnonzero(phases), mission.supervision.gridlock_share
    assert len(stuck) > window
    for k in stuck:
        recent = slice(k - window + 1, k + 1)
        has_arrived = command[recent].mean(axis=0) < mission.supervision.convergence_speed
        assert (has_arrived | (stopped[recent].mean(axis=0) > share)).all()
        assert not has_arrived.all()
    spans = [span for span in phase_spans(record) if span.value is Phase.GRIDLOCKED]
    assert sum(span.end - span.start for span in spans) == pytest.approx(
        phases.sum() * mission.frame_period, abs=0.021 * len(spans)
    )


def test_a_crowd_that_avoids_and_goes_on_is_no_gridlock(legs):
    assert legs.frames.avoiding.any()
    for run, expected in (("three legs", False), ("swap", True)):
        [legend] = drawn("convergence", run).legends
        assert ("gridlock" in [text.get_text() for text in legend.get_texts()]) == expected


def test_drawn_speeds_are_medians_with_their_limits(legs):
    wanted, plane, climb = drawn("speeds").axes
    frames, mission = legs.frames, legs.mission
    command = np.linalg.norm(frames.velocity_command, axis=2)
    moves = command.min(axis=1) > 0
    _, median = line(wanted, "median")
    np.testing.assert_allclose(median[moves], np.median(command[moves], axis=1))
    assert np.isnan(median[~moves]).all()
    planar = np.linalg.norm(frames.velocity[..., :2], axis=2)
    for ax, speed in ((plane, planar), (climb, np.abs(frames.velocity[..., 2]))):
        _, median = line(ax, "median")
        np.testing.assert_allclose(median, np.median(speed, axis=1))
    dashed = [[line for line in ax.lines if line.get_ls() == "--"] for ax in (wanted, plane, climb)]
    levels = [limit.get_ydata()[0] for [limit] in dashed]
    arrived = mission.supervision.convergence_speed
    assert levels == [arrived, mission.max_speed, mission.max_climb]


def test_drawn_separation_is_the_least_distance_in_the_plane(legs):
    [ax] = drawn("separation").axes
    _, least = line(ax, "least distance in the plane")
    brute = [
        min(np.hypot(*(p[i] - p[j])[:2]) for i, j in combinations(range(6), 2))
        for p in legs.frames.position[::50]
    ]
    np.testing.assert_allclose(least[::50], brute)
    [label] = [line.get_label() for line in ax.lines if "least of all" in str(line.get_label())]
    assert label == f"least of all: {legs.closest_approach.distance:.3f} m"


def test_gains_are_drawn_once_a_formation_on_its_edges_alone(legs):
    figure = drawn("gains")
    images = [ax.images[0].get_array() for ax in figure.axes if ax.images]
    different = legs.mission.gains[:2]
    assert len(images) == 2 * len(different)
    for number, gains in enumerate(different):
        graph = gains.formation.graph
        for image, A in zip(images[2 * number : 2 * number + 2], (gains.xy, gains.z), strict=True):
            np.testing.assert_array_equal(image.mask, ~graph)
            np.testing.assert_allclose(image[graph], np.abs(A)[graph])


def test_gains_have_the_bound_of_their_trace_and_of_any_shares(legs):
    # Of the pyramid, whose directions differ most.
    graph, plane, vertical = drawn("gains").axes[:3]
    found = design_gains(legs.mission.gains[0].formation, joint=True)
    assert graph.get_title().split("\n")[2] == "rate 0.296/s, jointly ≤ 0.350/s"
    assert found.convergence_rate == pytest.approx(0.350, abs=5e-4)
    assert plane.get_title().split("\n")[1:] == ["rate 0.296/s", "at this trace ≤ 0.296/s"]
    assert vertical.get_title().split("\n")[1:] == ["rate 0.553/s", "at this trace ≤ 0.553/s"]


def test_frames_and_drift_of_every_agent_are_drawn(legs):
    poses, drift = drawn("frames").axes
    far = np.array([line.get_ydata() for line in drift.lines[:6]]).T
    np.testing.assert_allclose(far, 100 * np.linalg.norm(legs.frames.frame_drift, axis=2))
    x_axes = [line.get_xydata() for line in poses.lines[1:7]]
    direction = np.array([end - begin for begin, end in x_axes]) @ [1, 1j]
    rotation = legs.mission.coordinate_frames.rotation
    np.testing.assert_allclose(direction / np.abs(direction), rotation, atol=1e-9)


def test_every_auction_is_drawn_with_its_rounds_and_bits(legs):
    took, rounds = drawn("assignments").axes
    auctions = [e for _, e in legs.events.of_kind("auction")]
    assert rounds.lines[0].get_xydata().tolist() == [[e["time"], e["rounds"]] for e in auctions]
    assert len(took.lines[0].get_xydata()) == len(legs.events.of_kind("assignment"))
    [bits] = rounds.child_axes
    top = bits.get_ylim()[1] / rounds.get_ylim()[1]
    assert top == pytest.approx(legs.mission.radio.count_auction_bits(6, 1) / 1000)
