"""Initial poses: drawn at random until the graph is connected, or listed one by one."""

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy import ndarray as Array

from dynamics.labels import to_plain
from dynamics.units import Length, Unit
from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.connectivity.obstacles import Point
from sato.scenario.definition import (
    LATER,
    TURNS,
    Definition,
    Matrix,
    NotNegative,
    Positive,
    Vector,
    as_array,
    errors_in,
)
from sato.scenario.errors import InputError
from sato.shapes.random_points import sample_positions

MAX_DRAWS = 500  # of a whole swarm, before its connectivity is given up
BOX_OF_SIX = (8.0, 8.0, 3.0)  # sides for six agents; the volume grows with their number [m]


@dataclass(frozen=True, eq=False, repr=False)
class Poses(Definition):
    """Poses one by one."""

    kind: ClassVar[str] = "points"
    positions: Annotated[Matrix, Unit("m"), "one row an agent"]
    yaw: Annotated[Vector, Unit("rad"), TURNS, "one yaw an agent"] = LATER


@dataclass(frozen=True, eq=False, repr=False)
class RandomPoses(Definition):
    """Poses at random in a box, until λ₂ is large enough."""

    kind: ClassVar[str] = "random"
    box: Annotated[
        Point | None, Unit("m"), "sides of the box; 8 x 8 x 3 for each six agents if absent"
    ] = None
    height: Annotated[Length, "height of its floor"] = 3.0
    separation: Annotated[Length, Positive, "least distance of two agents"] = 1.8
    lambda2: Annotated[float, NotNegative, "λ₂ that the graph exceeds"] = 0.05

    def draw(self, agents: int, camera: Camera, rng: np.random.Generator) -> Poses:
        """Draw poses until λ₂ is large enough; refuse a box without room for them."""
        box = self.box or np.array(BOX_OF_SIX) * (agents / 6) ** (1 / 3)
        best, floor = 0.0, np.array([0.0, 0.0, self.height])
        for _ in range(MAX_DRAWS):
            with errors_in("box_m"):
                position = floor + sample_positions(agents, tuple(box), self.separation, rng)
            yaw = rng.uniform(-np.pi, np.pi, agents)
            weights = interaction_graph(position, yaw, camera).weights
            found = float(algebraic_connectivity(weights).lambda2)
            if found > self.lambda2:
                return Poses(position, yaw)
            best = max(best, found)
        raise InputError(
            "lambda2",
            f"none of {MAX_DRAWS} draws reaches {self.lambda2:g}, the best has {best:.3g}; "
            f"{best / 2:.3g}, or a smaller box, would do",
        )


def as_poses(value: Any) -> Any:
    """Convert an array of positions to `Poses`; leave anything else as it is."""
    value = to_plain(value, "m")
    return Poses(as_array(value, 2)) if isinstance(value, Array | list | tuple) else value
