"""Random points with a least distance, for starts and formations."""

from collections.abc import Callable, Sequence
from math import ceil, pi
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked
from sato.scenario.definition import Amount, NotNegative

Box = Sequence[float]  # sides [m]
Separation = Annotated[float, NotNegative]  # [m]
MAX_REJECTIONS = 10_000  # successive rejections after which there is taken to be no room
PACKING_FRACTION = {2: 0.4, 3: 0.25}  # share of a box that points fill while sampling stays quick


class NoRoomError(ValueError):
    """Error for points that do not fit, with the number of those that did."""

    def __init__(self, placed_count: int) -> None:
        super().__init__(f"no room after {placed_count} points")
        self.placed_count = placed_count


def sample_separated(
    draw: Callable[[], Array], count: int, separation: float, occupied: Array, axes: int
) -> Float[Array, "count d"]:
    """Draw points one by one, each again until it is far enough from the others.

    The separation is the least distance between two of them, or to an occupied point [m]. It is
    measured along so many axes, from the first on.
    After `MAX_REJECTIONS` draws in a row that are too close there is no room.
    """
    points = np.concatenate([occupied, np.empty((count, occupied.shape[1]))])
    k, rejections = len(occupied), 0
    while k < len(points):
        drawn = draw()
        if np.all(np.sum((points[:k, :axes] - drawn[:axes]) ** 2, axis=1) >= separation**2):
            points[k] = drawn
            k, rejections = k + 1, 0
        elif (rejections := rejections + 1) == MAX_REJECTIONS:
            raise NoRoomError(k - len(occupied))
    return points[len(occupied) :]


@checked
def sample_positions(
    count: Amount, box: Box, separation: Separation, rng: np.random.Generator, axes: int = 0
) -> Float[Array, "count d"]:
    """Draw positions with a least distance in a box of two or three sides from the origin on [m].

    The trials of [Lusk2020, sec. V-A] start 30 vehicles in 20 m × 20 m, 1.5 m apart. Distance is
    measured along so many axes, from the first on, or else along all.
    """
    if len(box) not in (2, 3) or not min(box) >= 0 or not min(box[:2]) > 0:
        raise ValueError(f"a box has two or three positive sides, got {list(box)} m")
    sides, d = np.array(box, dtype=float), axes or len(box)
    occupied = np.empty((0, len(box)))
    try:
        return sample_separated(lambda: rng.uniform(0, sides), count, separation, occupied, d)
    except NoRoomError as full:
        # A box that is lower than the separation holds no more than a plane.
        d = 2 if d == 3 and sides[2] < separation else d
        needed = count * (pi / 4 if d == 2 else pi / 6) * separation**d / PACKING_FRACTION[d]
        grow = max(1.1, (needed / sides[:d].prod()) ** (1 / d))
        larger = [ceil(side * 10) / 10 for side in [*(grow * sides[:d]), *sides[d:]]]
        shown, cure = (" × ".join(f"{side:g}" for side in each) for each in (sides, larger))
        found = f"{full.placed_count} of {count} points {separation:g} m apart"
        cure = f"{cure} m would do, or fewer points, or a smaller separation"
        raise ValueError(f"a box of {shown} m is full after {found}; {cure}") from full


@checked
def sample_formation(
    count: Amount, box: Box, separation: Separation, rng: np.random.Generator
) -> Float[Array, "count 3"]:
    """Draw points with a least horizontal distance in a box of three sides from the origin on [m].

    The trials of [Lusk2020, sec. V-A] take 30 points in 15 m × 15 m × 2 m, 2 m apart; its
    implementation measures the distance in the plane because of the downwash of a vehicle above.
    """
    if len(box) != 3:
        raise ValueError(f"a formation is drawn in a box of three sides, got {len(box)}")
    return sample_positions(count, box, separation, rng, axes=2)
