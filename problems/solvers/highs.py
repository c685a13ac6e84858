"""HiGHS: dual simplex, linear programmes only [Huangfu2018]."""

import highspy
import numpy as np
from numpy import ndarray as Array

from problems.conic import Answer, Conic, Infeasible, Unsolved


def solve_highs(problem: Conic) -> Answer:
    """Solve with HiGHS.

    Raises:
        ValueError: The problem has second-order cones.
        Infeasible: HiGHS proved that no point satisfies every constraint.
        Unsolved: It stopped for another reason.
    """
    if problem.cones:
        raise ValueError("HiGHS solves linear programmes; this one has second-order cones")
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.passModel(_model(problem))
    solver.run()
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kUnboundedOrInfeasible:  # presolve did not say which
        solver.setOptionValue("presolve", "off")
        solver.run()
        status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kInfeasible:
        raise Infeasible(problem, "HiGHS: infeasible", _ray(solver))
    if status != highspy.HighsModelStatus.kOptimal:
        raise Unsolved(problem, f"HiGHS stopped: {solver.modelStatusToString(status)}")
    solution = solver.getSolution()
    return Answer.of(problem, np.array(solution.col_value), -np.array(solution.row_dual))


def _ray(solver: highspy.Highs) -> Array | None:
    _, found, ray = solver.getDualRay()
    if not found:  # presolve found out, and keeps no proof
        solver.setOptionValue("presolve", "off")
        solver.clearSolver()
        solver.run()
        _, found, ray = solver.getDualRay()
    return -np.array(ray) if found else None


def _model(problem: Conic) -> highspy.HighsLp:
    rows, columns = problem.A.shape
    model = highspy.HighsLp()
    model.num_row_, model.num_col_ = rows, columns
    model.col_cost_ = problem.q
    model.col_lower_ = np.full(columns, -highspy.kHighsInf)
    model.col_upper_ = np.full(columns, highspy.kHighsInf)
    model.row_upper_ = problem.b
    lower = problem.b.copy()
    lower[problem.zero :] = -highspy.kHighsInf
    model.row_lower_ = lower
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_ = problem.A.indptr
    model.a_matrix_.index_ = problem.A.indices
    model.a_matrix_.value_ = problem.A.data
    return model
