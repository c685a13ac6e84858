"""Filled areas: text, polygons and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import ceil, sqrt
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray as Array
from pydantic import Field

from dynamics.units import Unit
from sato.files import check_regular, check_size
from sato.scenario.definition import Amount, Axes, Matrix
from sato.scenario.errors import InputError
from sato.shapes.ordering import farthest_point_sampling, golden_ratio_order
from sato.shapes.shape import Drawing, Shape, Size

# Both come with matplotlib, so every machine has them. The broad strokes of a single bold letter
# keep a swarm connected where some targets stay empty; in a word they would fill the letters.
LETTER_FONT, WORD_FONT = "DejaVu Sans:bold", "DejaVu Sans"
CURVE_RESOLUTION = 10.0  # curves become chords this many times finer than matplotlib's own
Points2 = Float[Array, "_ 2"]
MIN_CANDIDATES = 30_000  # positions from which the targets of a region are chosen, about
CANDIDATES_PER_TARGET = 40  # and at least this many per target
COARSE_CELLS = 200  # rows and columns of the grid that estimates the area
LEAST_CONTRAST = 0.1  # of a picture: less is noise, and no shape
WHITE_IS_ZERO = 262  # tag of TIFF with value 0
PIXEL_BYTES = 10  # of a picture as it is read, with its transparency and its gray
MAX_GRID_CELLS = 4_000_000  # cells of the bounding box, a limit for a sliver across it


@dataclass(frozen=True, eq=False, repr=False)
class Text(Shape):
    """A line of text.

    The font is a family and style ("DejaVu Serif:bold") or a font file; without it DejaVu Sans,
    bold for a single letter. The height is that from the lowest to the highest point.
    """

    kind: ClassVar[str] = "text"
    text: Annotated[str, Field(max_length=200), "text, in one line"]
    font: Annotated[str | None, "name or file of a font"] = None
    height: Annotated[Size | None, Unit("m"), "height of the text"] = None

    def draw(self, count: Amount, axes: Axes) -> Drawing:
        """Spread targets over the strokes of all letters."""
        text = self.text
        if not text.strip():
            raise ValueError(f"the text {text!r} is blank: there is nothing to draw")
        font = self.font or (LETTER_FONT if len(text.strip()) == 1 else WORD_FONT)
        # Importing matplotlib is slow, and no other shape needs it.
        from matplotlib.font_manager import FontProperties
        from matplotlib.path import Path as Curves
        from matplotlib.textpath import TextToPath
        from matplotlib.transforms import Affine2D

        style = FontProperties(fname=_find_font_file(font, text))
        vertices, codes = TextToPath().get_text_path(style, text)
        if len(vertices) == 0:
            raise ValueError(f"the text {text!r} has nothing to draw in the font {font!r}")
        chords = Curves(vertices, codes).to_polygons(Affine2D().scale(CURVE_RESOLUTION))
        return _fill_outlines([np.asarray(chord, dtype=float)[:-1] for chord in chords], count)


@dataclass(frozen=True, eq=False, repr=False)
class Polygon(Shape):
    """An area with corners; its last corner is joined to the first.

    Each target is far from those before it, so that many of the first ones are corners. The area
    stays where its vertices are unless a center is given, and as large unless a spacing or a
    height is.
    """

    kind: ClassVar[str] = "polygon"
    is_absolute: ClassVar[bool] = True
    vertices: Annotated[Matrix, Unit("m"), "corners, in order"]
    height: Annotated[Size | None, Unit("m"), "height of the polygon"] = None

    def check(self) -> None:
        """Refuse vertices that enclose nothing."""
        rows, columns = self.vertices.shape
        if columns != 2 or rows < 3:
            needed = "a polygon needs at least three vertices of two coordinates"
            raise InputError("vertices_m", f"{needed}, got {self.vertices.shape}")

    def draw(self, count: Amount, axes: Axes) -> Drawing:
        """Fill the polygon."""
        return _fill_outlines([self.vertices], count)


@dataclass(frozen=True, eq=False, repr=False)
class Picture(Shape):
    """The dark or opaque part of a picture, in any format that Pillow reads.

    Where some pixels are less than half opaque, a pixel is inside if it is at least half opaque,
    whatever its color. Else it is inside if it is darker than the middle between the darkest and
    the brightest pixel, whatever the range of their numbers: 8, 12 or 16 bits, or floats. The gray
    of a color is 0.299 R + 0.587 G + 0.114 B. A picture of nearly one shade is refused, if it is
    not all black or all white in 8 bits. A pixel is a square and counts with its whole area. The
    height is that from the lowest to the highest pixel inside.
    """

    kind: ClassVar[str] = "picture"
    file: Annotated[str, "file of the picture"]
    height: Annotated[Size | None, Unit("m"), "height of the picture"] = None
    invert: Annotated[bool, "fill the bright part"] = False

    def draw(self, count: Amount, axes: Axes) -> Drawing:
        """Fill the pixels inside."""
        inside = _read_mask(Path(self.file)) ^ self.invert
        if not inside.any():
            rule = "dark or opaque" if self.invert else "light or transparent"
            cure = f"invert = {str(not self.invert).lower()} takes those instead"
            raise ValueError(f"no pixel of {self.file} is inside: all are {rule}; {cure}")
        needed = max(MIN_CANDIDATES, CANDIDATES_PER_TARGET * count)
        row, column = np.nonzero(inside)
        if len(row) > needed:
            # One pixel of each block that has any, so that a thin line is not lost.
            block = ceil(sqrt(len(row) / needed))
            block_index = (row // block) * inside.shape[1] + column // block
            _, first = np.unique(block_index, return_index=True)
            candidates = np.column_stack([column[first] + 0.5, -row[first] - 0.5])
        else:
            parts = ceil(sqrt(needed / len(row)))
            offsets = (np.arange(parts) + 0.5) / parts
            dx, dy = (offset.ravel() for offset in np.meshgrid(offsets, offsets))
            x, y = column[:, None] + dx, -row[:, None] - dy
            candidates = np.column_stack([x.ravel(), y.ravel()])
        lower = np.array([column.min(), -row.max() - 1.0], dtype=float)
        upper = np.array([column.max() + 1.0, -row.min()], dtype=float)
        candidates = candidates[golden_ratio_order(len(candidates))]
        return _spread_targets(candidates, lower, upper, count)


def _read_mask(path: Path) -> Bool[Array, "rows columns"]:
    from PIL import Image, ImageOps

    try:
        check_regular(path)
        with Image.open(path) as image:
            check_size(path, PIXEL_BYTES * image.width * image.height)
            if getattr(image, "is_animated", False) and image.format != "MPO":  # of cameras
                raise ValueError("it has several pictures; a file with the first alone would do")
            upright = ImageOps.exif_transpose(image)
            is_deep = upright.mode[0] in "IF"  # more than 8 bits of gray, which Pillow would clip
            if not is_deep:
                alpha = np.asarray(upright.convert("RGBA").getchannel("A"))
                if alpha.min() < 128:
                    return np.asarray(alpha >= 128)
            gray = np.asarray(upright if is_deep else upright.convert("RGB").convert("L"))
            # Pillow turns pictures in which 0 is white by itself, where they have 8 bits.
            is_white = is_deep and getattr(image, "tag_v2", {}).get(WHITE_IS_ZERO) == 0
            if not is_deep and np.isin(gray, (0, 255)).all():  # even if all are the same
                return np.asarray(gray == 0)
            return _is_dark(-gray.astype(float) if is_white else gray)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"{path} cannot be read as a picture: {reason}") from error


def _is_dark(gray: Shaped[Array, "rows columns"]) -> Bool[Array, "rows columns"]:
    if not np.isfinite(gray).all():
        raise ValueError("it has pixels that are not finite")
    low, high = float(gray.min()), float(gray.max())
    is_mask = bool(((gray == low) | (gray == high)).all())
    if low == high or (not is_mask and high - low < LEAST_CONTRAST * np.abs(gray).max()):
        raise ValueError(f"its pixels are nearly of one shade, from {low:g} to {high:g}")
    return np.asarray(gray < (low + high) / 2)


def _find_font_file(font: str, text: str) -> str:
    from matplotlib import font_manager
    from matplotlib.ft2font import FT2Font

    path = font
    if Path(font).suffix.lower() not in (".ttf", ".otf", ".ttc"):
        try:
            # An unescaped dash begins a size.
            style = font_manager.FontProperties(font.replace("-", r"\-"))
            path = font_manager.findfont(style, fallback_to_default=False)
        except (ValueError, AttributeError) as error:
            installed = sorted({entry.name for entry in font_manager.fontManager.ttflist})
            close = get_close_matches(font.split(":")[0], installed, n=3, cutoff=0.5)
            names = ", ".join(dict.fromkeys((close + installed)[:8]))
            reason = f"no font {font!r} is installed; among those that are: {names}"
            hint = 'a style goes after a colon, as in "DejaVu Serif:bold"'
            raise ValueError(f"{reason} ({hint})") from error
    elif not Path(font).is_file():
        raise ValueError(f"there is no font file {font}")
    try:
        check_size(path, check_regular(Path(path)))
        known = FT2Font(path).get_charmap()
    except (RuntimeError, OSError) as error:
        raise ValueError(f"the font file {path} cannot be read: {error}") from error
    if missing := sorted({character for character in text if ord(character) not in known}):
        found = f"the font {font!r} has no character {', '.join(map(repr, missing))}"
        line = "; text is one line" if "\n" in missing else ""
        raise ValueError(f"{found}: leave it out or choose another font{line}")
    return path


def _spread_targets(candidates: Points2, lower: Array, upper: Array, count: int) -> Drawing:
    # Each target is as far as possible from those before it; the corners are of the bounding box.
    chosen = farthest_point_sampling(candidates, count)
    return Drawing(candidates[chosen], (lower + upper) / 2, float(upper[1] - lower[1]))


def _fill_outlines(outlines: Sequence[Array], count: int) -> Drawing:
    """Spread targets over the region that closed outlines enclose.

    A position is inside where the outlines have a winding number other than 0 (a hole runs the
    other way round, as in fonts). Candidates are the nodes of a grid and, so that edges and
    corners are kept, points on the outlines.
    """
    start = np.concatenate(outlines)
    end = np.concatenate([np.roll(outline, -1, axis=0) for outline in outlines])
    lower, upper = start.min(axis=0), start.max(axis=0)
    box = upper - lower
    area = _estimate_area(start, end)
    if not area > 1e-9 * float(box.max()) ** 2:
        raise ValueError("encloses no area")
    lengths = np.linalg.norm(end - start, axis=1)
    needed = max(MIN_CANDIDATES, CANDIDATES_PER_TARGET * count)
    finest = max(float(lengths.sum()) / needed, float(np.sqrt(box.prod() / MAX_GRID_CELLS)))
    step = max(float(np.sqrt(area / needed)), finest)
    x, y = (_cell_centers(lower[axis], upper[axis], step) for axis in (0, 1))
    row, column = np.nonzero(_is_enclosed(start, end, x, y))
    grid = np.column_stack([x[column], y[row]])
    pieces = np.ceil(lengths / step).astype(int)
    edge = np.repeat(np.arange(len(start)), pieces)
    piece = np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    outline = start[edge] + (piece / pieces[edge])[:, None] * (end - start)[edge]
    # The outlines come first, so that ties go to the edge.
    ordered = [points[golden_ratio_order(len(points))] for points in (outline, grid)]
    return _spread_targets(np.concatenate(ordered), lower, upper, count)


def _estimate_area(start: Points2, end: Points2) -> float:
    lower, box = start.min(axis=0), np.ptp(start, axis=0)
    a, b = start - lower, end - lower
    # Exact, except where outlines cross and parts of the area cancel.
    signed = abs(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))) / 2
    x, y = (lower + (np.arange(COARSE_CELLS)[:, None] + 0.5) / COARSE_CELLS * box).T
    inside = _is_enclosed(start, end, x, y)
    # Only pairs of cells count: where an outline only retraces itself, rounding may put a single
    # cell inside.
    return max(signed, float((inside[:, 1:] & inside[:, :-1]).mean() * box.prod()))


def _cell_centers(lower: float, upper: float, step: float) -> Float[Array, " cells"]:
    # Symmetric about the middle, so that a symmetric outline has symmetric candidates.
    cells = max(1, round((upper - lower) / step))
    return lower + (np.arange(cells) + 0.5) * ((upper - lower) / cells)


def _is_enclosed(start: Points2, end: Points2, x: Array, y: Array) -> Bool[Array, "rows columns"]:
    # Each edge changes the winding number of every cell to the right of it in the rows it crosses.
    # The edge is half-open in y, so that a vertex in a row counts once.
    up = (start[:, 1] <= y[:, None]) & (y[:, None] < end[:, 1])
    down = (end[:, 1] <= y[:, None]) & (y[:, None] < start[:, 1])
    row, edge = np.nonzero(up | down)
    (x0, y0), (dx, dy) = start[edge].T, (end - start)[edge].T
    column = np.searchsorted(x, x0 + (y[row] - y0) * dx / dy)
    winding = np.zeros((len(y), len(x) + 1), dtype=np.int64)
    np.add.at(winding, (row, column), np.where(up[row, edge], 1, -1))
    inside: Array = winding.cumsum(axis=1)[:, :-1] != 0
    return inside
