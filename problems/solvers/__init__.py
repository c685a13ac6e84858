"""One short adapter a file: standard form in, answer out."""

from problems.solvers.clarabel import solve_clarabel
from problems.solvers.highs import solve_highs

__all__ = ["solve_clarabel", "solve_highs"]
