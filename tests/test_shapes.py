"""Shapes: prefixes, sizes and positions, second opinions on area and order, refusals."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image, ImageDraw
from scipy.spatial.distance import cdist, pdist

from dynamics.trajectory_geometry import min_distance
from sato import shapes
from sato.shapes.regular import embed_in_plane

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
CORNER = [(0.0, 0.0), (20.0, 0.0), (20.0, 6.0), (6.0, 6.0), (6.0, 25.0), (0.0, 25.0)]
ROUNDING = 1e-6  # relative; the law itself leaves no margin


def prefix_gaps(points):
    """Return the gap of each prefix: largest distance to it, over its least distance."""
    distance = cdist(points, points)
    return np.array(
        [
            distance[:m].min(axis=0).max() / pdist(points[:m]).min()
            for m in range(2, len(points) + 1)
        ]
    )


def picture_file(folder, size, draw, mode="L", paper=255):
    image = Image.new(mode, size, paper)
    draw(ImageDraw.Draw(image))
    path = folder / "mask.png"
    image.save(path)
    return path


def listing(folder, content):
    path = folder / "points.csv"
    path.write_text(content)
    return path


def disc(folder):
    return picture_file(folder, (60, 60), lambda d: d.ellipse((5, 5, 55, 55), fill=0))


# Prefixes.


@settings(max_examples=60, deadline=None)
@given(
    hnp.arrays(
        np.float64,
        st.tuples(st.integers(2, 40), st.integers(1, 3)),
        elements=st.floats(-100, 100).map(lambda x: round(x, 3)),
        unique=True,
    )
)
def test_every_prefix_of_ordered_points_keeps_the_shape(points):
    ordered = points[shapes.farthest_point_order(points)]
    assert prefix_gaps(ordered).max() <= 1 + ROUNDING


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=30))
def test_order_is_a_permutation_even_where_points_coincide(points):
    order = shapes.farthest_point_order(np.array(points, dtype=float))
    assert sorted(order) == list(range(len(points)))


@settings(max_examples=25, deadline=None)
@given(
    st.text(alphabet="UICHELO ao8&", min_size=1, max_size=4).filter(str.strip), st.integers(2, 90)
)
def test_every_prefix_of_a_text_keeps_the_shape(text, count):
    targets = shapes.text(text, count, spacing=1.0)
    assert targets.shape == (count, 2)
    assert prefix_gaps(targets).max() <= 1 + ROUNDING


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 130), st.sampled_from([2, 3]))
def test_every_prefix_of_a_lattice_or_a_ring_keeps_the_shape(count, dimension):
    lattice = shapes.lattice(count, dimension=dimension, spacing=0.7)
    ring = shapes.ring(count, radius=3.0, normal=None if dimension == 2 else (1.0, -2.0, 0.5))
    for targets in (lattice, ring):
        assert targets.shape == (count, dimension)
        assert prefix_gaps(targets).max() <= 1 + ROUNDING


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=3, max_size=8, unique=True)
)
def test_every_prefix_of_a_polygon_keeps_the_shape(vertices):
    try:
        targets = shapes.polygon(vertices, 50, spacing=1.0)
    except ValueError as error:  # all on a line, or going back over itself
        assert "encloses no area" in str(error)
    else:
        assert prefix_gaps(targets).max() <= 1 + ROUNDING


def test_every_prefix_of_a_picture_or_a_list_keeps_the_shape(tmp_path, rng):
    lines = "\n".join(f"{x},{y}" for x, y in rng.normal(size=(70, 2)))
    for targets in (
        shapes.picture(disc(tmp_path), 120, spacing=1.0),
        shapes.points(listing(tmp_path, lines)),
    ):
        assert prefix_gaps(targets).max() <= 1 + ROUNDING


# Size and position.


@pytest.mark.parametrize(
    "build",
    [
        lambda folder, **size: shapes.text("U", 160, **size),
        lambda folder, **size: shapes.text("HELLO", 123, **size),
        lambda folder, **size: shapes.ring(97, **size),
        lambda folder, **size: shapes.lattice(97, **size),
        lambda folder, **size: shapes.lattice(60, dimension=3, **size),
        lambda folder, **size: shapes.polygon(CORNER, 80, **size),
        lambda folder, **size: shapes.picture(disc(folder), 80, **size),
    ],
)
def test_requested_spacing_is_reached_and_never_undercut(tmp_path, build):
    for spacing in (0.37, 1.0, 50.0):
        reached = min_distance(build(tmp_path, spacing=spacing))
        assert reached == pytest.approx(spacing, rel=1e-9)
        # A caller may check the targets against the very spacing that it requested.
        assert reached >= spacing
        build(tmp_path, spacing=spacing, minimum_spacing=spacing)


@pytest.mark.parametrize("text", ["U", "I", "HELLO", "é"])
def test_text_has_the_requested_height_and_center(text):
    targets = shapes.text(text, 400, height=12.0, center=(3.0, -5.0))
    lower, upper = targets.min(axis=0), targets.max(axis=0)
    # Extremes of curves may fall between two targets, corners never do.
    assert upper[1] - lower[1] == pytest.approx(12.0, abs=0.3)
    assert (lower + upper) / 2 == pytest.approx((3.0, -5.0), abs=0.3)


def test_corners_of_a_polygon_are_the_first_targets():
    targets = shapes.polygon(SQUARE, 40)
    assert {tuple(corner) for corner in targets[:4]} == {(x, y) for x in (-2, 2) for y in (-2, 2)}


def test_polygon_keeps_its_size_and_on_request_its_position():
    given = shapes.polygon(CORNER, 30, center="given")
    assert given.min(axis=0) == pytest.approx((0, 0))
    assert given.max(axis=0) == pytest.approx((20, 25))
    moved = shapes.polygon(CORNER, 30)
    assert moved == pytest.approx(given - (10, 12.5))
    doubled = shapes.polygon(CORNER, 30, height=50.0)
    assert doubled == pytest.approx(2 * moved)


def test_ring_has_equal_angles_and_lies_in_its_plane():
    for count in (1, 2, 3, 7, 64):
        flat = shapes.ring(count, radius=5.0, center=(1.0, 2.0))
        assert np.linalg.norm(flat - (1, 2), axis=1) == pytest.approx(np.full(count, 5.0))
        angle = np.sort(np.arctan2(*(flat - (1, 2)).T[::-1]))
        assert np.diff(angle) == pytest.approx(np.full(count - 1, 2 * np.pi / count))
        tilted = shapes.ring(count, radius=5.0, normal=(0.0, 3.0, 4.0))
        assert tilted @ (0.0, 3.0, 4.0) == pytest.approx(np.zeros(count), abs=1e-12)
        assert np.linalg.norm(tilted, axis=1) == pytest.approx(np.full(count, 5.0))


@pytest.mark.parametrize(
    ("normal", "axes"), [((0, 0, 1), "xy"), ((2, 0, 0), "yz"), ((0, 9, 0), "zx")]
)
def test_flat_shape_takes_the_axes_of_its_plane(normal, axes):
    flat = np.array([[1.0, 2.0], [-3.0, 0.5]])
    embedded = embed_in_plane(flat, normal)
    assert embedded[:, ["xyz".index(axis) for axis in axes]] == pytest.approx(flat)
    assert embedded @ normal == pytest.approx(np.zeros(2))


def test_single_target_with_a_spacing_stands_in_the_middle():
    assert shapes.text("U", 1, spacing=1.0, center=(4, 5)) == pytest.approx(np.array([[4, 5]]))
    assert shapes.ring(1, spacing=1.0) == pytest.approx(np.zeros((1, 2)))
    assert shapes.lattice(1, dimension=3, radius=2.0) == pytest.approx(np.zeros((1, 3)))
    assert shapes.polygon(SQUARE, 1, spacing=1.0, center="given") == pytest.approx(
        np.array([[2, 2]])
    )


# Second opinions.


def test_order_takes_the_farthest_point_next(rng):
    points = rng.normal(size=(25, 2))
    order = list(shapes.farthest_point_order(points))
    for m in range(1, 25):
        left = [i for i in range(25) if i not in order[:m]]
        away = cdist(points[left], points[order[:m]]).min(axis=1)
        assert order[m] == left[int(np.argmax(away))]


def test_ties_go_to_the_smaller_index():
    square = np.array([[0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    assert list(shapes.farthest_point_order(square)) == [0, 1, 2, 3]


def test_letters_contain_their_targets_and_leave_holes_empty():
    from matplotlib.font_manager import FontProperties
    from matplotlib.path import Path as Curves
    from matplotlib.textpath import TextPath

    drawn = TextPath((0, 0), "O", size=1000, prop=FontProperties("DejaVu Sans:bold"))
    box = drawn.get_extents()
    outer, hole = (
        (ring - (box.p0 + box.p1) / 2) * 10 / box.height
        for ring in sorted(drawn.to_polygons(), key=lambda ring: -np.ptp(ring[:, 0]))
    )
    targets = shapes.text("O", 300, height=10.0)
    # A thousandth larger and smaller, since targets stand on the outlines too.
    assert Curves(outer * 1.001).contains_points(targets).all()
    assert not Curves(hole * 0.999).contains_points(targets).any()
    assert Curves(hole).contains_point((0.0, 0.0))  # there is a hole to leave empty


def test_text_has_targets_in_each_letter():
    targets = shapes.text("HELLO", 100, height=10.0)
    columns = np.histogram(targets[:, 0], bins=5)[0]
    assert columns.min() >= 12
    # L has its foot to the right of its stem and nothing above it.
    foot = shapes.text("L", 60, height=10.0, center=(0, 0))
    assert not ((foot[:, 0] > 0.5) & (foot[:, 1] > -2.5)).any()
    assert ((foot[:, 0] > 0.5) & (foot[:, 1] < -2.5)).sum() >= 8


def test_letter_i_without_its_middle_quarter_is_in_two_parts():
    held = shapes.text("I", 160, spacing=1.0)[:123]
    rest = held[np.argsort(np.linalg.norm(held, axis=1))[round(0.25 * 123) :]]
    top, bottom = rest[rest[:, 1] > 0], rest[rest[:, 1] < 0]
    assert cdist(top, bottom).min() > 3.0
    assert min(len(top), len(bottom)) > 30


def test_polygon_is_covered_evenly(rng):
    # No point of the polygon is farther from the targets than they are from each other.
    targets = shapes.polygon(CORNER, 150, center="given")
    samples = rng.uniform((0, 0), (20, 25), size=(4000, 2))
    inside = (samples[:, 0] < 6) | (samples[:, 1] < 6)
    distance = cdist(samples[inside], targets).min(axis=1)
    assert distance.max() <= min_distance(targets) * 1.05  # the grid of candidates is this coarse
    assert ((targets[:, 0] <= 6) | (targets[:, 1] <= 6)).all()


def test_self_intersecting_outline_encloses_both_parts():
    bow = shapes.polygon([(0, 0), (4, 4), (4, 0), (0, 4)], 60)
    assert (bow[:, 0] < -0.5).sum() == pytest.approx((bow[:, 0] > 0.5).sum(), abs=6)
    assert (np.abs(bow[:, 1]) <= np.abs(bow[:, 0]) + 0.05).all()


@pytest.mark.parametrize(("dimension", "neighbors"), [(2, 6), (3, 12)])
def test_inner_targets_of_a_lattice_have_all_neighbors(dimension, neighbors):
    targets = shapes.lattice(150, dimension=dimension, spacing=2.0)
    close = (cdist(targets, targets) < 2.0 * 1.01).sum(axis=1) - 1
    inner = np.linalg.norm(targets, axis=1) < np.linalg.norm(targets, axis=1).max() - 4.1
    assert inner.any()
    assert (close[inner] == neighbors).all()
    sized = shapes.lattice(150, dimension=dimension, radius=7.0)
    assert np.linalg.norm(sized, axis=1).max() == pytest.approx(7.0)


# Published [Morgan2016, Remark 4]: M targets on a circle, then M halfway between them.


def test_first_half_of_a_ring_is_a_ring_for_powers_of_two():
    whole, half = shapes.ring(64, radius=1.0), shapes.ring(32, radius=1.0)
    assert cdist(whole[:32], half).min(axis=1) == pytest.approx(np.zeros(32), abs=1e-12)
    assert cdist(whole[32:], half).min() == pytest.approx(2 * np.sin(np.pi / 64))


# Pictures and lists.


def test_dark_pixels_of_an_opaque_picture_are_inside(tmp_path):
    path = picture_file(
        tmp_path, (10, 10), lambda d: d.rectangle((1, 2, 3, 8), fill=127), paper=128
    )
    targets = shapes.picture(path, 60, height=7.0, center="given")
    # Pixels 1 to 3 across and 2 to 8 down, with the top of the picture up.
    assert ((targets > (1, -9)) & (targets < (4, -2))).all()
    assert np.ptp(targets, axis=0) == pytest.approx((3, 7), abs=0.1)
    others = shapes.picture(path, 200, height=10.0, invert=True, center="given")
    assert not ((others > (1, -9)) & (others < (4, -2))).all(axis=1).any()


def test_only_opacity_counts_in_a_picture_with_transparency(tmp_path):
    white_on_nothing = picture_file(
        tmp_path,
        (20, 20),
        lambda d: d.rectangle((0, 0, 9, 19), fill=(255, 255, 255, 255)),
        mode="RGBA",
        paper=(0, 0, 0, 0),
    )
    targets = shapes.picture(white_on_nothing, 50, height=20.0, center="given")
    assert targets[:, 0].max() < 10


def test_pictures_of_16_bits_are_read_as_gray(tmp_path):
    levels = np.full((20, 20), 60000, dtype=np.uint16)
    levels[:, :5] = 20000
    Image.fromarray(levels).save(tmp_path / "deep.png")
    targets = shapes.picture(tmp_path / "deep.png", 30, height=20.0, center="given")
    assert targets[:, 0].max() < 5


def test_thin_line_survives_in_a_large_picture(tmp_path):
    def draw(d):
        d.rectangle((0, 0, 299, 799), fill=0)
        d.line((300, 400, 899, 400), fill=0)

    targets = shapes.picture(picture_file(tmp_path, (900, 800), draw), 100, height=800.0)
    assert (targets[:, 0] > 440).any()


def test_list_is_read_with_or_without_header_in_its_order_on_request(tmp_path):
    rows = "0,0\n1,0\n# a remark\n\n10,0\n0,4\n"
    for header in ("", "x,y\n", "x_m, y_m\n", "\ufeffX,Y\n"):
        path = tmp_path / "points.csv"
        path.write_text(header + rows, encoding="utf-8")
        kept = shapes.points(path, keep_order=True, center="given")
        assert kept.tolist() == [[0, 0], [1, 0], [10, 0], [0, 4]]
    ordered = shapes.points(path, 3, center="given")
    assert ordered.tolist() == [[0, 0], [10, 0], [0, 4]]
    assert min_distance(shapes.points(path, spacing=3.0)) == pytest.approx(3.0)
    assert shapes.points(path).max(axis=0) == pytest.approx((5, 2))


def test_points_in_space_are_three_columns(tmp_path):
    path = listing(tmp_path, "x_m,y_m,z_m\n0,0,0\n1,2,3\n")
    assert shapes.points(path, center=(0, 0, 1)).tolist() == [[-0.5, -1, -0.5], [0.5, 1, 2.5]]


# Refusals, and the cures that they offer.


@pytest.mark.parametrize(
    ("build", "measure"),
    [
        (lambda count, **size: shapes.text("U", count, **size), "height"),
        (lambda count, **size: shapes.polygon(CORNER, count, **size), "height"),
        (lambda count, **size: shapes.ring(count, **size), "radius"),
        (lambda count, **size: shapes.lattice(count, **size), "radius"),
    ],
)
def test_too_small_a_shape_is_refused_with_a_size_and_a_count_that_fit(build, measure):
    with pytest.raises(ValueError, match=r"160 targets .* apart, and they need 1\.5 m") as refused:
        build(160, minimum_spacing=1.5, **{measure: 9.0})
    cures = re.search(rf": a {measure} of ([\d.]+) m(?:, or at most (\d+))?", str(refused.value))
    enough, fewer = cures.groups()
    assert min_distance(build(160, **{measure: float(enough)})) >= 1.5
    assert build(160, minimum_spacing=1.5, **{measure: float(enough)}).shape == (160, 2)
    with pytest.raises(ValueError, match="would do"):
        build(160, minimum_spacing=1.5, **{measure: float(enough) * 0.99})
    if fewer is not None:
        build(int(fewer), minimum_spacing=1.5, **{measure: 9.0})
        with pytest.raises(ValueError, match="would do"):
            build(int(fewer) + 1, minimum_spacing=1.5, **{measure: 9.0})


def test_too_small_a_spacing_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"0\.4 m apart, and they need 0\.5 m: a spacing of 0\.5"):
        shapes.text("U", 20, spacing=0.4, minimum_spacing=0.5)
    with pytest.raises(ValueError, match=r"points.csv puts 2 targets 1 m apart, .* 2 m"):
        shapes.points(listing(tmp_path, "0,0\n1,0\n"), minimum_spacing=2.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: shapes.text("U", 0, spacing=1.0), "at least one target, got count = 0"),
        (lambda: shapes.ring(-3, radius=1.0), "at least one target, got count = -3"),
        (lambda: shapes.text("U", 5), "give the spacing of the targets or the height"),
        (lambda: shapes.ring(5), "give the spacing of the targets or the radius"),
        (lambda: shapes.text("U", 5, spacing=1.0, height=2.0), "spacing or height, not both"),
        (lambda: shapes.text("U", 5, spacing=float("nan")), "spacing must be a positive number"),
        (lambda: shapes.text("U", 5, height=-2.0), "height must be a positive .* got -2.0"),
        (lambda: shapes.lattice(5, radius=float("inf")), "radius must be a positive .* got inf"),
        (lambda: shapes.text("U", 5, spacing=1.0, minimum_spacing=-1.0), "must not be negative"),
        (lambda: shapes.text("U", 5, spacing=1.0, center=(1, 2, 3)), "center must be 2 finite"),
        (lambda: shapes.text("U", 5, spacing=1.0, center=(1, float("nan"))), "center must be 2"),
        (lambda: shapes.text(" ", 5, spacing=1.0), "the text ' ' is blank"),
        (lambda: shapes.text("\u200b", 5, spacing=1.0), "nothing to draw"),
        (lambda: shapes.text("U字", 5, spacing=1.0), "no character '字': leave it out"),
        (lambda: shapes.text("U", 5, spacing=1.0, font="DejaVu Sanz"), "those that are: DejaVu Sa"),
        (lambda: shapes.text("U", 5, spacing=1.0, font="No-Such"), "no font 'No-Such' .* DejaVu"),
        (lambda: shapes.text("U", 5, spacing=1.0, font="/no/such.ttf"), "no font file /no/such"),
        (lambda: shapes.lattice(5, dimension=4, radius=1.0), "2 or 3 dimensions, got 4"),
        (lambda: shapes.ring(5, radius=1.0, normal=(0, 0, 0)), "normal must be three finite"),
        (lambda: shapes.polygon([(0, 0), (1, 1)], 5), "at least three vertices"),
        (lambda: shapes.polygon([(0, 0), (1, 1), (2, 2)], 5), "the polygon encloses no area"),
        (lambda: shapes.polygon([(0, 0), (1, 0), (1, float("nan"))], 5), "vertex 2 .* not finite"),
        (lambda: shapes.polygon([(0, 0), (1, 0), (1, 2, 3)], 5), "must be pairs of numbers"),
        (lambda: shapes.farthest_point_order(np.array([[0.0], [np.inf]])), "point 1 is not finite"),
    ],
)
def test_impossible_shape_is_refused_with_a_reason(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_unusable_picture_is_refused_with_a_reason(tmp_path):
    with pytest.raises(ValueError, match="there is no picture"):
        shapes.picture(tmp_path / "none.png", 5, spacing=1.0)
    broken = tmp_path / "broken.png"
    broken.write_text("not a picture")
    with pytest.raises(ValueError, match="cannot be read as a picture"):
        shapes.picture(broken, 5, spacing=1.0)
    whole = disc(tmp_path).read_bytes()
    broken.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="cannot be read as a picture"):
        shapes.picture(broken, 5, spacing=1.0)
    white = picture_file(tmp_path, (9, 9), lambda d: None)
    with pytest.raises(ValueError, match=r"no pixel .* is inside.*invert = true"):
        shapes.picture(white, 5, spacing=1.0)
    with pytest.raises(ValueError, match=r"no pixel .* is inside.*invert = false"):
        black = picture_file(tmp_path, (9, 9), lambda d: None, paper=0)
        shapes.picture(black, 5, spacing=1.0, invert=True)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "lists no points"),
        ("x,y\n", "lists no points"),
        ("0\n1\n", "line 1: 2 or 3 columns of meters are needed, got 1"),
        ("0,0\n1,2,3\n", "line 2: 2 columns of meters are needed, got 3"),
        ("x_km,y_km\n0,0\n", "line 1: not numbers: x_km, y_km .*x_m,y_m"),
        ("0,0\n1,two\n", "line 2: not numbers: 1, two"),
        ("0,0\n\n1,nan\n", "line 3: a coordinate is not finite"),
        ("0,0\n1,inf\n", "line 2: a coordinate is not finite"),
        ("5,5\n0,0\n# again\n5,5.0\n", "lines 1 and 4 are the same point"),
    ],
)
def test_invalid_list_is_refused_with_the_line(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        shapes.points(listing(tmp_path, content))


def test_short_or_missing_list_is_refused(tmp_path):
    with pytest.raises(ValueError, match="lists 2 points, fewer than the 3 asked for"):
        shapes.points(listing(tmp_path, "0,0\n1,0\n"), 3)
    with pytest.raises(ValueError, match="there is no file"):
        shapes.points(tmp_path / "none.csv")
    with pytest.raises(ValueError, match="cannot be read as a list of points"):
        shapes.points(disc(tmp_path))


def test_font_may_be_a_file(tmp_path):
    from matplotlib import get_data_path

    bold = Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans-Bold.ttf"
    named = shapes.text("U", 30, spacing=1.0, font=str(bold))
    assert named == pytest.approx(shapes.text("U", 30, spacing=1.0, font="DejaVu Sans:bold"))
    fake = tmp_path / "fake.ttf"
    fake.write_text("not a font")
    with warnings.catch_warnings(), pytest.raises(ValueError, match="cannot be read"):
        warnings.simplefilter("ignore", ResourceWarning)  # the font library leaves it open
        shapes.text("U", 30, spacing=1.0, font=str(fake))
