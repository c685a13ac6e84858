"""Solvers of smooth programmes, by CasADi: cones are written as inequalities [Andersson2019]."""

from collections.abc import Callable
from functools import partial
from time import perf_counter
from typing import Any

import casadi
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import Conic
from problems.solvers.adapter import Adapter, Claim, Said

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


class Smooth:
    """A function of CasADi, built once, with b as its parameter.

    A cone (t, y) is t ≥ √(‖y‖² + ε²), which is smooth at its tip, inside of the cone, and
    further from it than ε nowhere. Its multiplier μ gives the duals μ (1, −y / √(‖y‖² + ε²)).
    """

    def __init__(self, plugin: str, problem: Conic, tolerance: float) -> None:
        """Read the problem."""
        self._linear, self._cones = problem.zero + problem.nonnegative, problem.cones
        self._round = tolerance / 10
        self._A, self._n = problem.A, len(problem.q)
        x, b = casadi.MX.sym("x", self._n), casadi.MX.sym("b", len(problem.b))
        s = b - casadi.DM(problem.A) @ x
        rows = [s[: self._linear]]
        for start, size in self._places():
            y = s[start + 1 : start + size]
            rows.append(s[start] - casadi.sqrt(casadi.sumsqr(y) + self._round**2))
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

    def solve(self, b: Float[Array, " m"]) -> Claim:
        """Solve with another right-hand side, from zero."""
        arguments = [casadi.DM.zeros(self._n), casadi.DM(b), -np.inf, np.inf, 0, self._upper, 0, 0]
        began = perf_counter()
        point, _, _, _, multipliers, _ = self._solver.call(arguments)
        seconds = perf_counter() - began
        stats = self._solver.stats()
        words, steps = stats["return_status"], stats["iter_count"]
        if words == "Infeasible_Problem_Detected":
            return Claim("infeasible", words, None, None, steps, seconds)
        x, μ = np.array(point).ravel(), -np.array(multipliers).ravel()
        said: Said = "solved" if stats["success"] else "stopped"
        return Claim(said, words, x, self._duals(b - self._A @ x, μ), steps, seconds)

    def _places(self) -> list[tuple[int, int]]:
        starts = self._linear + np.cumsum([0, *self._cones])
        return [(int(start), size) for start, size in zip(starts, self._cones, strict=False)]

    def _duals(self, s: Float[Array, " m"], μ: Float[Array, " g"]) -> Float[Array, " m"]:
        y = [μ[: self._linear]]
        for (start, size), weight in zip(self._places(), μ[self._linear :], strict=True):
            inner = s[start + 1 : start + size]
            y.append(
                weight * np.array([1.0, *(-inner / np.hypot(np.linalg.norm(inner), self._round))])
            )
        return np.concatenate(y)


ADAPTERS = tuple(
    Adapter(
        name=f"casadi-{plugin}",
        cones=frozenset({"linear", "second-order"}),
        proves=False,
        module="casadi",
        pip="casadi",
        begin=partial(Smooth, plugin),
    )
    for plugin in OPTIONS
    if casadi.has_nlpsol(plugin)
)
