"""Initial poses: drawn at random until the graph is connected, or listed one by one."""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import BeforeValidator

from dynamics.units import Length, Unit
from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.scenario.definition import (
    Definition,
    Matrix,
    NotNegative,
    Positive,
    Vector,
    as_array,
)
from sato.scenario.errors import InputError
from sato.shapes.random_points import NoRoomError, sample_separated_points

MAX_DRAWS = 500  # of a whole swarm, before its connectivity is given up
BOX_OF_SIX = (8.0, 8.0, 3.0)  # sides for six agents; the volume grows with their number [m]

Sides = Annotated[
    tuple[Annotated[float, Positive], ...],
    BeforeValidator(lambda value: tuple(as_array(value, 1).tolist())),
]


@dataclass(frozen=True, eq=False, repr=False)
class Poses(Definition):
    """Poses one by one."""

    kind: ClassVar[str] = "points"
    positions: Annotated[Matrix, Unit("m"), "one row an agent"]
    yaw: Annotated[Vector, Unit("rad"), "one yaw an agent"] = None  # type: ignore[assignment]


@dataclass(frozen=True, eq=False, repr=False)
class RandomPoses(Definition):
    """Poses at random in a box, until λ₂ is large enough."""

    kind: ClassVar[str] = "random"
    box: Annotated[
        Sides | None, Unit("m"), "sides of the box; 8 x 8 x 3 for each six agents if absent"
    ] = None
    height: Annotated[Length, "height of its floor"] = 3.0
    separation: Annotated[Length, Positive, "least distance of two agents"] = 1.8
    lambda2: Annotated[float, NotNegative, "λ₂ that the graph exceeds"] = 0.05

    def check(self) -> None:
        """Refuse a box that is not in space."""
        if self.box is not None and len(self.box) != 3:
            raise InputError("box_m", f"needs 3 sides, got {len(self.box)}")

    def draw(self, agents: int, camera: Camera, rng: np.random.Generator) -> Poses:
        """Draw poses until λ₂ is large enough.

        Raises:
            InputError: There is no room, or no such graph in many draws.
        """
        box = np.array(self.box or np.array(BOX_OF_SIX) * (agents / 6) ** (1 / 3))
        floor, best = np.array([0.0, 0.0, self.height]), 0.0
        for _ in range(MAX_DRAWS):
            try:
                position = sample_separated_points(
                    lambda: floor + rng.uniform(0, 1, 3) * box,
                    agents,
                    self.separation,
                    np.empty((0, 3)),
                    3,
                )
            except NoRoomError as full:
                raise InputError(
                    "box_m",
                    f"a box of {_sides(box)} m is full after {full.placed_count} of {agents} "
                    f"robots {self.separation:g} m apart; {_sides(1.5 * box)}, or fewer robots, "
                    "or a smaller separation_m, would do",
                ) from full
            yaw = rng.uniform(-np.pi, np.pi, agents)
            weights = interaction_graph(position, yaw, camera).weights
            found = float(algebraic_connectivity(weights).lambda2)
            if found > self.lambda2:
                return Poses(position, yaw)
            best = max(best, found)
        less = f"lambda2 = {best / 2:.3g}, or " if best > 0 else ""
        raise InputError(
            "lambda2",
            f"none of {MAX_DRAWS} draws in a box of {_sides(box)} m reaches {self.lambda2:g}, the "
            f"best has {best:.3g}; {less}a box between separation_m = {self.separation:g} and "
            f"the cameras' range of {camera.d_max:g} m would do",
        )


Start = RandomPoses | Poses


def as_poses(value: Any) -> Any:
    """Convert an array of positions to `Poses`; leave anything else as it is."""
    return Poses(as_array(value, 2)) if isinstance(value, Array | list | tuple) else value


def _sides(sides: Float[Array, " 3"]) -> str:
    return " × ".join(f"{side:.3g}" for side in sides)
