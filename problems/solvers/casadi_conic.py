"""Solvers of quadratic programs that come with CasADi [Andersson2019].

Not offered are *hpipm* and *fatrop*, which need the stage order of optimal control; *proxqp*,
which reports feasible programs as infeasible, and CasADi does not pass on the option that would
help; *qrqp*, which cycles where the cost is linear; *clp*, which always prints (*cbc* solves
linear programs with it); and *highs*, which crashes a process that has loaded HiGHS itself, as
this one has.
"""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import casadi
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, lower_bounds

MAX_ITERATIONS = 100_000
QUIET = {"print_header": False, "print_info": False, "print_iter": False}

# Options of each solver for a tolerance.
OPTIONS: dict[str, Callable[[float], dict[str, Any]]] = {
    "cbc": lambda tolerance: {"cbc": {"logLevel": 0}},
    # Without a proximal term it does not start where the cost is linear.
    "daqp": lambda tolerance: {"daqp": {"eps_prox": 1e-3, "iter_limit": MAX_ITERATIONS}},
    # Its own factorization stops at zeros on the diagonal, with NaN.
    "ipqp": lambda tolerance: {
        **dict.fromkeys(("constr_viol_tol", "dual_inf_tol"), tolerance),
        "linear_solver": "qr",
        **QUIET,
    },
    "osqp": lambda tolerance: {
        "osqp": {
            **dict.fromkeys(("eps_abs", "eps_rel"), tolerance),
            **{"max_iter": MAX_ITERATIONS, "polish": True, "verbose": False},
        }
    },
    "piqp": lambda tolerance: {"piqp": {"eps_abs": tolerance, "eps_rel": tolerance}},
    "qpoases": lambda tolerance: {
        "printLevel": "none",
        "hessian_type": "zero",
        "sparse": True,
        "terminationTolerance": tolerance,
    },
    "superscs": lambda tolerance: {
        "superscs": {"eps": tolerance, "max_iters": MAX_ITERATIONS, "verbose": 0}
    },
}


class CasadiConicSession:
    """CasADi function, built once, that reads and writes the same memory at every call."""

    def __init__(self, plugin: str, problem: ConicProgram, tolerance: float) -> None:
        """Build the function."""
        n, m, A = len(problem.q), len(problem.b), casadi.DM(problem.A)
        self._solver: Any = casadi.conic(
            "solver",
            plugin,
            {"h": casadi.Sparsity(n, n), "a": A.sparsity()},
            {"error_on_fail": False, "print_time": False, **OPTIONS[plugin](tolerance / 10)},
        )
        self._zero, self._lower, self._upper = problem.zero, np.empty(m), np.empty(m)
        self._x, self._y = np.empty(n), np.empty(m)
        self._given = {"g": np.array(problem.q), "a": np.array(A.nonzeros())}
        self._given |= {"lba": self._lower, "uba": self._upper}
        self._given |= {"lbx": np.full(n, -np.inf), "ubx": np.full(n, np.inf)}
        # CasADi's type annotations ask for a size with each view; at run time it takes none.
        memory: tuple[Any, Any] = self._solver.buffer()
        self._buffer, self._run = memory
        for name, values in self._given.items():
            self._buffer.set_arg(self._solver.index_in(name), values.data)
        for name, values in (("x", self._x), ("lam_a", self._y)):
            self._buffer.set_res(self._solver.index_out(name), values.data)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        self._lower[:], self._upper[:] = lower_bounds(b, self._zero), b
        began = perf_counter()
        self._run()
        stats = self._buffer.stats()
        seconds = perf_counter() - began
        message = str(stats.get("return_status", stats["unified_return_status"]))
        count = stats.get("iter_count", -1)
        iterations = count if count > 0 else None
        if "infeasib" in message.lower() and "dual" not in message.lower():
            return SolverResult("infeasible", message, None, None, iterations, seconds)
        status: Status = "solved" if stats["success"] else "stopped"
        x, y = self._x.copy(), self._y.copy()
        return SolverResult(status, message, x, y, iterations, seconds)


ADAPTERS = tuple(
    SolverAdapter(f"casadi-{plugin}", LP, False, partial(CasadiConicSession, plugin), "casadi")
    for plugin in OPTIONS
    if casadi.has_conic(plugin)
)
