"""Solvers of quadratic programs that come with CasADi [Andersson2019].

Not offered are *hpipm* and *fatrop*, which need the stage order of optimal control; *proxqp*,
which reports feasible programs as infeasible, and CasADi does not pass on the option that would
help; *qrqp*, which cycles where the cost is linear; *clp*, which always prints (*cbc* solves
linear programs with it); and *highs*, which crashes a process that has loaded HiGHS itself, as
this one has.
"""

from functools import partial
from typing import Any

import casadi

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, Vector, lower_bounds, make_result

MAX_ITERATIONS = 100_000
LINEAR = ("cbc", "superscs")  # superscs takes no singular P
PLUGINS = ("cbc", "daqp", "ipqp", "osqp", "piqp", "qpoases", "superscs")


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
        self._solver: Any = casadi.conic("solver", plugin, shape, options)

    def solve(self, b: Vector) -> SolverResult:
        found = self._solver(**self._data, lba=lower_bounds(b, self._zero), uba=b)
        stats = self._solver.stats()
        message = str(stats.get("return_status", stats["unified_return_status"]))
        iterations = max(stats.get("iter_count", 0), 0) or None
        if "infeasib" in message.lower() and "dual" not in message.lower():
            return SolverResult("infeasible", message, iterations=iterations)
        status: Status = "solved" if stats["success"] else "stopped"
        x, y = found["x"].full().ravel(), found["lam_a"].full().ravel()
        return make_result(status, message, iterations, x, y)


ADAPTERS = tuple(
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
)
