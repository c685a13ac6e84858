"""Filled areas: polygons and pictures."""

from dataclasses import dataclass
from math import ceil, sqrt
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from dynamics.units import Unit
from sato.scenario.definition import Matrix
from sato.scenario.errors import InputError
from sato.shapes.ordering import golden_ratio_order
from sato.shapes.region import CANDIDATES_PER_TARGET, MIN_CANDIDATES, fill_outlines, spread_targets
from sato.shapes.shape import Drawing, Shape, Size


@dataclass(frozen=True, eq=False, repr=False)
class Polygon(Shape):
    """An area with corners, the first targets; its last corner is joined to the first.

    It stays where its vertices are unless a center is given, and as large unless a spacing or a
    height is.
    """

    kind: ClassVar[str] = "polygon"
    vertices: Annotated[Matrix, Unit("m"), "corners, in order"]
    height: Annotated[Size | None, Unit("m"), "height of the polygon"] = None

    def check(self) -> None:
        """Refuse vertices that enclose nothing."""
        rows, columns = self.vertices.shape
        if columns != 2 or rows < 3:
            raise InputError(
                "vertices_m",
                "a polygon needs at least three vertices of two coordinates, got "
                f"{self.vertices.shape}",
            )

    def draw(self, count: int, axes: int) -> Drawing:
        """Fill the polygon."""
        return fill_outlines("the polygon", [self.vertices], count)._replace(is_absolute=True)


@dataclass(frozen=True, eq=False, repr=False)
class Picture(Shape):
    """The dark or opaque part of a picture, in any format that Pillow reads.

    Where the picture has transparency, a pixel is inside if it is at least half opaque, whatever
    its color. Where it has none, a pixel is inside if it is darker than middle gray: luma
    0.299 R + 0.587 G + 0.114 B below 128 of 255. A pixel is a square and counts with its whole
    area. The height is that from the lowest to the highest pixel inside.
    """

    kind: ClassVar[str] = "picture"
    file: Annotated[str, "file of the picture"]
    height: Annotated[Size | None, Unit("m"), "height of the picture"] = None
    invert: Annotated[bool, "fill the bright part"] = False

    def draw(self, count: int, axes: int) -> Drawing:
        """Fill the pixels inside."""
        inside = _read_mask(Path(self.file)) ^ self.invert
        if not inside.any():
            rule = "light or transparent" if not self.invert else "dark or opaque"
            raise ValueError(
                f"no pixel of {self.file} is inside: all are {rule}; "
                f"invert = {'false' if self.invert else 'true'} takes those instead"
            )
        return _fill_mask(f"the picture {self.file}", inside, count)


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


def _fill_mask(label: str, inside: Bool[Array, "rows columns"], count: int) -> Drawing:
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
    return spread_targets(label, candidates, lower, upper, count)
