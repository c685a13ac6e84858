"""Nonlinear solvers through CasADi: cones become smooth inequalities [Andersson2019]."""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import casadi
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SOCP, SolverAdapter

# Options of each solver for a tolerance.
OPTIONS: dict[str, Callable[[float], dict[str, Any]]] = {
    "ipopt": lambda tolerance: {
        "ipopt": {
            "tol": tolerance,
            "constr_viol_tol": tolerance,
            "dual_inf_tol": tolerance,
            "compl_inf_tol": tolerance / 10,  # of one row; the gap sums over all rows
            "acceptable_iter": 0,
            "bound_relax_factor": 1e-10,
            "mu_strategy": "adaptive",
            "print_level": 0,
            "sb": "yes",
        }
    },
}


class CasadiNlpSession:
    """CasADi function, built once, with b as its parameter.

    A cone (t, y) becomes t ≥ √(‖y‖² + ε²), which is smooth at the tip, lies inside the cone and
    is nowhere further than ε from its boundary. The duals are the multipliers of b, which CasADi
    derives from those of the inequalities: μ (1, −y / √(‖y‖² + ε²)), μ the multiplier of a cone.
    """

    def __init__(self, plugin: str, problem: ConicProgram, tolerance: float) -> None:
        """Build the function."""
        x, b = casadi.MX.sym("x", len(problem.q)), casadi.MX.sym("b", len(problem.b))
        s = b - casadi.DM(problem.A) @ x
        constraints = [s[: problem.linear]]
        for rows in problem.soc_rows:
            norm = casadi.sqrt(casadi.sumsqr(s[rows][1:]) + (tolerance / 10) ** 2)
            constraints.append(s[rows.start] - norm)
        g = casadi.vertcat(*constraints)
        above = np.full(g.shape[0] - problem.zero, np.inf)
        self._upper = casadi.DM(np.concatenate([np.zeros(problem.zero), above]))
        self._solver: Any = casadi.nlpsol(
            "solver",
            plugin,
            {"x": x, "p": b, "f": casadi.dot(casadi.DM(problem.q), x), "g": g},
            {"error_on_fail": False, "print_time": False, **OPTIONS[plugin](tolerance / 10)},
        )

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, from zero."""
        began = perf_counter()
        found = self._solver(p=b, lbg=0, ubg=self._upper)
        x, y = found["x"].full(), found["lam_p"].full()
        stats = self._solver.stats()
        seconds = perf_counter() - began
        message, iterations = stats["return_status"], stats["iter_count"]
        if message == "Infeasible_Problem_Detected":
            return SolverResult("infeasible", message, None, None, iterations, seconds)
        status: Status = "solved" if stats["success"] else "stopped"
        return SolverResult(status, message, x.ravel(), y.ravel(), iterations, seconds)


ADAPTERS = tuple(
    SolverAdapter(f"casadi-{plugin}", SOCP, False, partial(CasadiNlpSession, plugin), "casadi")
    for plugin in OPTIONS
    if casadi.has_nlpsol(plugin)
)
