"""Figures of formation flying: they show what the data hold, and all of it can be read."""

from dataclasses import replace
from itertools import combinations, pairwise

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection, LineCollection
from pictures import words_inside
from recorded_run import record_run
from scipy.spatial.distance import pdist

from problems.alignment import Pose
from problems.desired_formation import DesiredFormation
from problems.gain_design import design_gains
from sato.figures.style import STYLE
from sato.formation import (
    AssignmentSettings,
    Formation,
    SupervisorSettings,
    aligned_frames,
    draw_frames,
    simulate,
)
from sato.formation.check import FormationRecord
from sato.formation.figures import AUCTION_FIGURES, FIGURES, make_figures
from sato.formation.figures.phases import is_leg_active, phase_spans, subsample
from sato.formation.figures.trajectories import SHOWN_TIME, VEHICLE_DIAMETER
from sato.formation.shape_error import compute_shape_error
from sato.formation.supervisor import Phase
from sato.formation.system import SYSTEM
from sato.shapes.formation_library import load_formation

LINE = np.array([[3.0 * i, 0.0, 1.0] for i in range(6)])


def recorded(mission, frames):
    return FormationRecord.from_dataset(record_run(SYSTEM, frames, mission).data, mission)


def three_legs():
    """Six vehicles in frames of their own: a pyramid, a flat hexagon and the pyramid again."""
    pyramid = design_gains(load_formation("Pentagonal Pyramid"))
    shapes = (pyramid, design_gains(load_formation("Hex")), pyramid)
    frames = draw_frames(6, 3.0, 0.01, 0.01, np.random.default_rng(3))
    return Formation(
        LINE, shapes, frames, supervision=SupervisorSettings(hover_time=1.0), steps_per_frame=5
    )


def flat():
    """One leg, without a name, without auctions, and flat."""
    shape = design_gains(
        DesiredFormation.with_complete_graph(LINE[:4, [1, 0, 2]] * [1, 1, 0] + [[1, 0, 0]])
    )
    return Formation(
        LINE[:4],
        (shape,),
        aligned_frames(4),
        assignment=AssignmentSettings("none"),
        supervision=SupervisorSettings(hover_time=0.5),
        steps_per_frame=5,
    )


def flown(mission, count=None):
    frames = list(simulate(mission, np.random.default_rng(7)))
    return recorded(mission, frames[:count])


RUNS = {
    "three legs": lambda: flown(three_legs()),
    "flat": lambda: flown(flat()),
    "stopped under way": lambda: flown(three_legs(), 60),
    "only the start": lambda: flown(flat(), 1),
}
ALL = FIGURES | AUCTION_FIGURES


@pytest.fixture(scope="module", params=RUNS)
def evidence(request):
    return RUNS[request.param]()


@pytest.fixture(scope="module")
def legs():
    return flown(three_legs())


def drawn(name, evidence):
    with matplotlib.rc_context(STYLE):
        figure = ALL[name](evidence)
        FigureCanvasAgg(figure).draw()
    return figure


@pytest.mark.parametrize("name", ALL)
def test_no_words_run_out_of_the_picture_or_over_one_another(evidence, name):
    figure = drawn(name, evidence)
    boxes = words_inside(figure)
    renderer = figure.canvas.get_renderer()
    titles = [ax.title.get_window_extent(renderer) for ax in figure.axes if ax.get_title()]
    legs = [box for text, box in boxes if text.startswith("leg ")]
    for one, other in [*combinations(titles, 2), *combinations(legs, 2)]:
        assert not one.overlaps(other)


def test_auctions_are_drawn_only_where_there_are_any():
    for mission in (three_legs(), flat()):
        frames = list(simulate(mission, np.random.default_rng(7)))[:3]
        data = record_run(SYSTEM, frames, mission).data
        auctions = mission.assignment.method != "none"
        assert set(make_figures(data, mission)) == set(ALL if auctions else FIGURES)


def discs(ax):
    [found] = [c for c in ax.collections if isinstance(c, EllipseCollection)]
    return found


def test_a_shape_that_was_turned_and_moved_is_drawn_as_it_is_in_its_file():
    mission = flat()
    shape = mission.gains[0].formation.points
    there = Pose(1.1, np.array([5.0, -7.0, 3.0])).transform(shape)
    frames = [
        f._replace(position=there) for f in list(simulate(mission, np.random.default_rng(7)))[:20]
    ]
    [ax] = drawn("traces", recorded(mission, frames)).axes
    np.testing.assert_allclose(discs(ax).get_offsets(), shape[:, :2], atol=1e-9)
    assert ax.get_title() == "(a) leg 1\nnot settled, 0.000 m off, turned by 63°"


def test_vehicles_are_drawn_to_scale_and_where_they_are_beside_one_another(legs):
    figure = drawn("traces", legs)
    tops = figure.axes[0::2]
    assert len(figure.axes) == 6 and len(tops) == 3
    for ax, stretch in zip(tops, legs.replay.stretches, strict=True):
        there = discs(ax).get_offsets()
        np.testing.assert_allclose(
            pdist(there), pdist(legs.position[stretch.last, :, :2]), rtol=1e-9
        )
        assert (discs(ax).get_widths() == VEHICLE_DIAMETER).all()
        assert ax.get_aspect() == 1
    assert len({round(float(np.ptp(ax.get_xlim())), 9) for ax in figure.axes}) == 1


def test_traces_are_of_the_last_forty_seconds_and_end_in_the_vehicles():
    mission = replace(flat(), supervision=SupervisorSettings(hover_time=60.0))
    evidence = flown(mission)
    [stretch] = evidence.replay.legs
    [ax] = drawn("traces", evidence).axes
    [paths] = [c for c in ax.collections if isinstance(c, LineCollection) and c.get_zorder() == 2]
    pieces = np.array(paths.get_segments())
    ends = pieces[-4:, 1]
    np.testing.assert_allclose(ends, discs(ax).get_offsets(), atol=1e-9)
    start = evidence.position[
        np.searchsorted(evidence.time, evidence.time[stretch.last_instant] - SHOWN_TIME)
    ]
    np.testing.assert_allclose(pdist(pieces[:4, 0]), pdist(start[:, :2]), rtol=1e-9)


def test_where_somebody_under_way_took_another_point_there_is_a_ring():
    mission = flat()
    frames = list(simulate(mission, np.random.default_rng(7)))
    k = len(frames) // 2
    swapped = [f._replace(assignment=f.point_index[[1, 0, 2, 3]]) for f in frames[k:]]
    evidence = recorded(mission, frames[:k] + swapped)
    [ax] = drawn("traces", evidence).axes
    [rings] = [line for line in ax.lines if line.get_marker() == "o"]
    apart = np.hypot(*np.diff(rings.get_xydata(), axis=0)[0])
    assert len(rings.get_xydata()) == 2
    assert apart == pytest.approx(pdist(evidence.position[k, :2, :2])[0])


def test_of_many_legs_only_the_numbers_are_told():
    mission = flat()
    evidence = flown(replace(mission, gains=mission.gains * 8))
    [ax] = drawn("separation", evidence).axes
    assert [t.get_text() for t in ax.texts[-8:]] == list("12345678")


def test_error_of_shape_is_that_of_the_point_everybody_holds(legs):
    error, avoid = drawn("convergence", legs).axes
    time, off = _line(error, "error of shape")
    for k in np.linspace(0, len(time) - 1, 7).astype(int):
        i = int(np.argmin(np.abs(legs.time - time[k])))
        shape = legs.mission.gains[legs.leg[i]].formation.points
        holder = np.argsort(legs.assignment[i])
        assert off[k] == pytest.approx(compute_shape_error(legs.position[i][holder], shape).error)
    marks, _ = _line(error, "points are taken")
    assert marks.tolist() == [e["time"] for _, e in legs.events.told("assignment")]
    share = avoid.lines[-1].get_ydata()
    np.testing.assert_allclose(share, 100 * legs.avoiding.mean(axis=1))


def _line(ax, label):
    [line] = [line for line in ax.lines if line.get_label() == label]
    return line.get_xydata().T


def test_spans_follow_one_another_and_say_what_the_watcher_saw(legs):
    found = phase_spans(legs)
    assert found[0].start == 0 and found[-1].end == legs.time[-1]
    for before, after in pairwise(found):
        assert before.end == after.start and before.label != after.label
    words = [span.label for span in found]
    assert words[0] == "waiting" and words[-1] == "settled"
    assert words.count("settled") == 3
    waits = [phase is Phase.WAITING for phase in legs.replay.phase]
    np.testing.assert_array_equal(~is_leg_active(legs), waits)


def test_speeds_are_those_commanded_and_flown(legs):
    wanted, plane, climb = drawn("speeds", legs).axes
    moves = np.linalg.norm(legs.command, axis=2).min(axis=1) > 0
    _, median = _line(wanted, "median")
    np.testing.assert_allclose(
        median[moves], np.median(np.linalg.norm(legs.command[moves], axis=2), axis=1)
    )
    assert np.isnan(median[~moves]).all()
    _, median = _line(plane, "median")
    flat_speed = np.linalg.norm(legs.velocity[..., :2], axis=2)
    np.testing.assert_allclose(median, np.median(flat_speed, axis=1))
    _, median = _line(climb, "median")
    np.testing.assert_allclose(median, np.median(np.abs(legs.velocity[..., 2]), axis=1))
    levels = [ax.lines[-1].get_ydata()[0] for ax in (wanted, plane, climb)]
    limits = legs.mission.limits
    assert levels == [legs.mission.protocol.settled, limits.speed, limits.climb]


def test_separation_is_the_least_in_the_plane(legs):
    [ax] = drawn("separation", legs).axes
    _, least = _line(ax, "least distance in the plane")
    brute = [
        min(np.hypot(*(p[i] - p[j])[:2]) for i, j in combinations(range(6), 2))
        for p in legs.position[::10]
    ]
    np.testing.assert_allclose(least[::10], brute)
    [label] = [line.get_label() for line in ax.lines if "least of all" in str(line.get_label())]
    assert label == f"least of all: {legs.closest_approach.distance:.3f} m"
    assert legs.closest_approach.distance <= least.min()


def test_gains_are_drawn_once_a_shape_on_its_edges_alone(legs):
    figure = drawn("gains", legs)
    images = [ax.images[0].get_array() for ax in figure.axes if ax.images]
    shapes = legs.mission.gains[:2]
    assert len(images) == 2 * len(shapes)
    for number, shape in enumerate(shapes):
        graph = shape.formation.graph
        for image, A in zip(images[2 * number : 2 * number + 2], (shape.xy, shape.z), strict=True):
            np.testing.assert_array_equal(image.mask, ~graph)
            np.testing.assert_allclose(image[graph], np.abs(A)[graph])
    titles = [ax.get_title() for ax in figure.axes]
    assert (
        f"rate {shapes[0].rate_xy:.3f}/s, none exceeds {shapes[0].bound_xy:.3f}/s"
        in (titles[1].split("\n")[1])
    )


def test_drift_is_told_in_centimetres_of_every_vehicle(legs):
    lie, drift = drawn("frames", legs).axes
    far = np.array([line.get_ydata() for line in drift.lines[:6]]).T
    np.testing.assert_allclose(far, 100 * np.linalg.norm(legs.drift, axis=2))
    x_axes = [line.get_xydata() for line in lie.lines[1:7]]
    ways = np.array([end - begin for begin, end in x_axes])
    turned = np.arctan2(ways[:, 1], ways[:, 0])
    np.testing.assert_allclose(np.exp(1j * turned), legs.mission.frames.rotation, atol=1e-9)


def test_every_auction_is_drawn_with_its_rounds_and_bits(legs):
    took, rounds = drawn("assignments", legs).axes
    told = [e for _, e in legs.events.of_kind("auction")]
    dots = rounds.lines[-1].get_xydata()
    assert dots.tolist() == [[e["time"], e["rounds"]] for e in told]
    assert len(took.lines[-1].get_xydata()) == len(legs.events.told("assignment"))
    [bits] = rounds.child_axes
    radio = legs.mission.radio
    top = bits.get_ylim()[1] / rounds.get_ylim()[1]
    assert top == pytest.approx(radio.auction(6, 1) / 1000)


def test_thinned_numbers_keep_both_ends():
    assert subsample(1, 5).tolist() == [0]
    assert subsample(4, 9).tolist() == [0, 1, 2, 3]
    found = subsample(6000, 300)
    assert (found[0], found[-1], len(found)) == (0, 5999, 300)
