"""Random starts, random formations and random graphs for them."""

from collections.abc import Callable, Sequence
from math import ceil, pi

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.shapes.placement import check_count

MAX_REJECTIONS = 10_000  # in a row, before there is called no room
PACKING_FRACTION = {2: 0.4, 3: 0.25}  # part of a box that points fill when drawing is still quick
RING_NEIGHBORS = 4  # of every vertex in the ring that holds a sparse graph together


class NoRoomError(ValueError):
    """Points that do not fit.

    Attributes:
        done: How many did.
    """

    def __init__(self, done: int) -> None:
        super().__init__(f"no room after {done} points")
        self.placed_count = done


def sample_separated_points(
    draw: Callable[[], Float[Array, " d"]],
    count: int,
    separation: float,
    occupied: Float[Array, "k d"],
    axes: int,
) -> Float[Array, "count d"]:
    """Points drawn one by one, each anew until none is closer.

    Args:
        draw: One point.
        count: How many.
        separation: Least distance between two of them, or to one that is taken [m].
        taken: Points that were there before.
        axes: How many of the coordinates, from the first on, the distance is of.

    Raises:
        NoRoom: Thousands of draws in a row missed.
    """
    points = np.concatenate([occupied, np.empty((count, occupied.shape[1]))])
    k, misses = len(occupied), 0
    while k < len(points):
        drawn = draw()
        away = points[:k, :axes] - drawn[:axes]
        if np.all(np.sum(away**2, axis=1) >= separation**2):
            points[k] = drawn
            k, misses = k + 1, 0
        elif (misses := misses + 1) == MAX_REJECTIONS:
            raise NoRoomError(k - len(occupied))
    return points[len(occupied) :]


def sample_positions(
    count: int, box: Sequence[float], separation: float, rng: np.random.Generator
) -> Float[Array, "count d"]:
    """Places in a box of two or three sides from the origin on [m], so far apart.

    The trials of [Lusk2020, sec. V-A] start 30 vehicles in 20 m × 20 m, 1.5 m apart.

    Raises:
        ValueError: There is no room.
    """
    return _sample_in_box(count, box, separation, rng, len(box))


def sample_formation(
    count: int, box: Sequence[float], separation: float, rng: np.random.Generator
) -> Float[Array, "count 3"]:
    """Points in a box of three sides from the origin on [m], so far apart when seen from above.

    The trials of [Lusk2020, sec. V-A] take 30 points in 15 m × 15 m × 2 m, 2 m apart; its
    implementation measures that in the plane, for who flies above another blows him down.

    Raises:
        ValueError: There is no room.
    """
    if len(box) != 3:
        raise ValueError(f"a formation is drawn in a box of three sides, got {len(box)}")
    return _sample_in_box(count, box, separation, rng, 2)


def random_dense_graph(
    count: int, removals: int, rng: np.random.Generator
) -> Bool[Array, "count count"]:
    """The complete graph less so many random pairs.

    As in the trials of [Lusk2020], pairs may repeat or be of a vertex with itself, and then
    remove nothing; there, removals are drawn from 1 to count − 4.
    """
    graph = ~np.eye(count, dtype=bool)
    i, j = rng.integers(count, size=(2, removals))
    graph[i, j] = graph[j, i] = False
    return graph


def random_sparse_graph(
    points: Float[Array, "n d"], share: float, rng: np.random.Generator
) -> Bool[Array, "n n"]:
    """A random graph with a share of all edges, made to have stabilising gains.

    In it is a ring in which every vertex has the two before it and the two after it as
    neighbours, and others are drawn. Take w on the triangle of each vertex and the two before
    it with w·p = 0 and w·1 = 0. Then L = Σ w wᴴ is positive semidefinite, and zero on p and 1
    alone if the two before never have the same p: what they have settles all that follow. In
    the plane it takes that no point stands above another; for the heights, the ring alternates
    between low and high ones, and fewer than half of the points may be at one height, or all.

    Args:
        points: The formation, at least four [m].
        share: Of the n (n − 1) / 2 edges of the complete graph.
        rng: Draws the ring and the other edges.

    Raises:
        ValueError: The share is more than all edges or less than the ring.
    """
    n = len(points)
    if n < 4:
        raise ValueError(f"a sparse graph needs at least 4 points, got {n}")
    every = n * (n - 1) // 2
    graph = _ring_graph(points, rng)
    least, edges = int(graph.sum()) // 2, round(share * every)
    if not least <= edges <= every:
        raise ValueError(
            f"a share of {share:g} of the {every} edges between {n} points makes {edges}, and the "
            f"graph needs {least} to hold together and has {every} at most: "
            f"{ceil(1e4 * least / every) / 1e4:g} to 1 would do"
        )
    i, j = np.nonzero(np.triu(~graph, 1))
    more = rng.choice(len(i), size=edges - least, replace=False)
    graph[i[more], j[more]] = graph[j[more], i[more]] = True
    return graph


def _ring_graph(points: Float[Array, "n d"], rng: np.random.Generator) -> Bool[Array, "n n"]:
    n = len(points)
    height = points[:, 2] if points.shape[1] == 3 else np.zeros(n)
    mixed = rng.permutation(n)
    upward = mixed[np.argsort(height[mixed], kind="stable")]
    turn = np.empty(n, dtype=int)
    turn[::2], turn[1::2] = upward[: (n + 1) // 2], upward[(n + 1) // 2 :]
    graph = np.zeros((n, n), dtype=bool)
    for step in range(1, RING_NEIGHBORS // 2 + 1):
        after = np.roll(turn, step)
        graph[turn, after] = graph[after, turn] = True
    return graph & ~np.eye(n, dtype=bool)


def _sample_in_box(
    count: int, box: Sequence[float], separation: float, rng: np.random.Generator, axes: int
) -> Float[Array, "count d"]:
    check_count(count)
    if len(box) not in (2, 3) or not min(box) >= 0 or not min(box[:2]) > 0:
        raise ValueError(f"a box has two or three positive sides, got {list(box)} m")
    if not separation >= 0:
        raise ValueError(f"the separation must not be negative, got {separation} m")
    sides = np.array(box, dtype=float)
    try:
        return sample_separated_points(
            lambda: rng.uniform(0, sides), count, separation, np.empty((0, len(box))), axes
        )
    except NoRoomError as full:
        raise ValueError(
            _no_room_message(count, sides, separation, full.placed_count, axes)
        ) from full


def _no_room_message(
    count: int, sides: Float[Array, " d"], separation: float, done: int, axes: int
) -> str:
    # Flatter than the separation is as good as flat.
    axes = 2 if axes == 3 and sides[2] < separation else axes
    each = {2: pi / 4, 3: pi / 6}[axes] * separation**axes
    grow = max(1.1, (count * each / PACKING_FRACTION[axes] / sides[:axes].prod()) ** (1 / axes))
    larger = [*(grow * sides[:axes]), *sides[axes:]]
    return (
        f"a box of {_format_sides(sides)} m is full after {done} of {count} points {separation:g} m apart; "
        f"{_format_sides([ceil(side * 10) / 10 for side in larger])} m would do, or fewer points, or a "
        "smaller separation"
    )


def _format_sides(sides: Sequence[float] | Float[Array, " d"]) -> str:
    return " × ".join(f"{side:g}" for side in sides)
