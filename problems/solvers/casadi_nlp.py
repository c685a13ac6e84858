"""Nonlinear solvers through CasADi: cones become smooth inequalities [Andersson2019]."""

from typing import Any

import casadi
import numpy as np

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SOCP, SolverAdapter, Vector, make_result

IPOPT_OPTIONS: dict[str, Any] = {
    "acceptable_iter": 0,
    "bound_relax_factor": 1e-10,
    "mu_strategy": "adaptive",
    "print_level": 0,
    "sb": "yes",
}
STATUSES: dict[str, Status] = {
    "Solve_Succeeded": "solved",
    "Infeasible_Problem_Detected": "infeasible",
}


class _CasadiNlpSession:
    """CasADi function, built once, with b as its parameter.

    A cone (t, y) becomes t ≥ √(‖y‖² + ε²), which is smooth at the tip, lies inside the cone and
    is nowhere further than ε from its boundary. The duals are the multipliers of b, which CasADi
    derives from those of the inequalities: μ (1, −y / √(‖y‖² + ε²)), μ the multiplier of a cone.
    """

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        x, b = casadi.MX.sym("x", len(problem.q)), casadi.MX.sym("b", len(problem.b))
        s = b - casadi.DM(problem.A) @ x
        constraints = [s[: problem.linear]]
        for rows in problem.soc_rows:
            norm = casadi.sqrt(casadi.sumsqr(s[rows][1:]) + (tolerance / 10) ** 2)
            constraints.append(s[rows.start] - norm)
        g = casadi.vertcat(*constraints)
        above = np.full(g.shape[0] - problem.zero, np.inf)
        self._upper = casadi.DM(np.concatenate([np.zeros(problem.zero), above]))
        limits = dict.fromkeys(("tol", "constr_viol_tol", "dual_inf_tol"), tolerance / 10)
        limits["compl_inf_tol"] = tolerance / 100  # of one row; the gap sums over all rows
        ipopt = IPOPT_OPTIONS | limits
        options: dict[str, Any] = {"error_on_fail": False, "print_time": False, "ipopt": ipopt}
        cost = casadi.dot(casadi.DM(problem.q), x)
        if problem.P is not None:
            cost += casadi.bilin(casadi.DM(problem.hessian), x, x) / 2
        nlp: dict[str, Any] = {"x": x, "p": b, "f": cost, "g": g}
        self._solver: Any = casadi.nlpsol("solver", "ipopt", nlp, options)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side, from zero."""
        found = self._solver(p=b, lbg=0, ubg=self._upper)
        stats = self._solver.stats()
        message: str = stats["return_status"]
        x, y = found["x"].full().ravel(), found["lam_p"].full().ravel()
        return make_result(STATUSES.get(message, "stopped"), message, stats["iter_count"], x, y)


ADAPTERS = (SolverAdapter("casadi-ipopt", SOCP, False, _CasadiNlpSession, "casadi"),)
