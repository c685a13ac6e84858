"""Solvers of smooth programmes, by CasADi: cones are written as inequalities [Andersson2019]."""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import casadi
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status

# What each is told, for a tolerance.
OPTIONS: dict[str, Callable[[float], dict[str, Any]]] = {
    "ipopt": lambda tolerance: {
        "ipopt": {
            "tol": tolerance,
            "constr_viol_tol": tolerance,
            "dual_inf_tol": tolerance,
            "compl_inf_tol": tolerance / 10,  # that of one row; the gap is that of all
            "acceptable_iter": 0,
            "bound_relax_factor": 1e-10,
            "mu_strategy": "adaptive",
            "print_level": 0,
            "sb": "yes",
        }
    },
}


class CasadiNlpSession:
    """A function of CasADi, built once, with b as its parameter.

    A cone (t, y) is t ≥ √(‖y‖² + ε²), which is smooth at its tip, inside of the cone, and
    further from it than ε nowhere. The duals are the multipliers of b, which CasADi has from those
    of the inequalities: μ (1, −y / √(‖y‖² + ε²)) where μ is that of a cone.
    """

    def __init__(self, plugin: str, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        x, b = casadi.MX.sym("x", len(problem.q)), casadi.MX.sym("b", len(problem.b))
        s = b - casadi.DM(problem.A) @ x
        start = problem.zero + problem.nonnegative
        rows = [s[:start]]
        for size in problem.soc_sizes:
            y = s[start + 1 : start + size]
            rows.append(s[start] - casadi.sqrt(casadi.sumsqr(y) + (tolerance / 10) ** 2))
            start += size
        g = casadi.vertcat(*rows)
        self._upper = casadi.DM(np.concatenate([
            np.zeros(problem.zero), np.full(g.shape[0] - problem.zero, np.inf)
        ]))  # fmt: skip
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
        words, steps = stats["return_status"], stats["iter_count"]
        if words == "Infeasible_Problem_Detected":
            return SolverResult("infeasible", words, None, None, steps, seconds)
        said: Status = "solved" if stats["success"] else "stopped"
        return SolverResult(said, words, x.ravel(), y.ravel(), steps, seconds)


ADAPTERS = tuple(
    SolverAdapter(
        name=f"casadi-{plugin}",
        cone_types=frozenset({"linear", "second-order"}),
        certifies_infeasibility=False,
        module="casadi",
        pip_packages="casadi",
        session_factory=partial(CasadiNlpSession, plugin),
    )
    for plugin in OPTIONS
    if casadi.has_nlpsol(plugin)
)
