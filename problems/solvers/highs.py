"""HiGHS: dual simplex, linear programs only [Huangfu2018]."""

from time import perf_counter

import highspy
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult
from problems.solvers.adapter import LP, SolverAdapter, lower_bounds

MIN_TOLERANCE = 1e-10  # smallest that HiGHS accepts
DEFAULT_TOLERANCE = 1e-6


def solve_highs(problem: ConicProgram) -> SolverResult:
    """Solve one linear program with HiGHS.

    Raises:
        ValueError: The program has other cones than linear ones.
    """
    return ADAPTERS[0].open_session(problem, DEFAULT_TOLERANCE).solve(problem.b)


class HighsSession:
    """Model that is kept, with its basis, for other right-hand sides."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        self._zero, self._solver = problem.zero, highspy.Highs()
        self._solver.setOptionValue("output_flag", False)
        self._solver.setOptionValue("threads", 1)
        for option in ("primal_feasibility_tolerance", "dual_feasibility_tolerance"):
            self._solver.setOptionValue(option, max(tolerance / 10, MIN_TOLERANCE))
        self._solver.passModel(_model(problem))
        self._rows = np.arange(len(problem.b), dtype=np.int32)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, from the last basis."""
        lower = lower_bounds(b, self._zero, highspy.kHighsInf)
        began = perf_counter()
        self._solver.changeRowsBounds(len(b), self._rows, lower, b)
        self._solver.run()
        if self._solver.getModelStatus() == highspy.HighsModelStatus.kUnboundedOrInfeasible:
            self._rerun_without_presolve()  # presolve does not tell which
        status = self._solver.getModelStatus()
        ray = self._ray() if status == highspy.HighsModelStatus.kInfeasible else None
        message = self._solver.modelStatusToString(status)
        iterations = self._solver.getInfo().simplex_iteration_count
        point = self._solver.getSolution()
        x, y = point.col_value, point.row_dual  # lists, made at every access
        seconds = perf_counter() - began
        if status == highspy.HighsModelStatus.kInfeasible:
            return SolverResult("infeasible", message, None, ray, iterations, seconds)
        if status != highspy.HighsModelStatus.kOptimal:
            return SolverResult("stopped", message, iterations=iterations, seconds=seconds)
        return SolverResult("solved", message, np.array(x), -np.array(y), iterations, seconds)

    def _ray(self) -> Array | None:
        _, found, ray = self._solver.getDualRay()
        if not found:  # presolve detected infeasibility and keeps no ray
            self._rerun_without_presolve()
            _, found, ray = self._solver.getDualRay()
        return -np.array(ray) if found else None

    def _rerun_without_presolve(self) -> None:
        self._solver.setOptionValue("presolve", "off")
        self._solver.clearSolver()
        self._solver.run()
        self._solver.setOptionValue("presolve", "choose")


def _model(problem: ConicProgram) -> highspy.HighsLp:
    rows, columns = problem.A.shape
    model = highspy.HighsLp()
    model.num_row_, model.num_col_ = rows, columns
    model.col_cost_ = problem.q
    model.col_lower_ = np.full(columns, -highspy.kHighsInf)
    model.col_upper_ = np.full(columns, highspy.kHighsInf)
    model.row_upper_ = problem.b
    model.row_lower_ = lower_bounds(problem.b, problem.zero, highspy.kHighsInf)
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_ = problem.A.indptr
    model.a_matrix_.index_ = problem.A.indices
    model.a_matrix_.value_ = problem.A.data
    return model


ADAPTERS = (SolverAdapter("highs", LP, True, HighsSession, module="highspy"),)
