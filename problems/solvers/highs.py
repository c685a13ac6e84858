"""HiGHS: dual simplex for linear programs, active set for quadratic ones [Huangfu2018]."""

import highspy
import numpy as np
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, Vector, lower_bounds, make_result

MIN_TOLERANCE = 1e-10  # smallest that HiGHS accepts
DEFAULT_TOLERANCE = 1e-6
STATUSES: dict[highspy.HighsModelStatus, Status] = {
    highspy.HighsModelStatus.kOptimal: "solved",
    highspy.HighsModelStatus.kInfeasible: "infeasible",
}


def solve_highs(problem: ConicProgram) -> SolverResult:
    """Solve one linear program with HiGHS; refuse other cones."""
    return ADAPTERS[0].open_session(problem, DEFAULT_TOLERANCE).solve(problem.b)


class _HighsSession:
    """Model that is kept, with its basis, for other right-hand sides."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        self._zero, self._solver = problem.zero, highspy.Highs()
        self._solver.setOptionValue("output_flag", False)
        self._solver.setOptionValue("threads", 1)
        for option in ("primal_feasibility_tolerance", "dual_feasibility_tolerance"):
            self._solver.setOptionValue(option, max(tolerance / 10, MIN_TOLERANCE))
        self._solver.passModel(_model(problem))
        if problem.P is not None:
            self._solver.passHessian(_hessian(problem.P))
            # At its default of 1e-7, which is added to P, a gap of many unknowns is too large.
            self._solver.setOptionValue("qp_regularization_value", tolerance / 1e4)
        self._rows = np.arange(len(problem.b), dtype=np.int32)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side, from the last basis."""
        lower = lower_bounds(b, self._zero, highspy.kHighsInf)
        self._solver.changeRowsBounds(len(b), self._rows, lower, b)
        self._solver.run()
        if self._solver.getModelStatus() == highspy.HighsModelStatus.kUnboundedOrInfeasible:
            self._rerun_without_presolve()  # presolve does not tell which
        code = self._solver.getModelStatus()
        status = STATUSES.get(code, "stopped")
        message = self._solver.modelStatusToString(code)
        iterations = self._solver.getInfo().simplex_iteration_count
        if status == "infeasible":
            return make_result(status, message, iterations, None, None, self._ray())
        point = self._solver.getSolution()
        x = np.array(point.col_value) if status == "solved" else None
        return make_result(status, message, iterations, x, -np.array(point.row_dual))

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


def _hessian(P: csc_array) -> highspy.HighsHessian:
    lower, hessian = csc_array(P.T), highspy.HighsHessian()
    hessian.dim_, hessian.format_ = P.shape[0], highspy.HessianFormat.kTriangular
    hessian.start_, hessian.index_, hessian.value_ = lower.indptr, lower.indices, lower.data
    return hessian


ADAPTERS = (SolverAdapter("highs", LP, True, _HighsSession, module="highspy"),)
