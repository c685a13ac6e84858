"""Gains of a leg: designed for it, or brought along."""

from abc import ABC, abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainDesignUndecided, NoStabilizingGain, design_gains
from problems.gain_matrix import GainMatrix
from sato.former.refusal import Refusal
from sato.former.units import Table


def of_kind(value: Any) -> Any:
    """A kind that needs no more than its name may be written so; a file says what it is."""
    if isinstance(value, str):
        return {"kind": value}
    if isinstance(value, dict) and "file" in value:
        return {"kind": "file"} | value
    return value


class GainsTable(Table, ABC):
    """Where gains come from."""

    @abstractmethod
    def of(self, formation: DesiredFormation) -> GainMatrix:
        """The gains of a formation.

        Raises:
            Refusal: It has none, or these are not its own.
        """

    @abstractmethod
    def portable(self) -> "GainsTable":
        """The same gains without a file."""


class Designed(GainsTable):
    """Designed by a method, see `problems.gain_design.design`."""

    kind: Literal["auto", "projection", "admm", "sdp", "paper"]

    def of(self, formation: DesiredFormation) -> GainMatrix:
        """As the method finds them."""
        try:
            return design_gains(formation, self.kind)
        except NoStabilizingGain as error:
            raise Refusal("graph", str(error)) from error
        except GainDesignUndecided as error:
            raise Refusal("gains", str(error)) from error

    def portable(self) -> "Designed":
        """They are designed anew."""
        return self


class ListedGains(GainsTable):
    """Listed edge by edge; those of a vertex itself make its row's sum 0."""

    kind: Literal["listed"]
    edges: list[list[float]]  # vertex, neighbour, real part, imaginary part, upwards [1/s]
    bounds: list[float]  # on the rate in the plane, and upwards [1/s]
    method: str

    def of(self, formation: DesiredFormation) -> GainMatrix:
        """As they are listed."""
        n = len(formation.points)
        if len(self.bounds) != 2 or any(len(edge) != 5 for edge in self.edges):
            raise Refusal("gains", "need two bounds, and five numbers an edge")
        i, j, real, imaginary, z = np.array(self.edges).reshape(-1, 5).T
        ends = np.stack([i, j]).astype(int)
        if ((ends < 0) | (ends >= n)).any():
            raise Refusal("gains.edges", f"join points that are not there; they are 0 to {n - 1}")
        xy, up = np.zeros((n, n), dtype=complex), np.zeros((n, n))
        xy[tuple(ends)], up[tuple(ends)] = real + 1j * imaginary, z
        xy, up = xy + xy.conj().T, up + up.T
        for A in (xy, up):
            np.fill_diagonal(A, A.diagonal() - A.sum(axis=1))
        try:
            return GainMatrix(formation, xy, up, self.method, *self.bounds)
        except ValueError as error:
            raise Refusal("gains", str(error)) from error

    def portable(self) -> "ListedGains":
        """They are listed."""
        return self


class GainsFromFile(GainsTable):
    """Of a file that `sato gains` wrote."""

    kind: Literal["file"]
    file: str

    def of(self, formation: DesiredFormation) -> GainMatrix:
        """Those of the file, if they are of this formation."""
        gains = self._load()
        if not gains.matches_formation(formation):
            what = "graph" if _same_points(gains.formation, formation) else "points"
            raise Refusal(
                "gains.file",
                f"{self.file} holds gains of other {what} than this formation's; `sato gains` "
                'designs its own, and so does gains = "auto"',
            )
        return self._listed(gains).of(formation)  # also a run from its own text has them so

    def portable(self) -> ListedGains:
        """What the file says, edge by edge."""
        return self._listed(self._load())

    def _load(self) -> GainMatrix:
        try:
            return GainMatrix.load(self.file)
        except (ValueError, OSError) as error:
            raise Refusal("gains.file", _why(self.file, error)) from error

    def _listed(self, gains: GainMatrix) -> ListedGains:
        i, j = np.nonzero(np.triu(gains.formation.graph))
        xy, z = gains.xy[i, j], gains.z[i, j]
        edges = np.stack([i, j, xy.real, xy.imag, z], axis=1).tolist()
        bounds = [gains.bound_xy, gains.bound_z]
        return ListedGains(kind="listed", edges=edges, bounds=bounds, method=gains.method)


AnyGains = Annotated[
    Designed | ListedGains | GainsFromFile,
    Field(discriminator="kind"),
    BeforeValidator(of_kind),
]


def _same_points(one: DesiredFormation, other: DesiredFormation) -> bool:
    return np.array_equal(one.points, other.points)


def _why(file: str, error: ValueError | OSError) -> str:
    if isinstance(error, OSError):
        return f"{file}: cannot be read: {error.strerror or 'not a file of gains'}"
    return str(error)
