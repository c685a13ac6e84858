"""Filled areas: polygons and pictures."""

from collections.abc import Sequence
from math import ceil, sqrt
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.shapes.ordering import golden_ratio_order
from sato.shapes.placement import Center, check_count, place_shape
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
    """Fill a polygon with targets, its corners first.

    Without `spacing` and `height` the polygon keeps the size of its vertices.

    Args:
        vertices: Corners [m] in order, either way round; the last is joined to the first.
        count: Number of targets.
        spacing: Least distance between two targets [m]; or
        height: Height of the polygon [m].
        minimum_spacing: Least distance between two targets that is accepted [m].
        center: Position of the middle of the bounding box.

    Raises:
        ValueError: The vertices enclose no area, or the targets would be too close.
    """
    check_count(count)
    region = fill_outlines("the polygon", [_parse_vertices(vertices)], count)
    return place_shape(
        region.sample_targets(count)._replace(has_own_size=True),
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
    """Fill the dark or opaque part of a picture with targets.

    Any format that Pillow reads will do. Where the picture has transparency, a pixel is inside if
    it is at least half opaque, whatever its color. Where it has none, a pixel is inside if it is
    darker than middle gray: luma 0.299 R + 0.587 G + 0.114 B below 128 of 255. A pixel is a
    square and counts with its whole area.

    Args:
        path: File of the picture.
        count: Number of targets.
        spacing: Least distance between two targets [m]; or
        height: Height from the lowest to the highest pixel inside [m].
        invert: Fill the other pixels.
        minimum_spacing: Least distance between two targets that is accepted [m].
        center: Position of the middle of the bounding box of the pixels inside.

    Raises:
        ValueError: There is no such picture or no pixel inside, or the targets would be too close.
    """
    check_count(count)
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
            if image.mode.startswith("I"):  # 16 bits of gray, which Pillow would clip at 255
                return np.asarray(np.asarray(image) < 128 * 257)
            alpha = np.asarray(image.convert("RGBA").getchannel("A"))
            if alpha.min() < 255:
                return np.asarray(alpha >= 128)
            return np.asarray(np.asarray(image.convert("L")) < 128)
    except FileNotFoundError as error:
        raise ValueError(f"there is no picture {path}") from error
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise ValueError(f"{path} cannot be read as a picture: {error}") from error


def _mask_region(label: str, inside: Bool[Array, "rows columns"], count: int) -> Region:
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
        candidates = np.column_stack(
            [(column[:, None] + dx).ravel(), (-row[:, None] - dy).ravel()],
        )
    lower = np.array([column.min(), -row.max() - 1.0], dtype=float)
    upper = np.array([column.max() + 1.0, -row.min()], dtype=float)
    return Region(label, candidates[golden_ratio_order(len(candidates))], lower, upper)
