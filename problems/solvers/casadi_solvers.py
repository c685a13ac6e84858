"""Solvers that come with CasADi [Andersson2019]: of quadratic programs, and Ipopt.

Not offered are *hpipm* and *fatrop*, which need the stage order of optimal control; *proxqp*,
which reports feasible programs as infeasible, and CasADi does not pass on the option that would
help; *qrqp*, which cycles where the cost is linear; *clp*, which always prints (*cbc* solves
linear programs with it); and *highs*, which crashes a process that has loaded HiGHS itself, as
this one has.
"""

from contextlib import nullcontext, redirect_stdout
from functools import partial
from io import StringIO
from typing import Any

import casadi
import numpy as np

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SOCP, SolverAdapter, Vector, lower_bounds, make_result

MAX_ITERATIONS = 100_000
LINEAR = ("cbc", "superscs")  # superscs takes no singular P
PLUGINS = ("cbc", "daqp", "ipqp", "osqp", "piqp", "qpoases", "superscs")

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


def _options(plugin: str, tolerance: float, is_linear: bool) -> dict[str, Any]:
    eps = {"eps_abs": tolerance, "eps_rel": tolerance}
    # The own factorization of ipqp stops at zeros on the diagonal, with NaN.
    ipqp = {"linear_solver": "qr", "print_header": False, "print_info": False, "print_iter": False}
    hessian = "zero" if is_linear else "semidef"
    qpoases = {"hessian_type": hessian, "sparse": True, "printLevel": "none"}
    options: dict[str, dict[str, Any]] = {
        "cbc": {"cbc": {"logLevel": 0}},
        # Without a proximal term it does not start where the cost is linear.
        "daqp": {"daqp": {"eps_prox": 1e-3, "iter_limit": MAX_ITERATIONS}},
        "ipqp": {"constr_viol_tol": tolerance, "dual_inf_tol": tolerance, **ipqp},
        "osqp": {"osqp": eps | {"max_iter": MAX_ITERATIONS, "polish": True, "verbose": False}},
        "piqp": {"piqp": eps},
        "qpoases": {"terminationTolerance": tolerance, **qpoases},
        "superscs": {"superscs": {"eps": tolerance, "max_iters": MAX_ITERATIONS, "verbose": 0}},
    }
    return options[plugin]


class _CasadiConicSession:
    """CasADi function that is built once."""

    def __init__(self, plugin: str, problem: ConicProgram, tolerance: float) -> None:
        self._zero, A, H = problem.zero, casadi.DM(problem.A), casadi.DM(problem.hessian)
        self._data = {"g": casadi.DM(problem.q), "a": A, "h": H}
        shape = {"h": H.sparsity(), "a": A.sparsity()}
        options = {"error_on_fail": False, "print_time": False}
        options |= _options(plugin, tolerance / 10, problem.P is None)
        # qpOASES prints its name, whatever it is told.
        self._hush = partial(redirect_stdout, StringIO()) if plugin == "qpoases" else nullcontext
        with self._hush():
            self._solver: Any = casadi.conic("solver", plugin, shape, options)

    def solve(self, b: Vector) -> SolverResult:
        with self._hush():
            found = self._solver(**self._data, lba=lower_bounds(b, self._zero), uba=b)
        stats = self._solver.stats()
        message = str(stats.get("return_status", stats["unified_return_status"]))
        iterations = max(stats.get("iter_count", 0), 0) or None
        if "infeasib" in message.lower() and "dual" not in message.lower():
            return SolverResult("infeasible", message, iterations=iterations)
        status: Status = "solved" if stats["success"] else "stopped"
        x, y = found["x"].full().ravel(), found["lam_a"].full().ravel()
        return make_result(status, message, iterations, x, y)


class _CasadiNlpSession:
    """Ipopt for a CasADi function, built once, with b as its parameter: cones become smooth.

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


ADAPTERS = (
    *(
        SolverAdapter(
            f"casadi-{plugin}",
            LP,
            False,
            partial(_CasadiConicSession, plugin),
            "casadi",
            takes_quadratic_cost=plugin not in LINEAR,
        )
        for plugin in PLUGINS
        if casadi.has_conic(plugin)
    ),
    SolverAdapter("casadi-ipopt", SOCP, False, _CasadiNlpSession, "casadi"),
)
