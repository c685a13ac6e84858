"""Shapes: prefixes, sizes and positions, second opinions on area and order, refusals."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from matplotlib import get_data_path
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path as Curves
from matplotlib.textpath import TextPath
from PIL import Image, ImageDraw
from scipy.spatial.distance import cdist, pdist

from dynamics.trajectory_geometry import min_distance
from sato.shapes import Lattice, Picture, Points, Polygon, Ring, Text
from sato.shapes.ordering import farthest_point_sampling
from sato.shapes.regular import embed_in_plane

SQUARE = [(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)]
CORNER = [(0.0, 0.0), (20.0, 0.0), (20.0, 6.0), (6.0, 6.0), (6.0, 25.0), (0.0, 25.0)]
ROUNDING = 1e-6  # relative; the law itself leaves no margin


def prefix_gaps(points):
    """Return the gap of each prefix: largest distance to it, over its least distance."""
    distance, counts = cdist(points, points), range(2, len(points) + 1)
    gaps = [distance[:m].min(axis=0).max() / pdist(points[:m]).min() for m in counts]
    return np.array(gaps)


def picture_file(folder, size, draw, mode="L", paper=255, name="mask.png"):
    image = Image.new(mode, size, paper)
    draw(ImageDraw.Draw(image))
    path = folder / name
    image.save(path)
    return str(path)


def listing(folder, content):
    path = folder / "points.csv"
    path.write_text(content)
    return str(path)


def disc(folder):
    draw = lambda d: d.ellipse((5, 5, 55, 55), fill=0)  # noqa: E731
    return picture_file(folder, (60, 60), draw, name="disc.png")


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
    ordered = points[farthest_point_sampling(points, len(points))]
    assert prefix_gaps(ordered).max() <= 1 + ROUNDING


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=30))
def test_order_is_a_permutation_even_where_points_coincide(points):
    order = farthest_point_sampling(np.array(points, dtype=float), len(points))
    assert sorted(order) == list(range(len(points)))


TEXTS = st.text(alphabet="UICHELO ao8&", min_size=1, max_size=4).filter(str.strip)
CORNERS = st.tuples(st.integers(-9, 9), st.integers(-9, 9))
POLYGONS = st.lists(CORNERS, min_size=3, max_size=8, unique=True)
SHAPES = st.one_of(
    TEXTS.map(lambda text: (Text, {"text": text, "spacing": 1.0}, 2)),
    POLYGONS.map(lambda vertices: (Polygon, {"vertices": vertices, "spacing": 1.0}, 2)),
    st.sampled_from([2, 3]).map(lambda axes: (Lattice, {"spacing": 0.7}, axes)),
    st.just((Ring, {"radius": 3.0}, 2)),
    st.just((Ring, {"radius": 3.0, "normal": (1.0, -2.0, 0.5)}, 3)),
)


@settings(max_examples=80, deadline=None)
@given(SHAPES, st.integers(2, 120))
def test_every_prefix_of_the_targets_keeps_the_shape(shape, count):
    kind, given, axes = shape
    try:
        targets = kind(**given).place(count, axes)
    except ValueError as error:  # all on a line, or going back over itself
        assert kind is Polygon and "encloses no area" in str(error)
    else:
        assert targets.shape == (count, axes)
        assert prefix_gaps(targets).max() <= 1 + ROUNDING


def test_every_prefix_of_a_picture_or_a_list_keeps_the_shape(tmp_path, rng):
    lines = "\n".join(f"{x},{y}" for x, y in rng.normal(size=(70, 2)))
    for shape in (Picture(disc(tmp_path), spacing=1.0), Points(file=listing(tmp_path, lines))):
        assert prefix_gaps(shape.place(70, 2)).max() <= 1 + ROUNDING


# Size and position.


@pytest.mark.parametrize(
    ("kind", "given", "count", "axes"),
    [
        (Text, {"text": "U"}, 160, 2),
        (Text, {"text": "HELLO"}, 123, 2),
        (Ring, {}, 97, 2),
        (Lattice, {}, 97, 2),
        (Lattice, {}, 60, 3),
        (Polygon, {"vertices": CORNER}, 80, 2),
    ],
)
def test_requested_spacing_is_reached_and_never_undercut(kind, given, count, axes):
    for spacing in (0.37, 1.0, 50.0):
        # A caller may check the targets against the very spacing that it requested.
        reached = min_distance(kind(**given, spacing=spacing).place(count, axes, spacing))
        assert reached == pytest.approx(spacing, rel=1e-9)
        assert reached >= spacing


@pytest.mark.parametrize("text", ["U", "I", "HELLO", "é"])
def test_text_has_the_requested_height_and_center(text):
    targets = Text(text, height=12.0, center=(3.0, -5.0)).place(400, 2)
    lower, upper = targets.min(axis=0), targets.max(axis=0)
    # Extremes of curves may fall between two targets, corners never do.
    assert upper[1] - lower[1] == pytest.approx(12.0, abs=0.3)
    assert (lower + upper) / 2 == pytest.approx((3.0, -5.0), abs=0.3)


def test_corners_of_a_polygon_are_the_first_targets():
    targets = Polygon(SQUARE, center=(0.0, 0.0)).place(40, 2)
    assert {tuple(corner) for corner in targets[:4]} == {(x, y) for x in (-2, 2) for y in (-2, 2)}


def test_polygon_keeps_its_size_and_on_request_its_position():
    given = Polygon(CORNER).place(30, 2)
    assert given.min(axis=0) == pytest.approx((0, 0))
    assert given.max(axis=0) == pytest.approx((20, 25))
    moved = Polygon(CORNER, center=(0.0, 0.0)).place(30, 2)
    assert moved == pytest.approx(given - (10, 12.5))
    doubled = Polygon(CORNER, height=50.0, center=(0.0, 0.0)).place(30, 2)
    assert doubled == pytest.approx(2 * moved)


def test_ring_has_equal_angles_and_lies_in_its_plane():
    for count in (1, 2, 3, 7, 64):
        flat = Ring(radius=5.0, center=(1.0, 2.0)).place(count, 2)
        assert np.linalg.norm(flat - (1, 2), axis=1) == pytest.approx(np.full(count, 5.0))
        angle = np.sort(np.arctan2(*(flat - (1, 2)).T[::-1]))
        assert np.diff(angle) == pytest.approx(np.full(count - 1, 2 * np.pi / count))
        tilted = Ring(radius=5.0, normal=(0.0, 3.0, 4.0)).place(count, 3)
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
    assert Text("U", spacing=1.0, center=(4, 5)).place(1, 2).tolist() == [[4, 5]]
    assert Ring(spacing=1.0).place(1, 2).tolist() == [[0, 0]]
    assert Lattice(radius=2.0).place(1, 3).tolist() == [[0, 0, 0]]
    assert Polygon(SQUARE, spacing=1.0).place(1, 2).tolist() == [[2, 2]]


# Second opinions.


def test_ties_go_to_the_smaller_index():
    square = np.array([[0.0, 1.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0]])
    assert list(farthest_point_sampling(square, 4)) == [0, 1, 2, 3]


def test_letters_contain_their_targets_and_leave_holes_empty():
    drawn = TextPath((0, 0), "O", size=1000, prop=FontProperties("DejaVu Sans:bold"))
    box = drawn.get_extents()
    rings = sorted(drawn.to_polygons(), key=lambda ring: -np.ptp(ring[:, 0]))
    outer, hole = ((ring - (box.p0 + box.p1) / 2) * 10 / box.height for ring in rings)
    targets = Text("O", height=10.0).place(300, 2)
    # A thousandth larger and smaller, since targets stand on the outlines too.
    assert Curves(outer * 1.001).contains_points(targets).all()
    assert not Curves(hole * 0.999).contains_points(targets).any()
    # L has its foot to the right of its stem and nothing above it.
    x, y = Text("L", height=10.0, center=(0, 0)).place(60, 2).T
    assert not ((x > 0.5) & (y > -2.5)).any() and ((x > 0.5) & (y < -2.5)).sum() >= 8


def test_text_has_targets_in_each_letter():
    columns = np.histogram(Text("HELLO", height=10.0).place(100, 2)[:, 0], bins=5)[0]
    assert columns.min() >= 12


def test_letter_i_without_its_middle_quarter_is_in_two_parts():
    held = Text("I", spacing=1.0).place(160, 2)[:123]
    rest = held[np.argsort(np.linalg.norm(held, axis=1))[round(0.25 * 123) :]]
    top, bottom = rest[rest[:, 1] > 0], rest[rest[:, 1] < 0]
    assert cdist(top, bottom).min() > 3.0
    assert min(len(top), len(bottom)) > 30


def test_polygon_is_covered_evenly(rng):
    # No point of the polygon is farther from the targets than they are from each other.
    targets = Polygon(CORNER).place(150, 2)
    samples = rng.uniform((0, 0), (20, 25), size=(4000, 2))
    inside = (samples[:, 0] < 6) | (samples[:, 1] < 6)
    distance = cdist(samples[inside], targets).min(axis=1)
    assert distance.max() <= min_distance(targets) * 1.05  # the grid of candidates is this coarse
    assert ((targets[:, 0] <= 6) | (targets[:, 1] <= 6)).all()


def test_self_intersecting_outline_encloses_both_parts():
    bow = Polygon([(0, 0), (4, 4), (4, 0), (0, 4)], center=(0, 0)).place(60, 2)
    assert (bow[:, 0] < -0.5).sum() == pytest.approx((bow[:, 0] > 0.5).sum(), abs=6)
    assert (np.abs(bow[:, 1]) <= np.abs(bow[:, 0]) + 0.05).all()


@pytest.mark.parametrize(("dimension", "neighbors"), [(2, 6), (3, 12)])
def test_inner_targets_of_a_lattice_have_all_neighbors(dimension, neighbors):
    targets = Lattice(spacing=2.0).place(150, dimension)
    close = (cdist(targets, targets) < 2.0 * 1.01).sum(axis=1) - 1
    inner = np.linalg.norm(targets, axis=1) < np.linalg.norm(targets, axis=1).max() - 4.1
    assert inner.any()
    assert (close[inner] == neighbors).all()
    sized = Lattice(radius=7.0).place(150, dimension)
    assert np.linalg.norm(sized, axis=1).max() == pytest.approx(7.0)


# Published [Morgan2016, Remark 4]: M targets on a circle, then M halfway between them.


def test_first_half_of_a_ring_is_a_ring_for_powers_of_two():
    whole, half = (Ring(radius=1.0).place(count, 2) for count in (64, 32))
    assert cdist(whole[:32], half).min(axis=1) == pytest.approx(np.zeros(32), abs=1e-12)
    assert cdist(whole[32:], half).min() == pytest.approx(2 * np.sin(np.pi / 64))


# Pictures and lists.


def test_dark_pixels_of_an_opaque_picture_are_inside(tmp_path):
    draw = lambda d: d.rectangle((1, 2, 3, 8), fill=127)  # noqa: E731
    path = picture_file(tmp_path, (10, 10), draw, paper=128)
    targets = Picture(path, height=7.0, center=(2.5, -5.5)).place(60, 2)
    # Pixels 1 to 3 across and 2 to 8 down, with the top of the picture up.
    assert ((targets > (1, -9)) & (targets < (4, -2))).all()
    assert np.ptp(targets, axis=0) == pytest.approx((3, 7), abs=0.1)
    others = Picture(path, height=10.0, invert=True, center=(5, -5)).place(200, 2)
    assert not ((others > (1, -9)) & (others < (4, -2))).all(axis=1).any()


def test_transparency_and_16_bits_are_read_as_what_is_opaque_or_dark(tmp_path):
    draw = lambda d: d.rectangle((0, 0, 9, 19), fill=(255, 255, 255, 255))  # noqa: E731
    clear = picture_file(tmp_path, (20, 20), draw, "RGBA", paper=(0, 0, 0, 0))
    levels = np.full((20, 20), 60000, dtype=np.uint16)
    levels[:, :10] = 20000
    deep = tmp_path / "deep.png"
    Image.fromarray(levels).save(deep)
    for path in (clear, str(deep)):
        assert np.ptp(Picture(path, height=20.0).place(50, 2)[:, 0]) < 10


def test_thin_line_survives_in_a_large_picture(tmp_path):
    def draw(d):
        d.rectangle((0, 0, 299, 799), fill=0)
        d.line((300, 400, 899, 400), fill=0)

    targets = Picture(picture_file(tmp_path, (900, 800), draw), height=800.0).place(100, 2)
    assert (targets[:, 0] > 440).any()


def test_list_is_read_with_or_without_header_in_its_order_on_request(tmp_path):
    rows = "0,0\n1,0\n# a remark\n\n10,0\n0,4\n"
    for header in ("", "x,y\n", "x_m, y_m\n", "\ufeffX,Y\n"):
        path = tmp_path / "points.csv"
        path.write_text(header + rows, encoding="utf-8")
        kept = Points(file=str(path), keep_order=True).place(4, 2)
        assert kept.tolist() == [[0, 0], [1, 0], [10, 0], [0, 4]]
    assert Points(file=str(path)).place(3, 2).tolist() == [[0, 0], [10, 0], [0, 4]]
    assert min_distance(Points(file=str(path), spacing=3.0).place(4, 2)) == pytest.approx(3.0)
    centered = Points(file=str(path), center=(0.0, 0.0)).place(4, 2)
    assert centered.max(axis=0) == pytest.approx((5, 2))


# Refusals, and the cures that they offer.


@pytest.mark.parametrize(
    ("kind", "given", "size"),
    [
        (Text, {"text": "U"}, "height"),
        (Polygon, {"vertices": CORNER}, "height"),
        (Ring, {}, "radius"),
        (Lattice, {}, "radius"),
    ],
)
def test_too_small_a_shape_is_refused_with_a_size_that_fits(kind, given, size):
    with pytest.raises(ValueError, match=r"160 targets .* apart, and they need 1\.5 m") as refused:
        kind(**given, **{size: 9.0}).place(160, 2, 1.5)
    enough = float(re.search(rf": a {size} of ([\d.]+) m would do", str(refused.value)).group(1))
    assert min_distance(kind(**given, **{size: enough}).place(160, 2, 1.5)) >= 1.5
    with pytest.raises(ValueError, match="would do"):
        kind(**given, **{size: enough * 0.99}).place(160, 2, 1.5)


def test_too_small_a_spacing_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"0\.4 m apart, and they need 0\.5 m: a spacing of 0\.5"):
        Text("U", spacing=0.4).place(20, 2, 0.5)
    with pytest.raises(ValueError, match=r"2 targets are 1 m apart, .* 2 m"):
        Points(file=listing(tmp_path, "0,0\n1,0\n")).place(2, 2, 2.0)


@given(st.floats(0.01, 100.0))
def test_spacing_that_a_refusal_names_would_do(needed):
    with pytest.raises(ValueError, match="a spacing of") as refused:
        Ring(spacing=needed / 2).place(5, 2, needed)
    (named,) = re.findall(r"a spacing of ([\d.e+-]+) m", str(refused.value))
    assert Ring(spacing=float(named)).place(5, 2, needed).shape == (5, 2)


@pytest.mark.parametrize(
    ("kind", "given", "message"),
    [
        (Text, {"text": "U"}, "give the spacing of the targets or the height"),
        (Ring, {}, "give the spacing of the targets or the radius"),
        (Text, {"text": "U", "spacing": 1.0, "height": 2.0}, "spacing or height, not both"),
        (Text, {"text": "U", "spacing": 1.0, "center": (1, 2, 3)}, "needs 2 coordinates, got 3"),
        (Text, {"text": " ", "spacing": 1.0}, "the text ' ' is blank"),
        (Text, {"text": "\u200b", "spacing": 1.0}, "nothing to draw"),
        (Text, {"text": "U字", "spacing": 1.0}, "no character '字': leave it out"),
        (Text, {"text": "U", "font": "DejaVu Sanz"}, "those that are: DejaVu Sa"),
        (Text, {"text": "A\nB"}, "has no character '.n': leave it out .*; text is one line"),
        (Text, {"text": "U", "font": "No-Such"}, "no font 'No-Such' .* DejaVu"),
        (Text, {"text": "U", "font": "/no/such.ttf"}, "no font file /no/such"),
        (Ring, {"radius": 1.0, "normal": (0, 0, 0)}, "normal must be three finite"),
        (Polygon, {"vertices": [(0, 0), (1, 1)]}, "at least three vertices"),
        (Polygon, {"vertices": [(0, 0), (1, 1), (2, 2)]}, "encloses no area"),
        (Points, {"positions": [(0, 0)]}, "lists 1 points, fewer than the 5 needed"),
    ],
)
def test_impossible_shape_is_refused_with_a_reason(kind, given, message):
    with pytest.raises(ValueError, match=message):
        kind(**given).place(5, 2)


def test_impossible_count_or_point_is_refused():
    for count in (0, -3):
        with pytest.raises(ValueError, match=f"count: must be an integer above 0, got {count}"):
            Ring(radius=1.0).place(count, 2)


def test_unusable_picture_is_refused_with_a_reason(tmp_path):
    broken, half = tmp_path / "broken.png", tmp_path / "half.png"
    broken.write_text("not a picture")
    whole = Path(disc(tmp_path)).read_bytes()
    half.write_bytes(whole[: len(whole) // 2])
    white = picture_file(tmp_path, (9, 9), lambda d: None, name="white.png")
    black = picture_file(tmp_path, (9, 9), lambda d: None, paper=0, name="black.png")
    animated = tmp_path / "animated.gif"
    Image.open(white).save(animated, save_all=True, append_images=[Image.open(black)])
    for file, invert, message in (
        (tmp_path / "none.png", False, "No such file"),
        (animated, False, "several pictures; a file with the first alone would do"),
        (broken, False, "cannot be read as a picture"),
        (half, False, "cannot be read as a picture"),
        (white, False, r"no pixel .* is inside.*invert = true"),
        (black, True, r"no pixel .* is inside.*invert = false"),
    ):
        with pytest.raises(ValueError, match=message):
            Picture(str(file), spacing=1.0, invert=invert).place(5, 2)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "lists no points"),
        ("x,y\n", "lists no points"),
        ("0\n1\n", "line 1: 2 or 3 columns are needed, or a header .*, got 1"),
        ("0,0\n1,2,3\n", "line 2: 2 columns are needed, got 3"),
        ("x_s,y_s\n0,0\n", 'column "x_s" has the unit "s"; km, cm, mm or m would do'),
        ("0,0\n1,two\n", "line 2: not numbers: 1, two"),
        ("0,0\n\n1,nan\n", "line 3: a coordinate is not finite"),
        ("0,0\n1,inf\n", "line 2: a coordinate is not finite"),
        ("5,5\n0,0\n# again\n5,5.0\n", "lines 1 and 4 are the same point"),
        ("0,0\n", "lists 1 points, fewer than the 2 needed"),
    ],
)
def test_invalid_list_is_refused_with_the_line(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        Points(file=listing(tmp_path, content)).place(2, 2)


@pytest.mark.parametrize(
    ("file", "message"),
    [("none.csv", "No such file"), ("disc.png", "cannot be read as a list of points")],
)
def test_missing_or_unreadable_list_is_refused(tmp_path, file, message):
    disc(tmp_path)
    with pytest.raises(ValueError, match=message):
        Points(file=str(tmp_path / file)).place(1, 2)


def test_font_may_be_a_file(tmp_path):
    bold = Path(get_data_path()) / "fonts" / "ttf" / "DejaVuSans-Bold.ttf"
    file, named = (
        Text("U", spacing=1.0, font=font).place(30, 2) for font in (str(bold), "DejaVu Sans:bold")
    )
    assert file == pytest.approx(named)
    fake = tmp_path / "fake.ttf"
    fake.write_text("not a font")
    with warnings.catch_warnings(), pytest.raises(ValueError, match="cannot be read"):
        warnings.simplefilter("ignore", ResourceWarning)  # the font library leaves it open
        Text("U", spacing=1.0, font=str(fake)).place(30, 2)


def test_too_many_points_to_order_are_refused_with_a_number_that_is_not():
    points = np.zeros((20_000, 1))
    with pytest.raises(ValueError, match=r"20000 of 20000 points are too many .* 10000 would do"):
        farthest_point_sampling(points, 20_000)
