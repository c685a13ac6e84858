"""Gains of a formation: how everybody weighs what it sees of its neighbours."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray as Array

from problems.desired_formation import DesiredFormation
from problems.gain_problem import Axes, GainProblem

RESIDUAL_TOLERANCE = 1e-8  # relative; gains with larger residuals are of another formation
FILE_FIELDS = {  # in a file: what it is made of, and its shape
    "points": (float, ("n", 3)),
    "graph": (bool, ("n", "n")),
    "name": (str, ()),
    "xy": (complex, ("n", "n")),
    "z": (float, ("n", "n")),
    "method": (str, ()),
    "bounds": (float, (2,)),
}
# What numpy and zipfile say of other files, and of damaged ones.
READ_ERRORS = (ValueError, TypeError, EOFError, OSError, RuntimeError, BadZipFile)


@dataclass(frozen=True, eq=False)
class GainMatrix:
    """The gain matrix A of q̇ = A q, and what it is worth [Lusk2020, eq. 3].

    An entry a + jb of `xy` stands for the block [a −b; b a] that turns and scales the
    neighbour's relative position seen from above; an entry of `z` scales its height. Both
    are negative semidefinite, have zeros at non-edges and rows of sum 0, and are scaled so
    that the eigenvalues outside the kernel are −1 in the mean. Whatever is said of them is
    computed from them, except for the bounds.
    """

    formation: DesiredFormation
    xy: Complex[Array, "n n"]  # [1/s]
    z: Float[Array, "n n"]  # [1/s]
    method: str
    bound_xy: float  # proven: no gains of this formation are faster [1/s]
    bound_z: float  # [1/s]

    def __post_init__(self) -> None:
        """Refuse what are not stable gains of the formation."""
        _validate_gains(self.formation, "xy", self.xy)
        _validate_gains(self.formation, "z", self.z)
        if not self.convergence_rate > 0:
            raise ValueError(
                f"these gains are not stable: their rate is {self.convergence_rate:.1e}"
            )
        _validate_bound("xy", self.bound_xy, self.rate_xy)
        _validate_bound("z", self.bound_z, self.rate_z)

    @property
    def convergence_rate(self) -> float:
        """How fast the slowest error dies out [1/s]."""
        return min(self.rate_xy, self.rate_z)

    @cached_property
    def rate_xy(self) -> float:
        """The least eigenvalue of −A in the plane, outside the kernel [1/s]."""
        return GainProblem.from_formation(self.formation, "xy").convergence_rate(-self.xy)

    @cached_property
    def rate_z(self) -> float:
        """The least eigenvalue of −A upwards, outside the kernel [1/s]."""
        return GainProblem.from_formation(self.formation, "z").convergence_rate(-self.z)

    @property
    def gap_xy(self) -> float:
        """The share of the bound that is not reached in the plane."""
        return max(0.0, 1 - self.rate_xy / self.bound_xy)

    @property
    def gap_z(self) -> float:
        """The share of the bound that is not reached upwards."""
        return max(0.0, 1 - self.rate_z / self.bound_z)

    @property
    def residual_kernel(self) -> float:
        """Largest speed at which the formation, once formed, is left [m/s]."""
        return max(
            _kernel_residual(self.formation, "xy", self.xy),
            _kernel_residual(self.formation, "z", self.z),
        )

    @property
    def residual_structure(self) -> float:
        """Largest entry of A − Aᴴ and of the sums of rows [1/s]."""
        return max(_structure_residual(A) for A in (self.xy, self.z))

    @property
    def residual_graph(self) -> float:
        """Largest entry between two that do not measure each other [1/s]."""
        return max(_graph_residual(self.formation, A) for A in (self.xy, self.z))

    @property
    def full_matrix(self) -> Float[Array, "N N"]:
        """A as the paper prints it, 3n × 3n [Lusk2020, eq. 3]."""
        n = len(self.z)
        A = np.zeros((n, 3, n, 3))
        A[:, 0, :, 0] = A[:, 1, :, 1] = self.xy.real
        A[:, 1, :, 0], A[:, 0, :, 1] = self.xy.imag, -self.xy.imag
        A[:, 2, :, 2] = self.z
        return A.reshape(3 * n, 3 * n)

    def matches_formation(self, formation: DesiredFormation) -> bool:
        """Whether these are gains of that formation: its points and its graph."""
        mine = self.formation
        return np.array_equal(mine.points, formation.points) and np.array_equal(
            mine.graph, formation.graph
        )

    def save(self, path: str | Path) -> None:
        """Write an .npz file that holds the formation and the graph too."""
        shape, bounds = self.formation, (self.bound_xy, self.bound_z)
        fields = shape.points, shape.graph, shape.name, self.xy, self.z, self.method, bounds
        held = dict(zip(FILE_FIELDS, map(np.asarray, fields), strict=True))
        np.savez(path, allow_pickle=False, **held)

    @classmethod
    def load(cls, path: str | Path) -> "GainMatrix":
        """Read a file written by `save`.

        Raises:
            ValueError: It is not such a file, or its gains are not of its formation.
        """
        held = _read_fields(path)
        try:
            _validate_fields(held)
            held = {name: held[name].astype(kind) for name, (kind, _) in FILE_FIELDS.items()}
            shape = DesiredFormation(held["points"], held["graph"], str(held["name"]))
            bounds = held["bounds"].tolist()
            return cls(shape, held["xy"], held["z"], str(held["method"]), *bounds)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def _read_fields(path: str | Path) -> dict[str, Array]:
    with open(path, "rb") as opened:
        try:
            with np.load(opened, allow_pickle=False) as file:
                held = {name: file[name] for name in file}
        except READ_ERRORS as error:
            raise ValueError(f"{path} is not a file of gains, or is damaged") from error
    if lacks := [name for name in FILE_FIELDS if name not in held]:
        raise ValueError(f"{path} is not a file of gains: it lacks {', '.join(lacks)}")
    return held


def _validate_fields(held: dict[str, Array]) -> None:
    # Before anything is computed with them: whatever is in the file got there somehow.
    n = max(held["points"].shape, default=0)
    for name, (kind, sides) in FILE_FIELDS.items():
        array, shape = held[name], tuple(n if side == "n" else side for side in sides)
        if array.shape != shape or not np.can_cast(array.dtype, kind, "same_kind"):
            raise ValueError(
                f"{name} should be {kind.__name__} of shape {shape}, "
                f"not {array.dtype} of {array.shape}"
            )


def _validate_bound(which: Axes, bound: float, rate: float) -> None:
    if not bound >= rate * (1 - RESIDUAL_TOLERANCE):
        raise ValueError(
            f"no gains for {which} are said to be faster than {bound:.6g}, and these have the rate "
            f"{rate:.6g}: the bound is not one"
        )


def _kernel_columns(formation: DesiredFormation, which: Axes) -> Array:
    # Columns that gains must leave alone, about the centre: vehicles see differences alone.
    n = len(formation.points)
    if which == "z" and formation.is_flat:
        return np.ones((n, 1))
    column = formation.planar_points if which == "xy" else formation.points[:, 2]
    return np.stack([column - column.mean(), np.ones(n)], axis=1)


def _kernel_residual(formation: DesiredFormation, which: Axes, A: Array) -> float:
    return float(np.abs(A @ _kernel_columns(formation, which)).max())


def _structure_residual(A: Array) -> float:
    return float(max(np.abs(A - A.conj().T).max(), np.abs(A.sum(axis=1)).max()))


def _graph_residual(formation: DesiredFormation, A: Array) -> float:
    absent = ~formation.graph & ~np.eye(len(A), dtype=bool)
    return float(np.abs(A[absent]).max(initial=0.0))


def _validate_gains(formation: DesiredFormation, which: Axes, A: Array) -> None:
    n = len(formation.points)
    if A.shape != (n, n):
        raise ValueError(f"{n} points need {n} × {n} gains, got {A.shape} for {which}")
    if not np.isfinite(A).all():
        raise ValueError(f"gains must be finite numbers, those for {which} are not")
    if (A == 0).all():
        raise ValueError(f"gains of 0 move nobody, and those for {which} are")
    drift, size = _kernel_residual(formation, which, A), float(np.abs(A).max())
    extent = max(1.0, float(np.ptp(formation.points, axis=0).max()))
    for residual, fault in (
        (drift / extent, f"move it by {drift:.1e} m/s when it is formed"),
        (_graph_residual(formation, A), "let vehicles use what they do not measure"),
        (_structure_residual(A), "are not symmetric, or have rows that do not sum to 0"),
        (
            abs(A.trace().real / GainProblem.from_formation(formation, which).m + 1),
            "are not −1 in the mean",
        ),
    ):
        if residual > RESIDUAL_TOLERANCE * max(1.0, size):
            raise ValueError(f"the gains for {which} do not belong to this formation: they {fault}")
