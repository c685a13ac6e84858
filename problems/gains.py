"""Gains of a formation: how everybody weighs what it sees of its neighbours."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Complex, Float
from numpy import ndarray as Array

from problems.formation import Formation
from problems.gain_question import Question, Way

FITS = 1e-8  # relative; gains with larger residuals are of another formation
HELD = {  # in a file: what it is made of, and its shape
    "points": (float, ("n", 3)),
    "graph": (bool, ("n", "n")),
    "name": (str, ()),
    "xy": (complex, ("n", "n")),
    "z": (float, ("n", "n")),
    "method": (str, ()),
    "bounds": (float, (2,)),
}
# What numpy and zipfile say of other files, and of damaged ones.
UNREADABLE = (ValueError, TypeError, EOFError, OSError, RuntimeError, BadZipFile)


@dataclass(frozen=True, eq=False)
class Gains:
    """The gain matrix A of q̇ = A q, and what it is worth [Lusk2020, eq. 3].

    An entry a + jb of `xy` stands for the block [a −b; b a] that turns and scales the
    neighbour's relative position seen from above; an entry of `z` scales its height. Both
    are negative semidefinite, have zeros at non-edges and rows of sum 0, and are scaled so
    that the eigenvalues outside the kernel are −1 in the mean. Whatever is said of them is
    computed from them, except for the bounds.
    """

    formation: Formation
    xy: Complex[Array, "n n"]  # [1/s]
    z: Float[Array, "n n"]  # [1/s]
    method: str
    bound_xy: float  # proven: no gains of this formation are faster [1/s]
    bound_z: float  # [1/s]

    def __post_init__(self) -> None:
        """Refuse what are not stable gains of the formation."""
        _refuse(self.formation, "xy", self.xy)
        _refuse(self.formation, "z", self.z)
        if not self.rate > 0:
            raise ValueError(f"these gains are not stable: their rate is {self.rate:.1e}")
        _refuse_bound("xy", self.bound_xy, self.rate_xy)
        _refuse_bound("z", self.bound_z, self.rate_z)

    @property
    def rate(self) -> float:
        """How fast the slowest error dies out [1/s]."""
        return min(self.rate_xy, self.rate_z)

    @cached_property
    def rate_xy(self) -> float:
        """The least eigenvalue of −A in the plane, outside the kernel [1/s]."""
        return Question.of(self.formation, "xy").rate(-self.xy)

    @cached_property
    def rate_z(self) -> float:
        """The least eigenvalue of −A upwards, outside the kernel [1/s]."""
        return Question.of(self.formation, "z").rate(-self.z)

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
        return max(_drift(self.formation, "xy", self.xy), _drift(self.formation, "z", self.z))

    @property
    def residual_structure(self) -> float:
        """Largest entry of A − Aᴴ and of the sums of rows [1/s]."""
        return max(_asymmetry(A) for A in (self.xy, self.z))

    @property
    def residual_graph(self) -> float:
        """Largest entry between two that do not measure each other [1/s]."""
        return max(_leak(self.formation, A) for A in (self.xy, self.z))

    @property
    def matrix(self) -> Float[Array, "N N"]:
        """A as the paper prints it, 3n × 3n [Lusk2020, eq. 3]."""
        n = len(self.z)
        A = np.zeros((n, 3, n, 3))
        A[:, 0, :, 0] = A[:, 1, :, 1] = self.xy.real
        A[:, 1, :, 0], A[:, 0, :, 1] = self.xy.imag, -self.xy.imag
        A[:, 2, :, 2] = self.z
        return A.reshape(3 * n, 3 * n)

    def belongs_to(self, formation: Formation) -> bool:
        """Whether these are gains of that formation: its points and its graph."""
        mine = self.formation
        return np.array_equal(mine.points, formation.points) and np.array_equal(
            mine.graph, formation.graph
        )

    def save(self, path: str | Path) -> None:
        """Write an .npz file that holds the formation and the graph too."""
        shape, bounds = self.formation, (self.bound_xy, self.bound_z)
        fields = shape.points, shape.graph, shape.name, self.xy, self.z, self.method, bounds
        held = dict(zip(HELD, map(np.asarray, fields), strict=True))
        np.savez(path, allow_pickle=False, **held)

    @classmethod
    def load(cls, path: str | Path) -> "Gains":
        """Read a file written by `save`.

        Raises:
            ValueError: It is not such a file, or its gains are not of its formation.
        """
        held = _read(path)
        try:
            _refuse_kinds(held)
            held = {name: held[name].astype(kind) for name, (kind, _) in HELD.items()}
            shape = Formation(held["points"], held["graph"], str(held["name"]))
            bounds = held["bounds"].tolist()
            return cls(shape, held["xy"], held["z"], str(held["method"]), *bounds)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


def _read(path: str | Path) -> dict[str, Array]:
    with open(path, "rb") as opened:
        try:
            with np.load(opened, allow_pickle=False) as file:
                held = {name: file[name] for name in file}
        except UNREADABLE as error:
            raise ValueError(f"{path} is not a file of gains, or is damaged") from error
    if lacks := [name for name in HELD if name not in held]:
        raise ValueError(f"{path} is not a file of gains: it lacks {', '.join(lacks)}")
    return held


def _refuse_kinds(held: dict[str, Array]) -> None:
    # Before anything is computed with them: whatever is in the file got there somehow.
    n = max(held["points"].shape, default=0)
    for name, (kind, sides) in HELD.items():
        array, shape = held[name], tuple(n if side == "n" else side for side in sides)
        if array.shape != shape or not np.can_cast(array.dtype, kind, "same_kind"):
            raise ValueError(
                f"{name} should be {kind.__name__} of shape {shape}, "
                f"not {array.dtype} of {array.shape}"
            )


def _refuse_bound(which: Way, bound: float, rate: float) -> None:
    if not bound >= rate * (1 - FITS):
        raise ValueError(
            f"no gains for {which} are said to be faster than {bound:.6g}, and these have the rate "
            f"{rate:.6g}: the bound is not one"
        )


def _shape(formation: Formation, which: Way) -> Array:
    # Columns that gains must leave alone, about the centre: vehicles see differences alone.
    n = len(formation.points)
    if which == "z" and formation.flat:
        return np.ones((n, 1))
    column = formation.planar if which == "xy" else formation.points[:, 2]
    return np.stack([column - column.mean(), np.ones(n)], axis=1)


def _drift(formation: Formation, which: Way, A: Array) -> float:
    return float(np.abs(A @ _shape(formation, which)).max())


def _asymmetry(A: Array) -> float:
    return float(max(np.abs(A - A.conj().T).max(), np.abs(A.sum(axis=1)).max()))


def _leak(formation: Formation, A: Array) -> float:
    absent = ~formation.graph & ~np.eye(len(A), dtype=bool)
    return float(np.abs(A[absent]).max(initial=0.0))


def _refuse(formation: Formation, which: Way, A: Array) -> None:
    n = len(formation.points)
    if A.shape != (n, n):
        raise ValueError(f"{n} points need {n} × {n} gains, got {A.shape} for {which}")
    if not np.isfinite(A).all():
        raise ValueError(f"gains must be finite numbers, those for {which} are not")
    if (A == 0).all():
        raise ValueError(f"gains of 0 move nobody, and those for {which} are")
    drift, size = _drift(formation, which, A), float(np.abs(A).max())
    extent = max(1.0, float(np.ptp(formation.points, axis=0).max()))
    for residual, fault in (
        (drift / extent, f"move it by {drift:.1e} m/s when it is formed"),
        (_leak(formation, A), "let vehicles use what they do not measure"),
        (_asymmetry(A), "are not symmetric, or have rows that do not sum to 0"),
        (abs(A.trace().real / Question.of(formation, which).m + 1), "are not −1 in the mean"),
    ):
        if residual > FITS * max(1.0, size):
            raise ValueError(f"the gains for {which} do not belong to this formation: they {fault}")
