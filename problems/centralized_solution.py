"""Solutions of the centralized problem: simulated from their controls, with all violations."""

from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked
from problems.conic import Unsolved

FEASIBILITY_TOLERANCE = 1e-6  # of simulated violations, in units of R, R/Δt, U and V


@checked
class SimulatedSolution(NamedTuple):
    """Controls of all agents, their simulation, and its violations."""

    x: Float[Array, "agents instants n"]
    u: Float[Array, "agents T m"]
    cost: float  # of all agents: fuel [m/s] or energy [m²/s³]
    terminal_error: float  # largest over agents, in units of R and R/Δt
    control_violation: float  # relative to U
    speed_violation: float  # relative to V
    min_separation: float  # over continuous time, relative to R; at most 2
    solver_message: str  # status that the solver reported
    padding: float = 0.0  # largest required distance beyond R (1 + tolerance), in units of R

    @property
    def max_violation(self) -> float:
        """Largest violation; NaN where one of them is NaN."""
        separation = 1 - self.min_separation
        limits = self.control_violation, self.speed_violation
        return float(np.max(np.array([self.terminal_error, *limits, separation, 0.0])))

    @property
    def is_feasible(self) -> bool:
        """True where all constraints hold within the tolerance."""
        return self.max_violation <= FEASIBILITY_TOLERANCE

    def __str__(self) -> str:
        """Summarize cost and violations."""
        return (
            f"{self.solver_message}: cost {self.cost:.6g}, terminal error "
            f"{self.terminal_error:.1e}, control above its limit by {self.control_violation:.1e}, "
            f"speed by {self.speed_violation:.1e}, separation {self.min_separation:.6f} R"
        )


class NoFeasibleSolution(Unsolved):
    """No initial guess led to a feasible solution, which does not prove infeasibility.

    Attributes:
        solutions: The guesses and their solutions, with their violations.
    """

    def __init__(self, problem: object, tried: tuple[SimulatedSolution, ...]) -> None:
        """Keep all solutions."""
        least = min(tried, key=lambda t: t.max_violation if isfinite(t.max_violation) else inf)
        super().__init__(problem, f"none of {len(tried)} solutions is feasible; nearest: {least}")
        self.solutions = tried

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.problem, self.solutions)


@checked
class CentralizedResult(NamedTuple):
    """Best feasible solution, and all solutions."""

    best: SimulatedSolution
    solutions: tuple[SimulatedSolution, ...]  # the guesses themselves, then their solutions
