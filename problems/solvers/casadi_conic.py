"""The quadratic programmes of CasADi, by the solvers that come with it [Andersson2019].

What comes with it and is not here: *hpipm* and *fatrop* want the order of optimal control;
*proxqp* calls infeasible what has a solution, and the option that would help is not passed on;
*qrqp* walks in circles where the cost is linear; *clp* cannot be kept from printing, and *cbc*
solves linear programmes by it; *highs* brings down a process that has loaded
HiGHS by itself, as this one has.
"""

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
from problems.solvers.rows import lower_bounds

MAX_ITERATIONS = 100_000  # at most
QUIET = {"print_header": False, "print_info": False, "print_iter": False}

# What each is told, for a tolerance.
OPTIONS: dict[str, Callable[[float], dict[str, Any]]] = {
    "cbc": lambda tolerance: {"cbc": {"logLevel": 0}},
    # Without a proximal term it does not begin with a cost that is linear.
    "daqp": lambda tolerance: {"daqp": {"eps_prox": 1e-3, "iter_limit": MAX_ITERATIONS}},
    # Its own factorisation stops at zeros on the diagonal, with NaN.
    "ipqp": lambda tolerance: {
        "constr_viol_tol": tolerance,
        "dual_inf_tol": tolerance,
        "linear_solver": "qr",
        **QUIET,
    },
    "osqp": lambda tolerance: {
        "osqp": {
            "eps_abs": tolerance,
            "eps_rel": tolerance,
            "max_iter": MAX_ITERATIONS,
            "polish": True,
            "verbose": False,
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
    """A function of CasADi, built once, that reads and writes the same memory at every call."""

    def __init__(self, plugin: str, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        n, m, A = len(problem.q), len(problem.b), casadi.DM(problem.A)
        self._solver: Any = casadi.conic(
            "solver",
            plugin,
            {"h": casadi.Sparsity(n, n), "a": A.sparsity()},
            {"error_on_fail": False, "print_time": False, **OPTIONS[plugin](tolerance / 10)},
        )
        self._zero, self._lower, self._upper = problem.zero, np.empty(m), np.empty(m)
        self._x, self._y = np.empty(n), np.empty(m)
        self._given = {
            "g": np.array(problem.q),
            "a": np.array(A.nonzeros()),
            "lba": self._lower,
            "uba": self._upper,
            "lbx": np.full(n, -np.inf),
            "ubx": np.full(n, np.inf),
        }
        # At run time it takes a view without its size, which its own types ask for.
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
        words = str(stats.get("return_status", stats["unified_return_status"]))
        counted = stats.get("iter_count", -1)
        steps = counted if counted > 0 else None
        if "infeasib" in words.lower() and "dual" not in words.lower():
            return SolverResult("infeasible", words, None, None, steps, seconds)
        said: Status = "solved" if stats["success"] else "stopped"
        return SolverResult(said, words, self._x.copy(), self._y.copy(), steps, seconds)


ADAPTERS = tuple(
    SolverAdapter(
        name=f"casadi-{plugin}",
        cone_types=frozenset({"linear"}),
        certifies_infeasibility=False,
        module="casadi",
        pip_packages="casadi",
        session_factory=partial(CasadiConicSession, plugin),
    )
    for plugin in OPTIONS
    if casadi.has_conic(plugin)
)
