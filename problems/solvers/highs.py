"""HiGHS: dual simplex, linear programmes only [Huangfu2018]."""

from time import perf_counter

import highspy
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, ConicSolution
from problems.solvers.adapter import SolverAdapter, SolverResult, to_solution

MIN_TOLERANCE = 1e-10  # the smallest tolerance that HiGHS takes
DEFAULT_TOLERANCE = 1e-6


def solve_highs(problem: ConicProgram) -> ConicSolution:
    """Solve with HiGHS.

    Raises:
        ValueError: The problem has other cones than linear ones.
        Infeasible: HiGHS proved that no point satisfies every constraint.
        Unsolved: It stopped for another reason.
    """
    if others := sorted(problem.cone_types - {"linear"}):
        raise ValueError(f"HiGHS solves linear programmes; this one has {others[0]} cones")
    return to_solution(problem, HighsSession(problem, DEFAULT_TOLERANCE).solve(problem.b), "HiGHS")


class HighsSession:
    """A model that is kept, with its basis, for other right-hand sides."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        self._zero, self._solver = problem.zero, highspy.Highs()
        for option, value in (
            ("output_flag", False),
            ("threads", 1),
            ("primal_feasibility_tolerance", max(tolerance / 10, MIN_TOLERANCE)),
            ("dual_feasibility_tolerance", max(tolerance / 10, MIN_TOLERANCE)),
        ):
            self._solver.setOptionValue(option, value)
        self._solver.passModel(_model(problem))
        self._rows = np.arange(len(problem.b), dtype=np.int32)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, from the last basis."""
        lower = _lower_bounds(b, self._zero)
        began = perf_counter()
        self._solver.changeRowsBounds(len(b), self._rows, lower, b)
        self._solver.run()
        if self._solver.getModelStatus() == highspy.HighsModelStatus.kUnboundedOrInfeasible:
            self._rerun_without_presolve()  # presolve did not say which
        status = self._solver.getModelStatus()
        ray = self._ray() if status == highspy.HighsModelStatus.kInfeasible else None
        words = self._solver.modelStatusToString(status)
        iterations = self._solver.getInfo().simplex_iteration_count
        point = self._solver.getSolution()
        x, y = point.col_value, point.row_dual  # lists, made at every reading
        seconds = perf_counter() - began
        if status == highspy.HighsModelStatus.kInfeasible:
            return SolverResult("infeasible", words, None, ray, iterations, seconds)
        if status != highspy.HighsModelStatus.kOptimal:
            return SolverResult("stopped", words, iterations=iterations, seconds=seconds)
        return SolverResult("solved", words, np.array(x), -np.array(y), iterations, seconds)

    def _ray(self) -> Array | None:
        _, found, ray = self._solver.getDualRay()
        if not found:  # presolve found out, and keeps no proof
            self._rerun_without_presolve()
            _, found, ray = self._solver.getDualRay()
        return -np.array(ray) if found else None

    def _rerun_without_presolve(self) -> None:
        self._solver.setOptionValue("presolve", "off")
        self._solver.clearSolver()
        self._solver.run()
        self._solver.setOptionValue("presolve", "choose")


def _lower_bounds(b: Array, zero: int) -> Array:
    lower = b.copy()
    lower[zero:] = -highspy.kHighsInf
    return lower


def _model(problem: ConicProgram) -> highspy.HighsLp:
    rows, columns = problem.A.shape
    model = highspy.HighsLp()
    model.num_row_, model.num_col_ = rows, columns
    model.col_cost_ = problem.q
    model.col_lower_ = np.full(columns, -highspy.kHighsInf)
    model.col_upper_ = np.full(columns, highspy.kHighsInf)
    model.row_upper_ = problem.b
    model.row_lower_ = _lower_bounds(problem.b, problem.zero)
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_ = problem.A.indptr
    model.a_matrix_.index_ = problem.A.indices
    model.a_matrix_.value_ = problem.A.data
    return model


ADAPTERS = (
    SolverAdapter(
        name="highs",
        cone_types=frozenset({"linear"}),
        certifies_infeasibility=True,
        module="highspy",
        pip_packages="highspy",
        session_factory=HighsSession,
    ),
)
