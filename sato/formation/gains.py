"""Gains of a leg: designed for its formation, listed, or read from a file."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np

from dynamics.callbacks import freeze
from problems.desired_formation import DesiredFormation
from problems.gain_design import GainDesignUndecided, GainMethod, NoStabilizingGain, design_gains
from problems.gain_matrix import GainMatrix
from sato.scenario.definition import Coordinates, Definition, Matrix, errors_in
from sato.scenario.errors import InputError


@dataclass(frozen=True, eq=False, repr=False)
class DesignedGains(Definition):
    """Gains that a method designs, see `problems.gain_design.design_gains`."""

    kind: Annotated[GainMethod, "method of design"] = "auto"

    def build(self, formation: DesiredFormation) -> GainMatrix:
        """Design the gains of a formation."""
        parts = formation.points.tobytes(), formation.graph.tobytes(), formation.name
        try:
            return _design_once(self.kind, *parts)
        except (NoStabilizingGain, GainDesignUndecided) as error:
            raise InputError("graph", str(error)) from error


@lru_cache(maxsize=16)  # a run and its check draw the same formations
def _design_once(method: GainMethod, points: bytes, graph: bytes, name: str) -> GainMatrix:
    positions = np.frombuffer(points).reshape(-1, 3)
    adjacency = np.frombuffer(graph, dtype=bool).reshape(len(positions), -1)
    gains = design_gains(DesiredFormation(positions, adjacency, name), method)
    freeze([gains.xy, gains.z])
    return gains


@dataclass(frozen=True, eq=False, repr=False)
class ListedGains(Definition):
    """Gains edge by edge; the diagonal makes the sum of each row 0."""

    kind: ClassVar[str] = "listed"
    edges: Annotated[Matrix, "rows: point, neighbor, real and imaginary part, vertical part [1/s]"]
    bounds: Annotated[
        Coordinates, "largest rates of gains with these traces, in the plane and vertical [1/s]"
    ]
    method: Annotated[str, "method that designed them"]

    def check(self) -> None:
        """Refuse rows of other lengths."""
        if self.edges.shape[1] != 5 or len(self.bounds) != 2:
            raise InputError("", "need two bounds, and five numbers an edge")

    def build(self, formation: DesiredFormation) -> GainMatrix:
        """Assemble the gains of a formation; refuse those of another."""
        n = len(formation.points)
        i, j, real, imaginary, z = self.edges.T
        ends = np.stack([i, j]).astype(int)
        if ((ends < 0) | (ends >= n)).any():
            raise InputError("gains.edges", f"join points that do not exist; they are 0 to {n - 1}")
        xy, vertical = np.zeros((n, n), dtype=complex), np.zeros((n, n))
        xy[tuple(ends)], vertical[tuple(ends)] = real + 1j * imaginary, z
        xy, vertical = xy + xy.conj().T, vertical + vertical.T
        for A in (xy, vertical):
            np.fill_diagonal(A, A.diagonal() - A.sum(axis=1))
        with errors_in("gains"):
            gains = GainMatrix(formation, xy, vertical, self.method, *self.bounds)
            pairs = set(map(frozenset, ends.T.tolist()))
            linked = np.count_nonzero(formation.graph) // 2
            if len(pairs) < linked:
                reason = f"are of {len(pairs)} edges, and the formation has {linked}"
                raise InputError("", f'{reason}; gains of its graph, or "auto", would do')
        return gains


@dataclass(frozen=True, eq=False, repr=False)
class GainsFile(Definition):
    """Gains of a file that `sato gains` wrote."""

    kind: ClassVar[str] = "file"
    file: Annotated[str, "file that `sato gains` wrote"]

    def read(self, formation: DesiredFormation | None = None) -> ListedGains:
        """Read the gains; refuse those of another formation, if one is given."""
        with errors_in("gains.file"):
            gains = GainMatrix.load(self.file)
        if formation is not None and not gains.matches_formation(formation):
            text = f'{self.file} holds gains of other points or another graph; "auto" would do'
            raise InputError("gains.file", text)
        return list_gains(gains)

    def build(self, formation: DesiredFormation) -> GainMatrix:
        """Read the gains of a formation."""
        return self.read(formation).build(formation)


AnyGains = DesignedGains | ListedGains | GainsFile


def as_gains(value: Any) -> Any:
    """Convert the name of a method, or a matrix, to gains; leave anything else as it is."""
    if isinstance(value, str):
        return DesignedGains(value)  # type: ignore[arg-type]
    return list_gains(value) if isinstance(value, GainMatrix) else value


def list_gains(gains: GainMatrix) -> ListedGains:
    """List gains edge by edge."""
    i, j = np.nonzero(np.triu(gains.formation.graph))
    xy, z = gains.xy[i, j], gains.z[i, j]
    edges = np.stack([i, j, xy.real, xy.imag, z], axis=1)
    return ListedGains(edges, (gains.bound_xy, gains.bound_z), gains.method)
