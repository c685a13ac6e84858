"""One leg of a formation scenario: the shape, who measures whom in it, and its gains."""

from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from pydantic import BeforeValidator, Field, NonNegativeFloat, NonNegativeInt, PositiveFloat

from problems.desired_formation import DesiredFormation
from sato.formation.mission import validate_formation
from sato.former.formation_gains import AnyGains, Designed, of_kind
from sato.former.formation_start import check_separation, level, listed
from sato.former.refusal import Refusal, refused_at
from sato.former.shape import Lattice, Picture, Points, Polygon, Ring, Shape, Text
from sato.former.units import Table
from sato.shapes.formation_library import load_formation, read_formation
from sato.shapes.graphs import (
    graph_from_edges,
    random_dense_graph,
    random_sparse_graph,
    read_graph,
)
from sato.shapes.random_points import sample_formation


class DrawnFormation(Table):
    """Points drawn from a box, so far apart seen from above."""

    kind: Literal["random"]
    box_m: list[NonNegativeFloat]
    separation_m: PositiveFloat


class LibraryFormation(Table):
    """A formation of the library."""

    kind: Literal["library"]
    name: str


class FormationFromFile(Table):
    """The points of a CSV file, in its order."""

    kind: Literal["file"]
    file: str


class PlainGraph(Table):
    """Everybody measures everybody, or whom the library says."""

    kind: Literal["complete", "own"]


class Thinned(Table):
    """The complete graph less so many random pairs."""

    kind: Literal["thinned"]
    removals: NonNegativeInt


class SparseGraph(Table):
    """A random graph with a share of all edges, made to have gains."""

    kind: Literal["sparse"]
    share: Annotated[float, Field(gt=0, le=1)]


class GraphFromFile(Table):
    """The pairs of a CSV file."""

    kind: Literal["file"]
    file: str


class Pairs(Table):
    """Pairs of points, counted from 0."""

    kind: Literal["pairs"]
    pairs: list[list[NonNegativeInt]]


AnyFormation = Annotated[
    DrawnFormation
    | LibraryFormation
    | FormationFromFile
    | Text
    | Ring
    | Lattice
    | Polygon
    | Picture
    | Points,
    Field(discriminator="kind"),
    BeforeValidator(of_kind),
]
AnyGraph = Annotated[
    PlainGraph | Thinned | SparseGraph | GraphFromFile | Pairs,
    Field(discriminator="kind"),
    BeforeValidator(of_kind),
]


class FormationLeg(Table):
    """A formation to take up."""

    formation: AnyFormation
    graph: AnyGraph = PlainGraph(kind="complete")
    gains: AnyGains = Designed(kind="auto")

    def drawn(self, agents: int, keep_out: float, rng: np.random.Generator) -> DesiredFormation:
        """The formation on its graph; first the points are drawn, then the graph.

        Args:
            agents: Number of vehicles.
            keep_out: Least distance of two of them in the plane [m].
            rng: Draws what is left to chance.

        Raises:
            Refusal: There is no such formation, or the swarm cannot take it up.
        """
        with refused_at("formation"):
            points, name = self._points(agents, keep_out, rng)
            complete = DesiredFormation.with_complete_graph(points, name)
            validate_formation(complete, agents, keep_out)
        with refused_at("graph"):
            return replace(complete, graph=self._graph(points, rng))

    def portable(self, agents: int) -> "FormationLeg":
        """The same leg without files and installed fonts: what they said is listed."""
        changed: dict[str, Any] = {"gains": self.gains.portable()}
        if isinstance(self.formation, FormationFromFile):
            points = read_formation(self.formation.file).points.tolist()
            changed["formation"] = Points(kind="points", positions_m=points, keep_order=True)
        elif isinstance(self.formation, Shape) and self.formation.outside:
            changed["formation"] = listed(self.formation, agents)
        if isinstance(self.graph, GraphFromFile):
            pairs = np.argwhere(np.triu(read_graph(self.graph.file, agents))).tolist()
            changed["graph"] = Pairs(kind="pairs", pairs=pairs)
        return self.model_copy(update=changed)

    def _points(
        self, agents: int, keep_out: float, rng: np.random.Generator
    ) -> tuple[Float[Array, "n 3"], str]:
        asked = self.formation
        if isinstance(asked, DrawnFormation):
            check_separation(asked.separation_m, keep_out)
            return sample_formation(agents, asked.box_m, asked.separation_m, rng), "random"
        if isinstance(asked, LibraryFormation):
            found = load_formation(asked.name)
            return found.points, found.name
        if isinstance(asked, FormationFromFile):
            found = read_formation(asked.file)
            return found.points, found.name
        return level(asked, agents, keep_out), asked.kind

    def _graph(self, points: Float[Array, "n 3"], rng: np.random.Generator) -> Bool[Array, "n n"]:
        asked, n = self.graph, len(points)
        if isinstance(asked, Thinned):
            return random_dense_graph(n, asked.removals, rng)
        if isinstance(asked, SparseGraph):
            return random_sparse_graph(points, asked.share, rng)
        if isinstance(asked, GraphFromFile):
            return read_graph(asked.file, n)
        if isinstance(asked, Pairs):
            return _joined(n, asked.pairs)
        if asked.kind == "complete":
            return ~np.eye(n, dtype=bool)
        if not isinstance(self.formation, LibraryFormation):
            raise Refusal("", 'only formations of the library have their own; "complete" would do')
        return load_formation(self.formation.name).graph


def _joined(count: int, pairs: list[list[int]]) -> Bool[Array, "n n"]:
    for pair in pairs:
        if len(pair) != 2 or pair[0] == pair[1] or max(pair) >= count:
            raise Refusal(
                "pairs", f"{pair} is no pair of two of the points, which are 0 to {count - 1}"
            )
    if not pairs:
        raise Refusal("pairs", "lists no pairs")
    return graph_from_edges(count, pairs)
