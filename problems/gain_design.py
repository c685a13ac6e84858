"""Design of formation gains: the fastest gains, or a proof that none stabilize."""

from contextlib import suppress
from functools import cache
from importlib import import_module
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt
from numpy import ndarray as Array
from threadpoolctl import ThreadpoolController

from dynamics.doors import checked
from problems import gain_admm
from problems.conic import Unsolved
from problems.desired_formation import DesiredFormation
from problems.gain_admm import RATE_TOLERANCE
from problems.gain_matrix import GainMatrix, validate_gains, validate_rate
from problems.gain_problem import MIN_RATE, Axes, GainProblem, GainSolution, NoGainMatrix

__all__ = ["GainDesignUndecided", "GainMatrix", "NoStabilizingGain", "design_gains"]

GainMethod = Literal["auto", "projection", "admm", "sdp", "paper"]
AXES_TEXT = {"xy": "horizontally", "z": "vertically"}
SDP_MAX_AGENTS = 15  # for so many the semidefinite program takes about a second


class NoStabilizingGain(RuntimeError):
    """Proof that no gains stabilize the formation faster than `MIN_RATE`.

    Attributes:
        formation: Desired formation and its graph.
        axes: "xy" or "z", for which there are no gains.
        dual: Certificate Y on the non-edges, see `GainProblem.rate_bound`.
        bound: The rate that it allows, at most `MIN_RATE`.
    """

    def __init__(self, formation: DesiredFormation, axes: Axes, dual: Array) -> None:
        i, j = sorted(np.unravel_index(np.abs(dual).argmax(), dual.shape))
        self.formation, self.axes, self.dual = formation, axes, dual
        self.bound = GainProblem.from_formation(formation, axes).rate_bound(dual)
        faster, allowed = "", "no rate above 0"
        if self.bound > 0:
            faster = f" faster than {MIN_RATE:.0e} of their mean"
            allowed = f"a rate of at most {self.bound:.1e}"
        subject = f"no gains stabilize {_format_formation(formation)} {AXES_TEXT[axes]}{faster}"
        cure = f"add edges, first between {i} and {j}"
        super().__init__(f"{subject}: its graph allows {allowed}, by proof; {cure}")


class GainDesignUndecided(RuntimeError):
    """Neither stable gains nor a proof that there are none.

    Attributes:
        formation: Desired formation and its graph.
        axes: "xy" or "z", for which no stable gains were found.
        rate: Best rate found.
        bound: Least proven bound on the rate.
    """

    def __init__(
        self, formation: DesiredFormation, axes: Axes, method: str, rate: float, bound: float
    ) -> None:
        self.formation, self.axes, self.rate, self.bound = formation, axes, rate, bound
        where = f"{_format_formation(formation)} {AXES_TEXT[axes]}"
        found = f"the method {method} found no stable gains for {where}: their rate is {rate:.1e}"
        super().__init__(f"{found}, and rates up to {bound:.1e} are not excluded; add edges")


@checked
def design_gains(
    formation: DesiredFormation,
    method: GainMethod = "auto",
    tolerance: Annotated[float, Gt(0)] = RATE_TOLERANCE,
    joint: bool = False,
) -> GainMatrix:
    """Design the gains of the largest convergence rate for a mean eigenvalue of −1.

    Every method solves the same program, horizontally and vertically (`GainProblem`), for a
    mean of −1 in each direction, as the paper does from (7) on:

    - "auto": on the complete graph A = −(I − K Kᴴ), of which all eigenvalues outside the
      kernel K are −1; since that is their mean, nothing is faster. Otherwise as "admm", and
      where that misses the tolerance with 15 agents or fewer, the better of it and "sdp".
    - "projection": the gains nearest to those; one linear system. On sparse graphs they are
      often unstable.
    - "admm": splitting until the rate is within `tolerance` of a proven bound, for 3000
      iterations at most.
    - "sdp": a general interior-point solver; n ≤ 30 or so.
    - "paper": the iteration of the paper, for comparison.

    The result of a method is projected once more, so that residuals are those of rounding.
    Rate and bound are computed from the matrices. Unstable gains are never returned.

    Args:
        formation: Shape and graph.
        method: See above.
        tolerance: Largest gap between rate and bound relative to the bound, for "auto" and
            "admm".
        joint: Share one trace by the two directions so that they are equally fast
            [Lusk2020, eq. 5]; `GainMatrix.joint_bound` is then the proof.

    Returns:
        Stable gains. On graphs that hardly hold the shape, `gap_xy` and `gap_z` may exceed
        the tolerance.

    Raises:
        NoStabilizingGain: There are none, with the proof.
        GainDesignUndecided: The method found neither stable gains nor that proof.
        Unsolved: The solver of "sdp" failed.
        ValueError: The method is unknown, or the tolerance is not positive.
    """
    # On busy cores a second thread only waits.
    with _blas_libraries().limit(limits=1, user_api="blas"):
        xy, bound_xy, method_xy = _design_axes(formation, "xy", method, tolerance)
        z, bound_z, method_z = _design_axes(formation, "z", method, tolerance)
        used = method_xy if method_xy == method_z else f"{method_xy}; vertical {method_z}"
        gains = GainMatrix(formation, -xy, -z, used, bound_xy, bound_z)
        return gains.scaled_jointly() if joint else gains


@cache
def _blas_libraries() -> ThreadpoolController:
    # To find the libraries takes longer than small gains; SciPy has loaded its own by now.
    return ThreadpoolController()


def _design_axes(
    formation: DesiredFormation, axes: Axes, method: GainMethod, tolerance: float
) -> tuple[Array, float, str]:
    problem = GainProblem.from_formation(formation, axes)
    if method == "auto" and problem.is_complete:
        return problem.complete_solution, 1.0, "closed form"
    used: str = "admm" if method == "auto" else method
    try:
        L, Y = _solve(problem, used, tolerance)
        if method == "auto" and len(L) <= SDP_MAX_AGENTS:
            (L, Y), used = _improve_with_sdp(problem, GainSolution(L, Y), tolerance)
        L = problem.project(L).L
    except NoGainMatrix as none:
        raise NoStabilizingGain(formation, axes, none.dual) from none
    rate, bound = problem.convergence_rate(L), problem.rate_bound(Y)
    if bound <= MIN_RATE:
        raise NoStabilizingGain(formation, axes, Y)
    if rate <= MIN_RATE:
        raise GainDesignUndecided(formation, axes, used, rate, bound)
    try:
        validate_gains(formation, axes, -L)
        validate_rate(axes, rate, bound)
    except ValueError as error:  # points so close that rounding decides: no gains were found
        raise GainDesignUndecided(formation, axes, used, 0.0, bound) from error
    return L, bound, used


def _improve_with_sdp(
    problem: GainProblem, solution: GainSolution, tolerance: float
) -> tuple[GainSolution, str]:
    best = gain_admm.BestSolution(problem, solution)
    if best.is_within(tolerance):
        return solution, "admm"
    with suppress(Unsolved):  # the first solution remains
        best.update(_solve(problem, "sdp", tolerance))
    return best.solution, "admm and sdp"


def _solve(problem: GainProblem, method: str, tolerance: float) -> GainSolution:
    if method == "projection":
        return problem.project(np.eye(len(problem.graph)))
    if method == "admm":
        return gain_admm.solve(problem, tolerance)
    # The slow methods are imported on demand: loading their solvers takes seconds.
    solution: GainSolution = import_module(f"problems.gain_{method}").solve(problem)
    return solution


def _format_formation(formation: DesiredFormation) -> str:
    return f'"{formation.name}"' if formation.name else "this formation"
