"""Scene of a run: vehicles, links, targets, obstacles and events, as viewers show them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial import ConvexHull, cKDTree

from sato.check.report import Promise
from sato.figures.style import BLUE, GRAY, GREEN, ORANGE, PURPLE, RED, style_components
from sato.network.graph import CommunicationGraph
from sato.obstacles import Obstacle

ABSENT, ALIVE, LOST = 0, 1, 2  # status of a vehicle; a lost one is still there
COMPONENT_COLORS = (
    ("largest", BLUE),
    ("second", RED),
    ("third", GREEN),
    ("fourth", ORANGE),
    ("others", PURPLE),
    ("alone", GRAY),
)
FLAT = 1e-3  # height of a flat scene, in its size

Direction = tuple[float, float, float]


class Viewpoint(NamedTuple):
    """Directions from which a scene is seen; a flat one from the first, else from the last."""

    up: Direction
    views: tuple[tuple[str, Direction], ...]  # name, and direction from the scene to the camera
    arrows: tuple[tuple[str, Direction], ...] = ()  # from the origin, with their names
    time_unit: str = "s"


GROUND = Viewpoint(
    up=(0, 0, 1),
    views=(("above", (0, -1e-4, 1)), ("side", (0, -1, 0)), ("oblique", (0.35, -0.8, 0.55))),
)
ORBIT = Viewpoint(
    up=(1, 0, 0),
    views=(
        ("orbital plane", (0, 0, -1)),
        ("along-track", (0, -1, 0)),
        ("oblique", (0.4, -0.5, -0.8)),
    ),
    arrows=(
        ("x, radial", (1, 0, 0)),
        ("y, along-track", (0, 1, 0)),
        ("z, normal", (0, 0, 1)),
        ("to the center", (-1, 0, 0)),
    ),
    time_unit="min",
)


class Links(NamedTuple):
    """Pairs of live vehicles within a radius, or listed pairs."""

    name: str
    radius: float | None = None  # [m]
    # Pairs from an instant on, until those of the next entry.
    listed: tuple[tuple[int, Int[Array, "pairs 2"]], ...] = ()


class Targets(NamedTuple):
    """Targets in stages, and those that vehicles hold."""

    name: str
    position: Float[Array, "stages targets d"]  # [m]; NaN where a stage has fewer
    stage: Int[Array, " instants"]
    held: Int[Array, "instants agents"]  # −1 none


class Hull(NamedTuple):
    """Surface of a convex obstacle at time 0, and its velocity.

    Triangles are seen from the side from which they run counterclockwise.
    """

    vertices: Float[Array, "vertices d"]  # [m]
    triangles: Int[Array, "triangles 3"]
    velocity: Float[Array, " d"]  # [m/s]


class Coloring(NamedTuple):
    """Quantity by which vehicles are colored: categories, numbers of targets, or a scale."""

    name: str
    values: Float[Array, "instants agents"]  # NaN where not known
    unit: str = ""
    categories: tuple[tuple[str, str], ...] = ()  # name and color; values are their numbers
    is_target: bool = False


class Series(NamedTuple):
    """Quantity over time, and the least that is allowed."""

    name: str
    unit: str
    values: Float[Array, " instants"]  # NaN where there is none
    limit: float
    limit_name: str
    is_held: bool = False  # each value is that of the step that follows


@dataclass(frozen=True, eq=False, kw_only=True)
class SwarmScene:
    """Run as viewers show it."""

    time: Float[Array, " instants"]  # [s]
    position: Float[Array, "instants agents d"]  # [m]
    velocity: Float[Array, "instants agents d"]  # [m/s]
    status: Int[Array, "instants agents"]  # ABSENT, ALIVE or LOST
    diameter: Float[Array, " agents"]  # two touch where they are as close as they may be [m]
    links: Links
    targets: Targets
    colorings: tuple[Coloring, ...]  # by the first, unless another is chosen
    series: tuple[Series, ...]
    stages: tuple[tuple[float, str], ...]  # start [s] and name
    events: Sequence[dict[str, Any]]  # with their times
    obstacles: tuple[Hull, ...] = ()
    viewpoint: Viewpoint = GROUND
    verdict: str = ""  # line of the report
    broken: tuple[Promise, ...] = ()  # promises that agents break at a time

    @property
    def bounds(self) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
        """Lowest and highest coordinates of vehicles that are there, and of targets [m]."""
        targets = self.targets.position.reshape(-1, self.position.shape[2])
        points = np.concatenate([self.position[self.status != ABSENT], targets])
        points = points[np.isfinite(points).all(axis=1)]
        return points.min(axis=0), points.max(axis=0)

    @property
    def is_flat(self) -> bool:
        """True where the third axis is not used."""
        size = np.subtract(*self.bounds[::-1])
        return len(size) == 2 or bool(size[2] <= FLAT * size.max())


def list_links(scene: SwarmScene, k: int) -> Int[Array, "pairs 2"]:
    """List the pairs of vehicles that are linked at an instant."""
    links, status = scene.links, scene.status[k]
    if links.radius is None:
        [*_, pairs] = [pairs for first, pairs in links.listed if first <= k]
        return pairs
    graph = CommunicationGraph.from_positions(scene.position[k], links.radius, status == ALIVE)
    return np.column_stack(graph.pairs)


def enclose_obstacle(obstacle: Obstacle) -> Hull:
    """Return the surface of an obstacle, the polygon where it is flat."""
    points = obstacle.place + obstacle.surface
    hull = ConvexHull(points)
    if points.shape[1] == 3:
        triangles = hull.simplices.astype(int)
        a, b, c = np.moveaxis(points[triangles], 1, 0)
        is_inward = np.vecdot(np.cross(b - a, c - a), hull.equations[:, :3]) < 0
        triangles[is_inward] = triangles[is_inward, ::-1]
        return Hull(points, triangles, obstacle.drift)
    corners = points[hull.vertices]
    later = np.arange(1, len(corners) - 1)
    fan = np.column_stack([np.zeros_like(later), later, later + 1])
    return Hull(corners, fan, obstacle.drift)


def color_by_component(component: Int[Array, "instants agents"]) -> Coloring:
    """Color by the rank in size of the connected component of the network."""
    rank = np.full(component.shape, np.nan)
    others, alone = len(COMPONENT_COLORS) - 2, len(COMPONENT_COLORS) - 1
    for row, labels in zip(rank, component, strict=True):
        for number, (members, _, name) in enumerate(style_components(labels)):
            row[members] = alone if name == "alone" else min(number, others)
    return Coloring("network component", rank, categories=COMPONENT_COLORS)


def color_by_target(targets: Targets) -> Coloring:
    """Color by the number of the target that each vehicle holds."""
    held = np.where(targets.held < 0, np.nan, targets.held)
    return Coloring(targets.name, held, is_target=True)


def color_by_speed(
    velocity: Float[Array, "instants agents d"], alive: Bool[Array, "instants agents"]
) -> Coloring:
    """Color live vehicles by their speed [m/s]."""
    speed = np.where(alive, np.linalg.norm(velocity, axis=2), np.nan)
    return Coloring("speed", speed, "m/s")


def nearest_distances(
    position: Float[Array, "instants agents d"], present: Bool[Array, "instants agents"]
) -> Float[Array, "instants agents"]:
    """Compute the distance of each vehicle to the nearest other [m]; NaN where not present."""
    found = np.full(present.shape, np.nan)
    present = present & np.isfinite(position).all(axis=2)
    for row, points, there in zip(found, position, present, strict=True):
        if there.sum() > 1:
            row[there] = cKDTree(points[there]).query(points[there], k=2)[0][:, 1]
    return found


def least_over_agents(values: Float[Array, "instants agents"]) -> Float[Array, " instants"]:
    """Return the least value at each instant, NaN where there is none."""
    least = np.where(np.isnan(values), np.inf, values).min(axis=1, initial=np.inf)
    return np.where(np.isfinite(least), least, np.nan)


def pad_to_space(points: Float[Array, "*k d"]) -> Float[Array, "*k 3"]:
    """Append a third coordinate of zero in the plane."""
    missing = 3 - points.shape[-1]
    return np.pad(points, [(0, 0)] * (points.ndim - 1) + [(0, missing)])
