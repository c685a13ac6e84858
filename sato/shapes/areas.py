"""Shapes that somebody drew: polygons and pictures."""

from collections.abc import Sequence
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.shapes.ordering import golden_ratio_order
from sato.shapes.placement import Center, check_count, check_size_given, place_shape
from sato.shapes.region import CANDIDATES_PER_TARGET, MIN_CANDIDATES, Region, fill_outlines


def polygon(
    vertices: Sequence[Sequence[float]] | Float[Array, "corners 2"],
    count: int,
    *,
    spacing: float | None = None,
    height: float | None = None,
    minimum_spacing: float = 0.0,
    center: Center = "origin",
) -> Float[Array, "count 2"]:
    """Targets that fill a polygon, its corners first.

    Without `spacing` and `height` the polygon keeps the size of its vertices, in metres.

    Args:
        vertices: Corners in turn, either way round; the last is joined to the first.
        count: How many targets.
        spacing: Least distance between two targets [m]; or
        height: Of the polygon [m].
        minimum_spacing: Refuse targets that stand closer [m].
        centre: Where the middle of the bounding box goes.

    Raises:
        ValueError: The vertices enclose no area, or the targets would stand too close.
    """
    check_count(count)
    corners = _parse_vertices(vertices)
    return place_shape(
        fill_outlines("the polygon", [corners], count).sample_targets(count),
        spacing=spacing,
        size=height,
        minimum_spacing=minimum_spacing,
        center=center,
    )


def picture(
    path: str | Path,
    count: int,
    *,
    spacing: float | None = None,
    height: float | None = None,
    invert: bool = False,
    minimum_spacing: float = 0.0,
    center: Center = "origin",
) -> Float[Array, "count 2"]:
    """Targets that fill what is painted on a picture (PNG, or anything that Pillow reads).

    Where the picture has transparency, a pixel is inside if it is at least half opaque, whatever
    its colour. Where it has none, a pixel is inside if it is darker than the middle grey: luma
    0.299 R + 0.587 G + 0.114 B below 128 of 255. A pixel is a square and counts with its
    whole area.

    Args:
        path: The picture.
        count: How many targets.
        spacing: Least distance between two targets [m]; or
        height: From the lowest to the highest pixel inside [m].
        invert: Take the pixels that would be outside.
        minimum_spacing: Refuse targets that stand closer [m].
        centre: Where the middle of the bounding box of the pixels inside goes.

    Raises:
        ValueError: No such picture, no pixel inside, or targets that would stand too close.
    """
    check_count(count)
    check_size_given("height", spacing, height)
    inside = _read_mask(Path(path)) ^ invert
    if not inside.any():
        rule = "light or transparent" if not invert else "dark or opaque"
        raise ValueError(
            f"no pixel of {path} is inside: all are {rule}; "
            f"invert = {'false' if invert else 'true'} takes those instead"
        )
    return place_shape(
        _mask_region(f"the picture {path}", inside, count).sample_targets(count),
        spacing=spacing,
        size=height,
        minimum_spacing=minimum_spacing,
        center=center,
    )


def _parse_vertices(vertices: Sequence[Sequence[float]] | Array) -> Float[Array, "corners 2"]:
    try:
        corners = np.array(vertices, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError("a polygon's vertices must be pairs of numbers") from error
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise ValueError(
            f"a polygon needs at least three vertices of two coordinates, got {corners.shape}"
        )
    if not np.isfinite(corners).all():
        bad = int(np.argmin(np.isfinite(corners).all(axis=1)))
        raise ValueError(f"vertex {bad} of the polygon is not finite: {corners[bad].tolist()}")
    return corners


def _read_mask(path: Path) -> Bool[Array, "rows columns"]:
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.load()
            if image.mode.startswith("I"):  # 16 bits of grey, which Pillow would clip at 255
                return np.asarray(np.asarray(image) < 128 * 257)
            alpha = np.asarray(image.convert("RGBA").getchannel("A"))
            if alpha.min() < 255:
                return np.asarray(alpha >= 128)
            return np.asarray(np.asarray(image.convert("L")) < 128)
    except FileNotFoundError as error:
        raise ValueError(f"there is no picture {path}") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ValueError(f"{path} cannot be read as a picture: {error}") from error


def _mask_region(what: str, inside: Bool[Array, "rows columns"], count: int) -> Region:
    wanted = max(MIN_CANDIDATES, CANDIDATES_PER_TARGET * count)
    row, column = np.nonzero(inside)
    if len(row) > wanted:
        # One pixel of each block that has any, so that a thin line is not lost.
        block = ceil(sqrt(len(row) / wanted))
        label = (row // block) * inside.shape[1] + column // block
        _, first = np.unique(label, return_index=True)
        places = np.column_stack([column[first] + 0.5, -row[first] - 0.5])
    else:
        parts = ceil(sqrt(wanted / len(row)))
        along = (np.arange(parts) + 0.5) / parts
        dx, dy = (part.ravel() for part in np.meshgrid(along, along))
        places = np.column_stack(
            [(column[:, None] + dx).ravel(), (-row[:, None] - dy).ravel()],
        )
    lower = np.array([column.min(), -row.max() - 1.0], dtype=float)
    upper = np.array([column.max() + 1.0, -row.min()], dtype=float)
    return Region(what, places[golden_ratio_order(len(places))], lower, upper)
