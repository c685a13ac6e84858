"""The design of gains: the fastest for a formation, or the proof that it cannot have any."""

from collections.abc import Callable
from contextlib import suppress
from typing import Literal

import numpy as np
from jaxtyping import Inexact
from numpy import ndarray as Array
from threadpoolctl import threadpool_limits

from problems import gain_admm as admm
from problems.conic import Unsolved
from problems.desired_formation import DesiredFormation
from problems.gain_matrix import GainMatrix
from problems.gain_problem import MIN_RATE, Axes, GainProblem, GainSolution, NoGainMatrix

__all__ = ["GainDesignUndecided", "GainMatrix", "NoStabilizingGain", "design_gains"]

GainMethod = Literal["auto", "projection", "admm", "sdp", "paper"]
AXES_TEXT = {"xy": "in the plane", "z": "upwards"}
SDP_MAX_AGENTS = 15  # vehicles, up to which the general solver takes a second and is asked for help


class NoStabilizingGain(RuntimeError):
    """It is proven that no gains make the formation form, or none faster than `NO_RATE`.

    Attributes:
        formation: The shape and graph asked for.
        which: The direction, "xy" or "z", in which there are none.
        dual: Y on the non-edges, the proof: see `Question.bound`.
        bound: The rate that it leaves, at most `NO_RATE`.
    """

    def __init__(
        self, formation: DesiredFormation, which: Axes, dual: Inexact[Array, "n n"]
    ) -> None:
        i, j = sorted(np.unravel_index(np.abs(dual).argmax(), dual.shape))
        self.formation, self.axes, self.dual = formation, which, dual
        self.bound = GainProblem.from_formation(formation, which).rate_bound(dual)
        where = f"no gains stabilise {_format_formation(formation)} {AXES_TEXT[which]}"
        if self.bound > 0:
            where += f" faster than {MIN_RATE:.0e} of their mean"
            allowed = f"a rate of at most {self.bound:.1e}"
        else:
            allowed = "no rate above 0"
        super().__init__(
            f"{where}: its graph allows {allowed}, by proof; add edges, between {i} and {j} first"
        )


class GainDesignUndecided(RuntimeError):
    """Neither stable gains were found nor a proof that there are none.

    Attributes:
        formation: The shape and graph asked for.
        which: The direction, "xy" or "z", in which it is so.
        rate: The best rate found.
        bound: A rate that is proven to be out of reach.
    """

    def __init__(
        self, formation: DesiredFormation, which: Axes, method: str, rate: float, bound: float
    ) -> None:
        self.formation, self.axes, self.rate, self.bound = formation, which, rate, bound
        super().__init__(
            f"the method {method} found no stable gains for {_format_formation(formation)} "
            f"{AXES_TEXT[which]}: their rate is {rate:.1e}, and up to {bound:.1e} is not excluded; "
            'method "auto" may find more, for few vehicles "sdp" too, and more edges will help'
        )


def design_gains(
    formation: DesiredFormation, method: GainMethod = "auto", tolerance: float = admm.RATE_TOLERANCE
) -> GainMatrix:
    """The gains with which the formation forms fastest, for their mean eigenvalue.

    Every method answers the same programme, in the plane and upwards (`Question`):

    - "auto": on the complete graph A = −(I − K Kᴴ), of which all eigenvalues outside the
      kernel K are −1; since that is their mean, nothing is faster. Otherwise as "admm", and
      where that gives up with 15 vehicles or fewer, the better of it and "sdp".
    - "projection": the gains nearest to those; one linear system. On sparse graphs they are
      often not stable.
    - "admm": from there on, alternating directions until the rate is within `tolerance` of
      a bound that is proven, for 3000 rounds at most.
    - "sdp": a general interior-point solver; n ≤ 30 or so.
    - "paper": the paper's own iteration, to be compared with.

    What a method returns is projected once more, so that residuals are those of rounding, and
    its rate and bound are computed from the matrices. Nothing unstable is returned.

    Args:
        formation: Shape and graph.
        method: See above.
        tolerance: Share of the bound by which the rate may be less, for "auto" and "admm".

    Returns:
        Stable gains. Where the rounds did not suffice, as on graphs that hardly hold the
        shape, `gap_xy` and `gap_z` may be more than the tolerance; they tell by how much.

    Raises:
        NoStabilisingGain: There are none, with the proof.
        Undecided: The method found neither stable gains nor that proof.
    """
    with threadpool_limits(1, user_api="blas"):  # on busy cores a second thread only waits
        xy, bound_xy, how = _design_axes(formation, "xy", method, tolerance)
        z, bound_z, also = _design_axes(formation, "z", method, tolerance)
        ways = how if how == also else f"{how}; upwards {also}"
        return GainMatrix(formation, -xy, -z, ways, bound_xy, bound_z)


def _design_axes(
    formation: DesiredFormation, which: Axes, method: GainMethod, tolerance: float
) -> tuple[Array, float, str]:
    asked = GainProblem.from_formation(formation, which)
    if method == "auto" and asked.is_complete:
        K = asked.kernel
        return np.eye(len(K)) - K @ K.conj().T, 1.0, "closed form"
    way: str = "admm" if method == "auto" else method
    try:
        L, Y = _select_solver(way, tolerance)(asked)
        if method == "auto" and len(L) <= SDP_MAX_AGENTS:
            (L, Y), way = _improve_with_sdp(asked, GainSolution(L, Y), tolerance)
        L = asked.project((L + L.conj().T) / 2)
    except NoGainMatrix as none:
        raise NoStabilizingGain(formation, which, none.dual) from none
    rate, bound = asked.convergence_rate(L), asked.rate_bound(Y)
    if bound <= MIN_RATE:
        raise NoStabilizingGain(formation, which, Y)
    if rate <= MIN_RATE:
        raise GainDesignUndecided(formation, which, way, rate, bound)
    return L, bound, way


def _improve_with_sdp(
    asked: GainProblem, found: GainSolution, tolerance: float
) -> tuple[GainSolution, str]:
    best = admm.BestSolution(asked, found)
    if best.is_within(tolerance):
        return found, "admm"
    with suppress(Unsolved):  # then what was found before is what there is
        best.update(_select_solver("sdp", tolerance)(asked))
    return best.solution, "admm and sdp"


def _select_solver(method: str, tolerance: float) -> Callable[[GainProblem], GainSolution]:
    # The slow ones are imported when they are asked for; loading their solvers takes seconds.
    if method == "projection":
        return lambda asked: GainSolution(*asked.project_with_remainder(np.eye(len(asked.graph))))
    if method == "admm":
        return lambda asked: admm.solve(asked, tolerance)
    if method == "sdp":
        from problems.gain_sdp import solve as sdp

        return sdp
    if method == "paper":
        from problems.gain_paper import solve as paper

        return paper
    raise ValueError(f'gains are designed by auto, projection, admm, sdp or paper, not "{method}"')


def _format_formation(formation: DesiredFormation) -> str:
    return f'"{formation.name}"' if formation.name else "this formation"
