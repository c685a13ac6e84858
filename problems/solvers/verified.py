"""Solver of the user's choice, its answers verified, with the default solver behind it."""

from problems.conic import TOLERANCE, ConicProgram, ConicSolution, Infeasible, solve, verify
from problems.solvers import DEFAULT_SOLVER, load_adapters, solve_clarabel
from problems.solvers.adapter import SolverSession

ASKED = 1e-2  # of the tolerance: many solvers scale residuals by larger numbers


class VerifiedSolver:
    """Solver chosen by name; programs on which it fails are given to the default solver.

    A session stays open while programs differ in b alone, so that solvers that start from the
    last answer do so.
    """

    def __init__(self, name: str = DEFAULT_SOLVER, tolerance: float = TOLERANCE) -> None:
        """Choose a solver, and the tolerance of its answers: residuals and gap, relative."""
        self._name, self._tolerance = name, tolerance
        self._last: tuple[ConicProgram, SolverSession] | None = None
        self.fallback_count = 0  # programs that were given to the default solver

    def __call__(self, problem: ConicProgram) -> ConicSolution:
        """Solve a program.

        Raises:
            Infeasible: No point satisfies every constraint, with a verified certificate.
            Unsolved: The default solver stopped, or its answer fails verification.
            ValueError: The solver is not installed, or cannot take the program.
        """
        if (self._name, self._tolerance) == (DEFAULT_SOLVER, TOLERANCE):
            return solve(problem, solve_clarabel)
        result = self._open_session(problem).solve(problem.b)
        kind, solution, reason, ray = verify(problem, result, self._tolerance)
        if kind == "infeasible":
            raise Infeasible(problem, reason, ray)
        if solution is not None and kind == "solved":
            return solution
        self.fallback_count += 1
        return solve(problem, solve_clarabel)

    def _open_session(self, problem: ConicProgram) -> SolverSession:
        if self._last is None or not problem.differs_in_b_only(self._last[0]):
            session = load_adapters()[self._name].open_session(problem, ASKED * self._tolerance)
            self._last = problem, session
        return self._last[1]


solve_program = VerifiedSolver()
