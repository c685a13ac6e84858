"""Formation gains: the matrix, its certificate and its file."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, get_args
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray as Array

from dynamics.doors import MAY_BE_INFINITE, checked
from dynamics.inputs import InputError
from problems.desired_formation import DesiredFormation
from problems.gain_problem import Axes, GainProblem

RESIDUAL_TOLERANCE = 1e-8  # relative; gains with larger residuals are of another formation
Residuals = tuple[float, float, float]  # of the kernel, the graph and the structure
# Errors of numpy and zipfile for other files, and for damaged ones.
READ_ERRORS = (ValueError, TypeError, LookupError, EOFError, OSError, RuntimeError, BadZipFile)


@checked
@dataclass(frozen=True, eq=False)
class GainMatrix:
    """Gain matrix A of q̇ = A q with its convergence rate and bounds [Lusk2020, eq. 3].

    An entry a + jb of `xy` stands for the block [a −b; b a] that rotates and scales the
    horizontal relative position of a neighbor; an entry of `z` scales its relative height.
    Both are negative semidefinite, vanish at non-edges and have rows of sum 0. The
    eigenvalues of A outside the kernel, of which those of `xy` are double, have a mean of
    −1. All properties except for the bounds are computed from the matrices.

    Args:
        formation: Points and graph.
        xy: Horizontal gains [1/s].
        z: Vertical gains [1/s].
        method: Name of the method of design.
        bound_xy: Proven: no gains of this formation and of this trace are faster [1/s].
        bound_z: The same for the vertical ones [1/s].

    Raises:
        ValueError: The gains are unstable or belong to another formation, or a bound is
            below the rate.
    """

    formation: DesiredFormation
    xy: Complex[Array, "n n"]
    z: Float[Array, "n n"]
    method: str
    bound_xy: Annotated[float, MAY_BE_INFINITE]
    bound_z: Annotated[float, MAY_BE_INFINITE]

    def __post_init__(self) -> None:
        """Refuse gains that are unstable or of another formation, and wrong bounds."""
        validate_gains(self.formation, "xy", self.xy)
        validate_gains(self.formation, "z", self.z)
        size = max(float(np.abs(A).max()) for A in (self.xy, self.z))
        xy, z = (GainProblem.from_formation(self.formation, axes).m for axes in get_args(Axes))
        mean = (2 * self.xy.trace().real + self.z.trace()) / (2 * xy + z)
        if not abs(mean + 1) <= RESIDUAL_TOLERANCE * max(1.0, size):
            fault = f"do not have eigenvalues of −1 in the mean, but of {mean:.6g}"
            text = f"the gains for z and xy do not belong to this formation: they {fault}"
            raise ValueError(text)
        validate_rate("xy", self.rate_xy, self.bound_xy)
        validate_rate("z", self.rate_z, self.bound_z)

    @property
    def convergence_rate(self) -> float:
        """Rate at which the slowest error decays [1/s]."""
        return min(self.rate_xy, self.rate_z)

    @cached_property
    def rate_xy(self) -> float:
        """Least eigenvalue of the horizontal −A outside the kernel [1/s]."""
        return GainProblem.from_formation(self.formation, "xy").convergence_rate(-self.xy)

    @cached_property
    def rate_z(self) -> float:
        """Least eigenvalue of the vertical −A outside the kernel [1/s]."""
        return GainProblem.from_formation(self.formation, "z").convergence_rate(-self.z)

    @property
    def gap_xy(self) -> float:
        """Relative gap between the horizontal rate and its bound."""
        return max(0.0, 1 - self.rate_xy / self.bound_xy)

    @property
    def gap_z(self) -> float:
        """Relative gap between the vertical rate and its bound."""
        return max(0.0, 1 - self.rate_z / self.bound_z)

    @property
    def joint_bound(self) -> float:
        """Rate that no gains exceed, however the trace is shared by the two directions [1/s].

        Problem (5) of the paper fixes tr A = 2 tr A_xy + tr A_z only. Let w_xy = −2 tr A_xy and
        w_z = −tr A_z be the shares of these gains, and β their bounds. Those of other gains
        with shares v are proportional, t ≤ β_xy v_xy / w_xy and t ≤ β_z v_z / w_z. Since
        v_xy + v_z = w_xy + w_z, any t > 0 is at most

            (w_xy + w_z) / (w_xy / β_xy + w_z / β_z)
        """
        return self._equalized_rate(self.bound_xy, self.bound_z)

    @property
    def joint_gap(self) -> float:
        """Relative gap between the rate of both directions and `joint_bound`."""
        return max(0.0, 1 - self.convergence_rate / self.joint_bound)

    def scaled_jointly(self) -> "GainMatrix":
        """Scale both directions to one rate without a change of tr A [Lusk2020, eq. 5].

        The rate is at most `joint_bound`, and equal to it where both rates are their bounds:
        fastest gains of equal means become the optimum of the paper's problem (5).
        """
        rate = self._equalized_rate(self.rate_xy, self.rate_z)
        xy, z = rate / self.rate_xy, rate / self.rate_z
        method, bounds = f"{self.method}, scaled jointly", (xy * self.bound_xy, z * self.bound_z)
        return GainMatrix(self.formation, xy * self.xy, z * self.z, method, *bounds)

    def _equalized_rate(self, xy: float, z: float) -> float:
        # Harmonic mean, weighted by the shares of the trace.
        weights = -2 * float(self.xy.trace().real), -float(self.z.trace())
        inverse = weights[0] / xy + weights[1] / z
        return sum(weights) / inverse if inverse > 0 else np.inf

    @property
    def residual_kernel(self) -> float:
        """Largest speed of an agent in the desired formation [m/s]."""
        return self._residuals[0]

    @property
    def residual_structure(self) -> float:
        """Largest entry of A − Aᴴ and of the row sums [1/s]."""
        return self._residuals[2]

    @property
    def residual_graph(self) -> float:
        """Largest entry at a non-edge [1/s]."""
        return self._residuals[1]

    @property
    def _residuals(self) -> Residuals:
        xy, z = _residuals(self.formation, "xy", self.xy), _residuals(self.formation, "z", self.z)
        return max(xy[0], z[0]), max(xy[1], z[1]), max(xy[2], z[2])

    def matches_formation(self, formation: DesiredFormation) -> bool:
        """Return True where the gains were designed for these points and this graph."""
        own, equal = self.formation, np.array_equal
        return equal(own.points, formation.points) and equal(own.graph, formation.graph)

    def save(self, path: str | Path) -> None:
        """Write an .npz file that includes the formation and the graph.

        Raises:
            InputError: The name has another ending.
        """
        if Path(path).suffix != ".npz":
            raise InputError("path", f"must end in .npz, got {path}")
        formation = self.formation
        np.savez(
            path,
            points=formation.points,
            graph=formation.graph,
            name=formation.name,
            xy=self.xy,
            z=self.z,
            method=self.method,
            bounds=(self.bound_xy, self.bound_z),
        )

    @classmethod
    def load(cls, path: str | Path) -> "GainMatrix":
        """Read a file written by `save`.

        Raises:
            ValueError: There is no such file, it is another or damaged, or its gains do not
                belong to its formation.
        """
        kinds = (("points", float), ("graph", bool), ("xy", complex), ("z", float))
        try:
            with open(path, "rb") as opened, np.load(opened, allow_pickle=False) as file:
                fields = {key: file[key].astype(kind, casting="same_kind") for key, kind in kinds}
                name, method = str(file["name"]), str(file["method"])
                bound_xy, bound_z = file["bounds"].tolist()
            formation = DesiredFormation(fields["points"], fields["graph"], name)
            return cls(formation, fields["xy"], fields["z"], method, bound_xy, bound_z)
        except FileNotFoundError as error:
            raise ValueError(f"there is no file {path}") from error
        except READ_ERRORS as error:
            reason = "it is another kind of file" if "pickle" in str(error) else error
            raise ValueError(f"{path} cannot be read as gains: {reason}") from error


def _residuals(formation: DesiredFormation, axes: Axes, A: Array) -> Residuals:
    """Compute the residuals of the kernel, of the graph and of the structure."""
    # Kernel columns about the center, because agents measure differences only.
    n = len(formation.points)
    columns = np.ones((n, 1))
    if axes == "xy" or not formation.is_flat:
        column = formation.planar_points if axes == "xy" else formation.points[:, 2]
        columns = np.stack([column - column.mean(), np.ones(n)], axis=1)
    absent = ~formation.graph & ~np.eye(n, dtype=bool)
    structure = max(np.abs(A - A.conj().T).max(), np.abs(A.sum(axis=1)).max())
    drift, at_non_edges = np.abs(A @ columns).max(), np.abs(A[absent]).max(initial=0.0)
    return float(drift), float(at_non_edges), float(structure)


def validate_rate(axes: Axes, rate: float, bound: float) -> None:
    """Refuse unstable gains of one direction, and a bound below their rate."""
    if not rate > 0:
        raise ValueError(f"the gains for {axes} are not stable: their rate is {rate:.1e}")
    if not bound >= rate * (1 - RESIDUAL_TOLERANCE):
        raise ValueError(f"bound_{axes}: must be at least the rate {rate:.6g}, got {bound:.6g}")


def validate_gains(formation: DesiredFormation, axes: Axes, A: Array) -> None:
    """Refuse gains of one direction that belong to another formation."""
    n = len(formation.points)
    if A.shape != (n, n):
        raise ValueError(f"{n} points need {n} × {n} gains, got {A.shape} for {axes}")
    if not np.isfinite(A).all():
        raise ValueError(f"the gains for {axes} must be finite numbers")
    if (A == 0).all():
        raise ValueError(f"the gains for {axes} must not all be 0")
    (drift, at_non_edges, structure), size = _residuals(formation, axes, A), float(np.abs(A).max())
    extent = max(1.0, float(np.ptp(formation.points, axis=0).max()))
    for residual, fault in (
        (drift / extent, f"move the desired formation by {drift:.1e} m/s"),
        (at_non_edges, "are not zero at the non-edges of its graph"),
        (structure, "are not symmetric, or have rows that do not sum to 0"),
    ):
        if residual > RESIDUAL_TOLERANCE * max(1.0, size):
            raise ValueError(f"the gains for {axes} do not belong to this formation: they {fault}")
