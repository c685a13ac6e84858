"""Legs of a formation flight: desired points, the graph of neighbors, and gains."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Le
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from numpy.random import Generator
from pydantic import BeforeValidator

from dynamics.callbacks import freeze
from dynamics.inputs import read_array
from dynamics.labels import check_pair_labels
from dynamics.units import Length, Unit
from problems.desired_formation import DesiredFormation
from problems.gain_matrix import GainMatrix
from sato.formation.gains import AnyGains, DesignedGains, GainsFile, as_gains
from sato.formation.start import check_drawn_separation, check_separation, place_level
from sato.scenario.definition import (
    Amount,
    Convert,
    Coordinates,
    Definition,
    NotNegative,
    Positive,
    errors_in,
)
from sato.scenario.errors import InputError
from sato.shapes import AnyShape, Points, Shape
from sato.shapes import formation_library as library
from sato.shapes.random_points import sample_formation
from sato.shapes.shape import as_points


@dataclass(frozen=True, eq=False, repr=False)
class RandomFormation(Definition):
    """Points drawn from a box, separated as seen from above."""

    kind: ClassVar[str] = "random"
    box: Annotated[Coordinates, Unit("m"), "sides of the box along x, y and z"]
    separation: Annotated[Length, Positive, "least distance of two points in the plane"]


@dataclass(frozen=True, eq=False, repr=False)
class LibraryFormation(Definition):
    """Formation of the library."""

    kind: ClassVar[str] = "library"
    name: Annotated[str, "name in the library"]


@dataclass(frozen=True, eq=False, repr=False)
class FormationFile(Definition):
    """Points of a CSV file, in its order."""

    kind: ClassVar[str] = "file"
    file: Annotated[str, "CSV file with one point a line"]


@dataclass(frozen=True, eq=False, repr=False)
class NamedGraph(Definition):
    """Complete graph, or the graph that the library gives the formation."""

    kind: Annotated[Literal["complete", "own"], "complete, or own of the library"] = "complete"


@dataclass(frozen=True, eq=False, repr=False)
class ThinnedGraph(Definition):
    """Complete graph without some random edges."""

    kind: ClassVar[str] = "thinned"
    removals: Annotated[int, NotNegative, "number of edges drawn for removal"]


@dataclass(frozen=True, eq=False, repr=False)
class SparseGraph(Definition):
    """Random graph with a share of all edges that has stabilizing gains."""

    kind: ClassVar[str] = "sparse"
    share: Annotated[float, Gt(0), Le(1), "share of all edges"]


@dataclass(frozen=True, eq=False, repr=False)
class GraphFile(Definition):
    """Edges of a CSV file."""

    kind: ClassVar[str] = "file"
    file: Annotated[str, "CSV file with one edge a line"]


def _as_pairs(value: Any) -> Array:
    pairs = read_array(value)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu" or pairs.min() < 0:
        raise InputError("", "must be a list of pairs of points, counted from 0")
    return freeze(pairs.astype(int))


@dataclass(frozen=True, eq=False, repr=False)
class EdgeList(Definition):
    """Graph with these edges."""

    kind: ClassVar[str] = "pairs"
    pairs: Annotated[Array, BeforeValidator(_as_pairs), "pairs that measure each other, from 0"]

    @classmethod
    def from_graph(cls, graph: Bool[Array, "n n"]) -> "EdgeList":
        """List the edges of a graph."""
        return cls(np.argwhere(np.triu(graph)))

    def adjacency(self, count: Amount) -> Bool[Array, "n n"]:
        """Return the adjacency matrix for this number of points; refuse edges of others."""
        for i, j in self.pairs.tolist():
            if i == j or max(i, j) >= count:
                text = f"[{i}, {j}] is no pair of two of the points, which are 0 to {count - 1}"
                raise InputError("pairs", text)
        return library.graph_from_edges(count, self.pairs)


AnyFormation = RandomFormation | LibraryFormation | FormationFile | AnyShape
AnyGraph = NamedGraph | ThinnedGraph | SparseGraph | GraphFile | EdgeList


def _as_formation(value: Any) -> Any:
    if isinstance(value, str):
        return LibraryFormation(value)
    points = as_points(value)
    is_new = isinstance(points, Points) and points is not value
    return replace(points, keep_order=True) if is_new else points


def _as_graph(value: Any) -> Any:
    if isinstance(value, str):
        return NamedGraph(value)  # type: ignore[arg-type]
    value = value.to_numpy() if hasattr(value, "to_numpy") else value  # of pandas
    if not isinstance(value, list | tuple | Array):
        return value
    array = read_array(value, "biuf")
    is_matrix = array.ndim == 2 and array.shape[1] != 2 and ((array == 0) | (array == 1)).all()
    is_list = array.dtype.kind in "iu" or array.shape[1:] == (2,)
    if array.dtype != bool and not is_matrix and is_list:
        return EdgeList(array)
    is_square = array.ndim == 2 and array.shape[0] == array.shape[1]
    is_square &= is_matrix or array.dtype == bool
    array = array.astype(bool)
    if not is_square or (array != array.T).any() or array.trace():
        raise InputError("", "must be a symmetric matrix of True and False, without loops")
    return EdgeList.from_graph(array)


@dataclass(frozen=True, eq=False, repr=False)
class FormationLeg(Definition):
    """One formation to take up.

    Args:
        formation: Array of (N, 2) or (N, 3) points [m], a shape, or a name in the library.
        graph: "complete", "own", a list of pairs, a matrix of True and False, or a graph.
        gains: Method of design, a `GainMatrix`, or gains.
        name: Name in figures; that in the library or of the file, if absent.
    """

    formation: Annotated[AnyFormation, Convert(_as_formation), "points of the formation"]
    graph: Annotated[AnyGraph, Convert(_as_graph), "points that measure each other"] = NamedGraph()
    gains: Annotated[AnyGains, Convert(as_gains), "gains of the control law"] = DesignedGains()
    name: Annotated[str | None, "name of the formation in figures"] = None

    def __post_init__(self) -> None:
        """Refuse a graph whose rows or columns are labeled in another order than the points."""
        given: Any = self.graph
        if getattr(given, "ndim", 0) == 2 and given.shape[1] != 2:
            with errors_in("graph"):
                check_pair_labels(given, self.formation)
        super().__post_init__()

    def check(self) -> None:
        """Refuse points in motion."""
        if isinstance(self.formation, Points) and self.formation.velocities is not None:
            raise InputError("formation.velocities_m_s", "a formation is at rest; drop it")

    @cached_property
    def desired(self) -> DesiredFormation:
        """Points and graph, once drawn."""
        if not isinstance(self.formation, Points) or not isinstance(self.graph, EdgeList):
            raise ValueError("the formation is known once the mission is drawn: mission.draw(rng)")
        points = np.array(self.formation.positions)
        return DesiredFormation(points, self.graph.adjacency(len(points)), self.name or "")

    @cached_property
    def gain_matrix(self) -> GainMatrix:
        """Gains of the formation, once drawn; refuse those of another."""
        return self.gains.build(self.desired)

    def draw(
        self, agents: Amount, keep_out: Annotated[float, NotNegative], rng: Generator
    ) -> "FormationLeg":
        """Return the leg with points, edges and gains; points are drawn first, then edges.

        Args:
            agents: Number of agents.
            keep_out: Least distance of two of them in the plane [m].
            rng: Generator for random points and edges.

        Raises:
            InputError: There is no such formation, or the swarm cannot take it up.
        """
        with errors_in("formation"):
            points, name = self._draw_points(agents, keep_out, rng)
            if len(points) != agents:
                text = f"{agents} vehicles cannot take up a formation of {len(points)} points"
                raise InputError("", text)
            check_separation(points, keep_out)
        with errors_in("graph"):
            desired = DesiredFormation(points, self._draw_graph(points, rng))
        gains = self.gains.read(desired) if isinstance(self.gains, GainsFile) else self.gains
        edges = EdgeList.from_graph(desired.graph)
        listed = Points(points, keep_order=True)
        drawn = replace(self, formation=listed, graph=edges, gains=gains, name=self.name or name)
        drawn = self if drawn == self else drawn  # which keeps gains that were designed before
        _ = drawn.gain_matrix  # designed here, so that a formation without gains is refused
        return drawn

    def without_files(self, agents: Amount) -> "FormationLeg":
        """Return the same leg with the contents of files and fonts."""
        formation, graph, gains, name = self.formation, self.graph, self.gains, self.name
        if isinstance(formation, FormationFile):
            found = library.read_formation(formation.file)
            formation, name = Points(found.points, keep_order=True), name or found.name
        elif isinstance(formation, Shape) and formation.uses_files:
            formation = Points(place_level(formation, agents, 0.0), keep_order=True)
        if isinstance(graph, GraphFile):
            graph = EdgeList.from_graph(library.read_graph(graph.file, agents))
        if isinstance(gains, GainsFile):
            gains = gains.read()
        return replace(self, formation=formation, graph=graph, gains=gains, name=name)

    def _draw_points(
        self, agents: int, keep_out: float, rng: Generator
    ) -> tuple[Float[Array, "n 3"], str | None]:
        chosen = self.formation
        if isinstance(chosen, LibraryFormation):
            found = library.load_formation(chosen.name)
            return found.points, found.name
        if isinstance(chosen, FormationFile):
            found = library.read_formation(chosen.file)
            return found.points, found.name
        if isinstance(chosen, RandomFormation):
            check_drawn_separation(chosen.separation, keep_out)
            return sample_formation(agents, chosen.box, chosen.separation, rng), "random"
        if not isinstance(chosen, Points):
            return place_level(chosen, agents, keep_out), chosen.kind
        return place_level(chosen, max(agents, len(chosen.listed)), keep_out), None

    def _draw_graph(self, points: Float[Array, "n 3"], rng: Generator) -> Bool[Array, "n n"]:
        chosen, n = self.graph, len(points)
        if isinstance(chosen, ThinnedGraph):
            return library.random_dense_graph(n, chosen.removals, rng)
        if isinstance(chosen, SparseGraph):
            return library.random_sparse_graph(points, chosen.share, rng)
        if isinstance(chosen, GraphFile):
            return library.read_graph(chosen.file, n)
        if isinstance(chosen, EdgeList):
            return chosen.adjacency(n)
        if chosen.kind == "complete":
            return ~np.eye(n, dtype=bool)
        if not isinstance(self.formation, LibraryFormation):
            raise InputError("", 'only the library\'s formations have one; "complete" would do')
        return library.load_formation(self.formation.name).graph
