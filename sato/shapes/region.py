"""Regions of the plane, and targets spread over them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.shapes.ordering import TIE_TOLERANCE, farthest_point_sampling, golden_ratio_order
from sato.shapes.shape import Drawing

MIN_CANDIDATES = 30_000  # positions from which the targets of a region are chosen, about
CANDIDATES_PER_TARGET = 40  # and at least this many per target
COARSE_CELLS = 200  # rows and columns of the grid that estimates the area
MAX_GRID_CELLS = 4_000_000  # cells of the bounding box, a limit for a sliver across it


def spread_targets(
    label: str,
    candidates: Float[Array, "k 2"],
    lower: Float[Array, " 2"],
    upper: Float[Array, " 2"],
    count: int,
) -> Drawing:
    """Spread targets over a region, each as far as possible from those before it.

    Args:
        label: Name of the region in messages.
        candidates: Many positions all over the region, from which the targets are chosen.
        lower: Lower left corner of its bounding box.
        upper: Upper right corner.
        count: Number of targets.
    """
    chosen = farthest_point_sampling(candidates, count)

    def max_count(spacing: float) -> int:
        return max(1, int(np.sum(chosen.spacings >= spacing * (1 + 2 * TIE_TOLERANCE))))

    points, middle = candidates[chosen.indices], (lower + upper) / 2
    return Drawing(label, points, middle, "height", float(upper[1] - lower[1]), max_count)


def fill_outlines(label: str, outlines: Sequence[Float[Array, "_ 2"]], count: int) -> Drawing:
    """Spread targets over the region that closed outlines enclose.

    A position is inside where the outlines have a winding number other than 0 (a hole runs the
    other way round, as in fonts). Candidates are the nodes of a grid and, so that edges and
    corners are kept, points on the outlines.

    Raises:
        ValueError: The outlines enclose nothing.
    """
    start = np.concatenate(outlines)
    end = np.concatenate([np.roll(outline, -1, axis=0) for outline in outlines])
    lower, upper = start.min(axis=0), start.max(axis=0)
    box = upper - lower
    area = max(_signed_area(start, end), _coarse_area(start, end))
    if not area > 1e-9 * float(box.max()) ** 2:
        raise ValueError(f"{label} encloses no area")
    length = float(np.linalg.norm(end - start, axis=1).sum())
    needed = max(MIN_CANDIDATES, CANDIDATES_PER_TARGET * count)
    step = max(
        float(np.sqrt(area / needed)), length / needed, float(np.sqrt(box.prod() / MAX_GRID_CELLS))
    )
    x, y = (_cell_centers(lower[axis], upper[axis], step) for axis in (0, 1))
    row, column = np.nonzero(_is_enclosed(start, end, x, y))
    edge, grid = _sample_edges(start, end, step), np.column_stack([x[column], y[row]])
    # The outlines come first, so that ties go to the edge.
    candidates = np.concatenate(
        [edge[golden_ratio_order(len(edge))], grid[golden_ratio_order(len(grid))]]
    )
    return spread_targets(label, candidates, lower, upper, count)


def _signed_area(start: Float[Array, "edges 2"], end: Float[Array, "edges 2"]) -> float:
    # Exact, except where outlines cross and parts of the area cancel.
    a, b = start - start.min(axis=0), end - start.min(axis=0)
    return abs(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))) / 2


def _coarse_area(start: Float[Array, "edges 2"], end: Float[Array, "edges 2"]) -> float:
    lower, box = start.min(axis=0), np.ptp(start, axis=0)
    x, y = (lower + (np.arange(COARSE_CELLS)[:, None] + 0.5) / COARSE_CELLS * box).T
    inside = _is_enclosed(start, end, x, y)
    # Only pairs of cells count: where an outline only retraces itself, rounding may put a single
    # cell inside.
    return float((inside[:, 1:] & inside[:, :-1]).mean() * box.prod())


def _cell_centers(lower: float, upper: float, step: float) -> Float[Array, " cells"]:
    # Symmetric about the middle, so that a symmetric outline has symmetric candidates.
    cells = max(1, round((upper - lower) / step))
    return lower + (np.arange(cells) + 0.5) * ((upper - lower) / cells)


def _is_enclosed(
    start: Float[Array, "edges 2"],
    end: Float[Array, "edges 2"],
    x: Float[Array, " columns"],
    y: Float[Array, " rows"],
) -> Bool[Array, "rows columns"]:
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


def _sample_edges(
    start: Float[Array, "edges 2"], end: Float[Array, "edges 2"], step: float
) -> Float[Array, "k 2"]:
    pieces = np.ceil(np.linalg.norm(end - start, axis=1) / step).astype(int)
    edge = np.repeat(np.arange(len(start)), pieces)
    piece = np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    fraction = piece / pieces[edge]
    samples: Array = start[edge] + fraction[:, None] * (end - start)[edge]
    return samples
