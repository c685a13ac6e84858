"""Starts: at random in a box, given one by one, or in a shape."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Length, Unit
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.allowed_places import is_free
from sato.scenario.definition import Coordinates, Definition, NotNegative, Positive
from sato.scenario.errors import InputError, round_up
from sato.shapes import Lattice, Picture, Points, Polygon, Ring, Shape, Text
from sato.shapes.random_points import PACKING_FRACTION, NoRoomError, sample_separated
from sato.shapes.shape import center_in

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Reconfiguration

MAX_DRAWS = 200  # of a whole swarm, before its graph is given up
MEAN_NEIGHBORS = 10  # in a box of no stated size: enough for a connected graph


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
    center: Annotated[Coordinates | None, Unit("m"), "its center; the origin if absent"] = None
    min_components: Annotated[int | None, Ge(1), "connected components, at least"] = None
    connected: Annotated[bool, "draw until the graph is connected"] = False

    def check(self) -> None:
        """Refuse a connected graph of several components."""
        if self.connected and (self.min_components or 1) > 1:
            raise InputError("min_components", "is more than 1, and connected = true asks for 1")

    def draw(
        self,
        mission: "Reconfiguration",
        count: int,
        occupied: Float[Array, "k d"],
        rng: np.random.Generator,
    ) -> Float[Array, "count d"]:
        """Draw positions [m] until the graph is as it is wanted.

        Args:
            mission: Space and radii.
            count: Number of agents.
            occupied: Positions of agents that are there already [m].
            rng: Draws the positions.

        Raises:
            InputError: There is no room, or no such graph in many draws.
        """
        axes, least = mission.axes, mission.largest_separation
        if self.separation < least:
            reason = f"{self.separation:g} is less than the collision radius"
            raise InputError("separation_m", f"{reason}; {least:g} or more would do")
        if (self.min_components or 0) > count:
            reason = f"is {self.min_components}, and there are {count} agents"
            raise InputError("min_components", f"{reason}; {count} or less would do")
        if self.depth is not None and (axes == 2 or self.box is None):
            missing = "a model in space" if axes == 2 else "a box_m for its other sides"
            raise InputError("depth_m", f"needs {missing}")
        ball = {2: np.pi, 3: 4 / 3 * np.pi}[axes] * mission.comm_radius**axes
        box = self.box or float((count * ball / MEAN_NEIGHBORS) ** (1 / axes))
        half = np.array([box, box, box if self.depth is None else self.depth])[:axes] / 2
        center = center_in(self.center, axes)
        components = 0

        def sample() -> Float[Array, " axes"]:
            for _ in range(MAX_DRAWS):
                place = center + rng.uniform(-half, half)
                if is_free(mission, place):
                    return place
            raise InputError("box_m", f"obstacles fill a box of {box:.4g} m; a larger one would do")

        for _ in range(MAX_DRAWS):
            try:
                drawn = sample_separated(sample, count, self.separation, occupied, axes)
            except NoRoomError as full:
                reason = f"a box of {box:.4g} m is full after {full.placed_count} of {count} agents"
                cure = self._larger_box(box, count + len(occupied), axes)
                raise InputError("box_m", f"{reason} {self.separation:g} m apart; {cure}") from full
            if not self.connected and self.min_components is None:
                return drawn
            alive = np.ones(count, dtype=bool)
            graph = CommunicationGraph.from_positions(drawn, mission.comm_radius, alive)
            components = int(graph.component.max()) + 1
            if components == 1 if self.connected else components >= (self.min_components or 1):
                return drawn
        draws = f"none of {MAX_DRAWS} draws in a box of {box:.4g} m"
        if self.connected:
            reason = f"{draws} is connected (the last has {components} components)"
            cure = "a smaller box_m or a larger comm_radius_m would do"
            raise InputError("connected", f"{reason}; {cure}")
        reason = f"{draws} has {self.min_components} components (the last has {components})"
        raise InputError("min_components", f"{reason}; a larger box_m would do")

    def _larger_box(self, box: float, total: int, axes: int) -> str:
        s = self.separation
        disc, ball = np.pi / 4 * s**2 / PACKING_FRACTION[2], np.pi / 6 * s**3 / PACKING_FRACTION[3]
        if axes == 2 or (self.depth is not None and self.depth < s):
            enough = (total * disc) ** (1 / 2)
        elif self.depth is None:
            enough = (total * ball) ** (1 / 3)
        else:
            enough = (total * ball / self.depth) ** (1 / 2)
        cure = f"box_m = {round_up(enough)} would do" if enough > box else "another center_m"
        return f"{cure}, or fewer agents, or a smaller separation_m"


Start = Random | Points | Text | Ring | Lattice | Polygon | Picture


def start_without_files(start: Start, count: int, axes: int) -> Start:
    """Return the same start with the contents of files and fonts."""
    if not isinstance(start, Shape) or not start.uses_files:
        return start
    kept = replace(start, keep_order=True) if isinstance(start, Points) else start
    listed: Points = kept.without_files(count, axes)
    return listed
