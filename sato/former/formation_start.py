"""Where vehicles hover before they are called into a formation."""

from math import inf
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import Field, PositiveFloat
from scipy.spatial.distance import pdist, squareform

from sato.former.refusal import Refusal
from sato.former.shape import Lattice, Picture, Points, Polygon, Ring, Shape, Text
from sato.former.start import Listed, Place
from sato.former.units import Table
from sato.shapes.random_points import sample_positions


class Scattered(Table):
    """Drawn from a box on the ground, all at one height."""

    kind: Literal["random"]
    box_m: list[PositiveFloat]  # its two sides, from the origin on
    separation_m: PositiveFloat
    height_m: float = 1.0


AnyVehicleStart = Annotated[
    Scattered | Listed | Text | Ring | Lattice | Polygon | Picture, Field(discriminator="kind")
]


def hovering(
    start: Scattered | Listed | Shape, agents: int, keep_out: float, rng: np.random.Generator
) -> Float[Array, "agents 3"]:
    """Where each vehicle starts [m].

    Args:
        start: As in the file.
        agents: How many vehicles.
        keep_out: Least distance of two of them in the plane [m].
        rng: Draws a random start.

    Raises:
        Refusal: There is no such start, or two vehicles are too near each other in it.
    """
    if isinstance(start, Scattered):
        placed = _scattered(start, agents, keep_out, rng)
    elif isinstance(start, Listed):
        if start.velocities_m_s is not None:
            raise Refusal("velocities_m_s", "vehicles start at rest; drop it")
        nobody = np.empty((0, 3))
        placed = start.positions(agents, Place(3, inf, keep_out, nobody), rng)
    else:
        placed = level(start, agents, keep_out)
    apart = squareform(pdist(placed[:, :2]))
    np.fill_diagonal(apart, np.inf)
    if apart.min() < keep_out * (1 - 1e-9):  # rounding is not too near
        i, j = sorted(int(k) for k in np.unravel_index(apart.argmin(), apart.shape))
        raise Refusal(
            "",
            f"vehicles {i} and {j} start {apart.min():.4g} m apart in the plane, nearer than "
            f"keep_out_m = {keep_out:g}; move one of them",
        )
    return placed


def level(shape: Shape, count: int, least: float) -> Float[Array, "count 3"]:
    """Places of a shape; nobody is above another, so a lattice is one in the plane."""
    stood = np.zeros((count, 3))
    placed = shape.place(count, 2 if isinstance(shape, Lattice) else 3, least)
    stood[:, : placed.shape[1]] = placed
    return stood


def listed(shape: Shape, count: int) -> Points:
    """The places of a shape one by one."""
    return Points(kind="points", positions_m=level(shape, count, 0.0).tolist(), keep_order=True)


def check_separation(separation: float, keep_out: float) -> None:
    """What is drawn apart is apart enough.

    Raises:
        Refusal: It is not.
    """
    if separation < keep_out:
        raise Refusal(
            "separation_m",
            f"{separation:g} is less than keep_out_m = {keep_out:g}; {keep_out:g} or more would do",
        )


def _scattered(
    start: Scattered, agents: int, keep_out: float, rng: np.random.Generator
) -> Float[Array, "agents 3"]:
    check_separation(start.separation_m, keep_out)
    if len(start.box_m) != 2:
        raise Refusal("box_m", f"needs 2 sides, along x and y, got {len(start.box_m)}")
    try:
        flat = sample_positions(agents, start.box_m, start.separation_m, rng)
    except ValueError as error:
        raise Refusal("box_m", str(error)) from error
    return np.column_stack([flat, np.full(agents, start.height_m)])
