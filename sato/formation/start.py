"""Initial positions of a formation flight, all agents at rest."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Len
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.distance import pdist, squareform

from dynamics.units import Length, Unit
from sato.scenario.definition import Coordinates, Definition, Positive, errors_in
from sato.scenario.errors import InputError
from sato.shapes import AnyShape, Lattice, Points, Shape
from sato.shapes.random_points import sample_positions


@dataclass(frozen=True, eq=False, repr=False)
class RandomStart(Definition):
    """Positions drawn from a rectangle, all at one height."""

    kind: ClassVar[str] = "random"
    box: Annotated[Coordinates, Len(2, 2), Unit("m"), "sides along x and y, from the origin on"]
    separation: Annotated[Length, Positive, "least distance of two agents"]
    height: Annotated[Length, "height of all agents"] = 1.0


AnyStart = RandomStart | AnyShape


def draw_start(
    start: AnyStart, agents: int, keep_out: float, rng: np.random.Generator
) -> Float[Array, "agents 3"]:
    """Return the initial position of every agent [m].

    Args:
        start: Random start, points or shape.
        agents: Number of agents.
        keep_out: Least distance of two of them in the plane [m].
        rng: Generator for a random start.

    Raises:
        InputError: There is no such start, or two agents are too close in it.
    """
    if isinstance(start, RandomStart):
        check_drawn_separation(start.separation, keep_out)
        with errors_in("box_m"):
            flat = sample_positions(agents, start.box, start.separation, rng)
        placed = np.column_stack([flat, np.full(agents, start.height)])
    elif isinstance(start, Points):
        placed = place_level(replace(start, keep_order=True), agents, 0.0)
    else:
        placed = place_level(start, agents, keep_out)
    check_separation(placed, keep_out)
    return placed


def place_level(shape: Shape, count: int, min_distance: float) -> Float[Array, "count 3"]:
    """Place a shape in space; a lattice is flat, for no vehicle may be above another."""
    if shape.place_velocities(count, 3) is not None:
        raise InputError("", "has velocities, and vehicles begin and end at rest; drop them")
    level = np.zeros((count, 3))
    placed = shape.place(count, 2 if isinstance(shape, Lattice) else 3, min_distance)
    level[:, : placed.shape[1]] = placed
    return level


def check_separation(placed: Float[Array, "n 3"], keep_out: float) -> None:
    """Refuse points that are closer in the plane than agents are allowed to come."""
    distance = squareform(pdist(placed[:, :2]))
    np.fill_diagonal(distance, np.inf)
    if distance.min() < keep_out * (1 - 1e-9):  # rounding is not too close
        i, j = sorted(int(k) for k in np.unravel_index(distance.argmin(), distance.shape))
        text = f"{i} and {j} are {distance.min():.3g} m apart in the plane, closer than"
        raise InputError("", f"{text} keep_out_m = {keep_out:g}; move one of them")


def check_drawn_separation(separation: float, keep_out: float) -> None:
    """Refuse random points that may be closer than the agents are allowed to come."""
    if separation < keep_out:
        text = f"{separation:g} is less than keep_out_m = {keep_out:g}"
        raise InputError("separation_m", f"{text}; {keep_out:g} or more would do")
