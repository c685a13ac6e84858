"""Programs recorded from runs, with their seeds and reference solutions.

`scripts/write_problem_families.py` writes them, a file for each family and size.
"""

from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import Any, Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array, diags_array

from dynamics.doors import checked
from problems.conic import ConicProgram

Size = Literal["small", "medium", "large"]
SIZES: tuple[Size, ...] = get_args(Size)
MIN_COST_SCALE = 1e-6  # smallest scale of a relative error of the cost
REFERENCE_ERROR = 1e-7  # of a reference cost, from the residuals of its solution


@dataclass(frozen=True, eq=False)
class Instance:
    """Program and its reference solution.

    x and y are an optimum and its duals, see `problems.conic.ConicSolution`; where the program
    is infeasible, y is the ray that certifies it, and x and the reference cost are NaN.
    """

    name: str
    problem: ConicProgram
    is_feasible: bool
    reference_cost: float  # the optimum
    reference_gap: float  # difference of the optima of two solvers, over 1 + |reference|
    x: Float[Array, " n"]
    y: Float[Array, " m"]

    @property
    def cost_scale(self) -> float:
        """Scale of relative errors of the cost."""
        return max(abs(self.reference_cost), MIN_COST_SCALE)

    def cost_tolerance(self, tolerance: float) -> float:
        """Bound the cost error of a solution whose residuals and gap are within a tolerance.

        Weak duality bounds it: the solution's x against the reference y, and its y against the
        reference x.
        """
        p = self.problem
        primal = tolerance * (1 + np.abs(p.b).max(initial=0.0))
        dual = tolerance * (1 + np.abs(p.q).max(initial=0.0))
        below = primal * p.violation_cost(self.y)
        above = dual * (np.abs(self.x).sum() + p.violation_cost(p.b - p.A @ self.x))
        gap = (tolerance + self.reference_gap) * (1 + abs(self.reference_cost))
        return float(max(below, above + gap) + gap + REFERENCE_ERROR)


@dataclass(frozen=True, eq=False)
class Family:
    """Programs of one kind and size.

    Those that differ in b alone share the same arrays q and A and follow each other, so that
    one solver session serves them.
    """

    name: str
    size: str
    seed: int  # of the run
    source: str  # description, and the run they were recorded from
    solvers: tuple[str, ...]  # that agree on the solutions
    instances: tuple[Instance, ...]


def list_families() -> list[str]:
    """List the names of the families, each of which has all sizes."""
    smallest = f"-{SIZES[0]}.npz"
    names = (file.name for file in files(__name__).iterdir())
    return sorted(name.removesuffix(smallest) for name in names if name.endswith(smallest))


@checked
@cache
def load_family(name: str, size: Size) -> Family:
    """Load the programs of one family and size."""
    if name not in list_families():
        raise ValueError(f'there is no family "{name}"; there are {", ".join(list_families())}')
    with (files(__name__) / f"{name}-{size}.npz").open("rb") as file, np.load(file) as data:
        # A and q are stored once for all the instances that share them.
        shared = [_parse_program(data, k) for k in range(int(data["programs"]))]
        columns = (data[key].tolist() for key in ("program", "feasible", "reference", "agreed"))
        instances = []
        for i, (k, is_feasible, cost, gap) in enumerate(zip(*columns, strict=True)):
            problem, label = replace(shared[k], b=data[f"b{i}"]), f"{name}/{size}/{i}"
            x, y = data[f"x{i}"], data[f"y{i}"]
            instances.append(Instance(label, problem, is_feasible, cost, gap, x, y))
        solvers, source = tuple(map(str, data["solvers"])), str(data["source"])
        return Family(name, size, int(data["seed"]), source, solvers, tuple(instances))


def _parse_program(data: Any, k: int) -> ConicProgram:
    zero, nonnegative = map(int, data[f"linear{k}"])
    cones, orders = tuple(map(int, data[f"cones{k}"])), tuple(map(int, data[f"matrices{k}"]))
    height = zero + nonnegative + sum(cones) + sum(n * (n + 1) // 2 for n in orders)
    columns = data[f"values{k}"], data[f"rows{k}"], data[f"starts{k}"]
    A = csc_array(columns, shape=(height, len(data[f"q{k}"])))
    q, P = data[f"q{k}"], None
    if f"curvature{k}" in data:
        P = csc_array(diags_array(data[f"curvature{k}"]))
    return ConicProgram(q, A, np.zeros(height), zero, nonnegative, cones, orders, P)
