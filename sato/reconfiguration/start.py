"""Initial positions: drawn at random, given one by one, or in a shape."""

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance
from dynamics.units import Length, Unit
from sato.network.graph import CommunicationGraph
from sato.scenario.definition import Coordinates, Definition, NotNegative, Positive
from sato.scenario.errors import InputError, round_up
from sato.shapes import Lattice, Picture, Points, Polygon, Ring, Shape, Text
from sato.shapes.random_points import PACKING_FRACTION, NoRoomError, sample_separated_points
from sato.shapes.shape import center_in

MAX_DRAWS = 200  # of a whole swarm, before its graph is given up
MEAN_NEIGHBORS = 10  # in a box of no stated size: enough for a connected graph


class Surroundings(NamedTuple):
    """Space in which agents start."""

    axes: int
    hearing_distance: float  # communication radius [m]
    min_distance: float  # collision radius [m]
    occupied: Float[Array, "k d"]  # positions of agents that are there already [m]


@dataclass(frozen=True, eq=False, repr=False)
class Random(Definition):
    """Positions drawn from a box, none closer to another than the separation."""

    kind: ClassVar[str] = "random"
    separation: Annotated[Length, Positive, "least distance of two agents"]
    box: Annotated[
        float | None, Unit("m"), Positive, "side of the box; about ten neighbors each if absent"
    ] = None
    depth: Annotated[
        float | None, Unit("m"), NotNegative, "side along z; as the others if absent, 0 is flat"
    ] = None
    center: Annotated[Coordinates | None, Unit("m"), "center of the box; the origin if absent"] = (
        None
    )
    min_components: Annotated[int | None, Ge(1), "connected components, at least"] = None
    connected: Annotated[bool, "draw until the graph is connected"] = False

    def check(self) -> None:
        """Refuse a connected graph of several components."""
        if self.connected and (self.min_components or 1) > 1:
            raise InputError("min_components", "is more than 1, and connected = true asks for 1")

    def draw(
        self, count: int, around: Surroundings, rng: np.random.Generator
    ) -> Float[Array, "count d"]:
        """Draw until the graph is as it is wanted.

        Raises:
            InputError: There is no room, or no such graph in many draws.
        """
        if self.separation < around.min_distance:
            raise InputError(
                "separation_m",
                f"{self.separation:g} lets agents start closer than the collision radius; "
                f"{around.min_distance:g} or more would do",
            )
        if self.depth is not None and (around.axes == 2 or self.box is None):
            missing = "a model in space" if around.axes == 2 else "a box_m for its other sides"
            raise InputError("depth_m", f"needs {missing}")
        box = self.box or _default_box(count, around)
        center = center_in(self.center, around.axes)
        components = 0
        for _ in range(MAX_DRAWS):
            drawn = self._draw_once(count, box, center, around, rng)
            if not self.connected and self.min_components is None:
                return drawn
            graph = CommunicationGraph.from_positions(
                drawn, around.hearing_distance, np.ones(count, dtype=bool)
            )
            components = int(graph.component.max()) + 1
            if components == 1 if self.connected else components >= (self.min_components or 1):
                return drawn
        if self.connected:
            raise InputError(
                "connected",
                f"none of {MAX_DRAWS} draws in a box of {box:.4g} m is connected (the last has "
                f"{components} components); a smaller box_m or a larger comm_radius_m would do",
            )
        raise InputError(
            "min_components",
            f"none of {MAX_DRAWS} draws in a box of {box:.4g} m has {self.min_components} "
            f"components (the last has {components}); a larger box_m would do",
        )

    def _draw_once(
        self,
        count: int,
        box: float,
        center: Float[Array, " d"],
        around: Surroundings,
        rng: np.random.Generator,
    ) -> Float[Array, "count d"]:
        half = np.array([box, box, box if self.depth is None else self.depth]) / 2
        half = half[: around.axes]
        try:
            return sample_separated_points(
                lambda: center + rng.uniform(-half, half),
                count,
                self.separation,
                around.occupied,
                around.axes,
            )
        except NoRoomError as full:
            raise InputError("box_m", self._full(count, box, full.placed_count, around)) from full

    def _full(self, count: int, box: float, placed: int, around: Surroundings) -> str:
        s, total = self.separation, count + len(around.occupied)
        disc, ball = np.pi / 4 * s**2 / PACKING_FRACTION[2], np.pi / 6 * s**3 / PACKING_FRACTION[3]
        if around.axes == 2 or (self.depth is not None and self.depth < s):
            enough = (total * disc) ** (1 / 2)
        elif self.depth is None:
            enough = (total * ball) ** (1 / 3)
        else:
            enough = (total * ball / self.depth) ** (1 / 2)
        cure = f"box_m = {round_up(enough)} would do" if enough > box else "another center_m"
        return (
            f"a box of {box:.4g} m is full after {placed} of {count} agents {s:g} m apart; "
            f"{cure}, or fewer agents, or a smaller separation_m"
        )


Start = Random | Points | Text | Ring | Lattice | Polygon | Picture


def draw_positions(
    start: Start, count: int, around: Surroundings, rng: np.random.Generator
) -> Float[Array, "count d"]:
    """Return the positions of the agents of one start.

    Raises:
        InputError: They have no room, or two are closer than the collision radius.
    """
    if isinstance(start, Random):
        placed = start.draw(count, around, rng)
    elif isinstance(start, Points):
        if start.positions is not None and len(start.positions) != count:
            raise InputError(
                "positions_m", f"lists {len(start.positions)} positions for {count} agents"
            )
        placed = replace(start, keep_order=True).place(count, around.axes, 0.0)
    else:
        placed = start.place(count, around.axes, around.min_distance)
    _check_separation(placed, around)
    return placed


def start_without_files(start: Start, count: int, axes: int) -> Start:
    """Return the same start with the contents of files and fonts."""
    if not isinstance(start, Shape) or not start.uses_files:
        return start
    kept = replace(start, keep_order=True) if isinstance(start, Points) else start
    listed: Points = kept.without_files(count, axes)
    return listed


def _check_separation(placed: Float[Array, "count d"], around: Surroundings) -> None:
    from scipy.spatial import cKDTree

    together = np.concatenate([placed, around.occupied])
    radius = around.min_distance * (1 - 1e-9)  # rounding is no collision
    if min_distance(together) >= radius:
        return
    distance, near = cKDTree(together).query(placed, k=2)
    i = int(np.argmin(distance[:, 1]))
    if distance[i, 1] >= radius:
        return  # two agents that were there before
    j = int(near[i, 1]) if near[i, 1] != i else int(near[i, 0])
    other = f"agent {j}" if j < len(placed) else "an agent that is there already"
    raise InputError(
        "",
        f"agent {i} starts {distance[i, 1]:.4g} m from {other}, closer than the collision radius "
        f"of {around.min_distance:g} m; move one of them",
    )


def _default_box(count: int, around: Surroundings) -> float:
    ball = {2: np.pi, 3: 4 / 3 * np.pi}[around.axes] * around.hearing_distance**around.axes
    return float((count * ball / MEAN_NEIGHBORS) ** (1 / around.axes))
