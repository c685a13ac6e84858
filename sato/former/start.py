"""Where a swarm starts: drawn at random, listed, or in a shape."""

from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from dynamics.trajectory_geometry import min_distance
from sato.former.refusal import Refusal, upward
from sato.former.shape import Lattice, Picture, Points, Polygon, Ring, Shape, Text, centre, rows
from sato.former.units import Table
from sato.network.graph import CommunicationGraph
from sato.shapes.random_points import PACKING_FRACTION, NoRoomError, sample_separated_points

DRAWINGS = 200  # of a whole swarm, before its network is given up
HEARD = 10  # neighbours on average in a box of no stated size: enough to hang together


class Place(NamedTuple):
    """What surrounds those who start."""

    axes: int
    comm_radius: float  # [m]
    collision_radius: float  # [m]
    taken: Float[Array, "k d"]  # where others are [m]


class Random(Table):
    """Drawn from a box, none closer to another than the separation."""

    kind: Literal["random"]
    box_m: PositiveFloat | None = None  # side; without it, each agent hears about ten others
    depth_m: NonNegativeFloat | None = None  # side along z; without it, as the others; 0 is flat
    separation_m: PositiveFloat
    centre_m: list[float] | None = None
    min_components: PositiveInt | None = None  # of the network at the start
    connected: bool = False

    def positions(
        self, count: int, place: Place, rng: np.random.Generator
    ) -> Float[Array, "count d"]:
        """Draw until the network is as it is wanted.

        Raises:
            Refusal: No room, or no such network in many drawings.
        """
        if self.connected and (self.min_components or 1) > 1:
            raise Refusal("min_components", "is more than 1, and connected = true asks for 1")
        if self.separation_m < place.collision_radius:
            raise Refusal(
                "separation_m",
                f"{self.separation_m:g} lets agents start closer than the collision radius; "
                f"{place.collision_radius:g} or more would do",
            )
        if self.depth_m is not None and (place.axes == 2 or self.box_m is None):
            lacking = "a model in space" if place.axes == 2 else "a box_m for its other sides"
            raise Refusal("depth_m", f"needs {lacking}")
        box = self.box_m or _roomy(count, place)
        middle = centre(self.centre_m, place.axes)
        components = 0
        for _ in range(DRAWINGS):
            drawn = self._throw(count, box, middle, place, rng)
            if not self.connected and self.min_components is None:
                return drawn
            network = CommunicationGraph.from_positions(
                drawn, place.comm_radius, np.ones(count, dtype=bool)
            )
            components = int(network.component.max()) + 1
            if components == 1 if self.connected else components >= (self.min_components or 1):
                return drawn
        if self.connected:
            raise Refusal(
                "connected",
                f"none of {DRAWINGS} drawings in a box of {box:.4g} m hangs together (the last is "
                f"in {components} parts); a smaller box_m or a larger comm_radius_m would do",
            )
        raise Refusal(
            "min_components",
            f"none of {DRAWINGS} drawings in a box of {box:.4g} m has {self.min_components} "
            f"components (the last has {components}); a larger box_m would do",
        )

    def _throw(
        self,
        count: int,
        box: float,
        middle: Float[Array, " d"],
        place: Place,
        rng: np.random.Generator,
    ) -> Float[Array, "count d"]:
        half = np.array([box, box, box if self.depth_m is None else self.depth_m]) / 2
        half = half[: place.axes]
        try:
            return sample_separated_points(
                lambda: middle + rng.uniform(-half, half),
                count,
                self.separation_m,
                place.taken,
                place.axes,
            )
        except NoRoomError as full:
            raise Refusal("box_m", self._full(count, box, full.placed_count, place)) from full

    def _full(self, count: int, box: float, done: int, place: Place) -> str:
        s, everyone = self.separation_m, count + len(place.taken)
        disc, ball = np.pi / 4 * s**2 / PACKING_FRACTION[2], np.pi / 6 * s**3 / PACKING_FRACTION[3]
        if place.axes == 2 or (self.depth_m is not None and self.depth_m < s):
            enough = (everyone * disc) ** (1 / 2)
        elif self.depth_m is None:
            enough = (everyone * ball) ** (1 / 3)
        else:
            enough = (everyone * ball / self.depth_m) ** (1 / 2)
        room = f"box_m = {upward(enough)} would do" if enough > box else "put it elsewhere"
        return (
            f"a box of {box:.4g} m is full after {done} of {count} agents {s:g} m apart; "
            f"{room}, or fewer agents, or a smaller separation_m"
        )


class Listed(Table):
    """Given one by one, at rest unless their velocities are given too."""

    kind: Literal["points"]
    file: str | None = None
    positions_m: list[list[float]] | None = None
    velocities_m_s: list[list[float]] | None = None

    def positions(
        self, count: int, place: Place, rng: np.random.Generator
    ) -> Float[Array, "count d"]:
        """As they are listed.

        Raises:
            Refusal: There are more or fewer than agents, or in another space.
        """
        listed = Points(
            kind="points", file=self.file, positions_m=self.positions_m, keep_order=True
        )
        if self.positions_m is not None and len(self.positions_m) != count:
            raise Refusal(
                "positions_m", f"lists {len(self.positions_m)} positions for {count} agents"
            )
        return listed.place(count, place.axes, 0.0)

    def velocities(self, count: int, axes: int) -> Float[Array, "count d"] | None:
        """As they are listed, if they are.

        Raises:
            Refusal: There are more or fewer than agents, or in another space.
        """
        if self.velocities_m_s is None:
            return None
        try:
            listed = rows(self.velocities_m_s, "velocities_m_s")
        except ValueError as error:
            raise Refusal("velocities_m_s", str(error)) from error
        if listed.shape != (count, axes):
            raise Refusal(
                "velocities_m_s",
                f"needs {count} rows of {axes}, got {len(listed)} of {listed.shape[1]}",
            )
        return listed


AnyStart = Annotated[
    Random | Listed | Text | Ring | Lattice | Polygon | Picture, Field(discriminator="kind")
]


def positions(
    start: AnyStart, count: int, place: Place, rng: np.random.Generator
) -> Float[Array, "count d"]:
    """Where the agents of one start are.

    Raises:
        Refusal: They have no room, or two are closer than the collision radius.
    """
    if isinstance(start, Shape):
        placed = start.place(count, place.axes, place.collision_radius)
    else:
        placed = start.positions(count, place, rng)
    _refuse_close(placed, place)
    return placed


def portable(start: AnyStart, count: int, axes: int) -> AnyStart:
    """The same start without what lies outside the scenario: files and installed fonts."""
    if isinstance(start, Listed) and start.file is not None:
        points: Shape = Points(kind="points", file=start.file, keep_order=True)
        velocities = start.velocities_m_s
    elif isinstance(start, Shape) and start.outside:
        points, velocities = start, None
    else:
        return start
    listed = points.place(count, axes, 0.0).tolist()
    return Listed(kind="points", positions_m=listed, velocities_m_s=velocities)


def _refuse_close(placed: Float[Array, "count d"], place: Place) -> None:
    from scipy.spatial import cKDTree

    everyone = np.concatenate([placed, place.taken])
    radius = place.collision_radius * (1 - 1e-9)  # rounding is no collision
    if min_distance(everyone) >= radius:
        return
    distance, near = cKDTree(everyone).query(placed, k=2)
    i = int(np.argmin(distance[:, 1]))
    if distance[i, 1] >= radius:
        return  # the others' own affair
    j = int(near[i, 1]) if near[i, 1] != i else int(near[i, 0])
    other = f"agent {j}" if j < len(placed) else "one who is there already"
    raise Refusal(
        "",
        f"agent {i} starts {distance[i, 1]:.4g} m from {other}, closer than the collision radius "
        f"of {place.collision_radius:g} m; move one of them",
    )


def _roomy(count: int, place: Place) -> float:
    ball = {2: np.pi, 3: 4 / 3 * np.pi}[place.axes] * place.comm_radius**place.axes
    return float((count * ball / HEARD) ** (1 / place.axes))
