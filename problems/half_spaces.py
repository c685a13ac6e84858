"""Half-spaces for the control points of a trajectory: collision constraints, made convex."""

from typing import Any, NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.model import ControlSamples, StateSamples
from problems.transfer import TransferProblem


class HalfSpaces(NamedTuple):
    """Linear constraints state_coeffs · x[step] + control_coeffs · u[step] ≥ rhs, one a row."""

    step_index: Int[Array, " rows"]
    state_coeffs: Float[Array, "rows n"]
    control_coeffs: Float[Array, "rows m"]
    rhs: Float[Array, " rows"]

    def violation(self, x: StateSamples, u: ControlSamples) -> Float[Array, " rows"]:
        """Compute rhs minus the left-hand side of each row; positive where it is violated."""
        x, u = (np.ascontiguousarray(part, dtype=float) for part in (x, u))
        return np.asarray(_violation(*self, x, u))

    def to_cvxpy(self, x: Any, u: Any) -> Any:
        """Express the left-hand sides in CVXPY variables."""
        import cvxpy as cp

        on_x = cp.sum(cp.multiply(self.state_coeffs, x[self.step_index]), axis=1)
        return on_x + cp.sum(cp.multiply(self.control_coeffs, u[self.step_index]), axis=1)

    def condense(
        self, transfer: TransferProblem, free: Float[Array, "instants n"]
    ) -> tuple[Float[Array, "rows controls"], Float[Array, " rows"]]:
        """Eliminate the states: coeffs and rhs of −coeffs · u ≤ rhs, given the free motion.

        As in `TransferProblem.response_matrices`, u is in units of each axis's share.
        """
        R, (T, _, m) = transfer.response_matrices[0], transfer.model.B.shape
        rows, step = np.arange(len(self.rhs)), self.step_index
        coeffs = np.einsum("rn,rnj->rj", self.state_coeffs, R[step])
        coeffs.reshape(-1, T, m)[rows, step] += self.control_coeffs * transfer.control_limit.shares
        return coeffs, (self.state_coeffs * free[step]).sum(1) - self.rhs

    def condense_breakable(
        self, transfer: TransferProblem, free: Float[Array, "instants n"]
    ) -> tuple[Float[Array, "rows controls"], Float[Array, " rows"]]:
        """Condense the rows that some controls within the limit break; most hold for any."""
        coeffs, rhs = self.condense(transfer, free)
        breakable = transfer.control_limit.most * np.abs(coeffs).sum(axis=1) > rhs
        return coeffs[breakable], rhs[breakable]

    def select(self, rows: Array) -> "HalfSpaces":
        """Select rows by a mask or by index."""
        return HalfSpaces(*(field[rows] for field in self))

    def join(self, others: "HalfSpaces") -> "HalfSpaces":
        """Return these rows and those of others."""
        return HalfSpaces(*(np.concatenate(both) for both in zip(self, others, strict=True)))

    def find_peaks(
        self, violation: Float[Array, " rows"], tolerance: float
    ) -> Bool[Array, " rows"]:
        """Find the rows violated most, by more than a tolerance [m], at the steps around theirs."""
        return np.asarray(_peaks(self.step_index, violation, tolerance, True))

    def worst_per_step(
        self, violation: Float[Array, " rows"], tolerance: float
    ) -> Bool[Array, " rows"]:
        """Select the rows that are violated most at each step, by more than a tolerance [m]."""
        return np.asarray(_peaks(self.step_index, violation, tolerance, False))


def empty_half_spaces(transfer: TransferProblem) -> HalfSpaces:
    """Return no half-spaces, for an agent without conflicts."""
    n, m = transfer.model.B.shape[1:]
    return HalfSpaces(np.zeros(0, int), np.zeros((0, n)), np.zeros((0, m)), np.zeros(0))


def separate_points(
    maps: tuple[Array, Array, Array],
    normal: Float[Array, "others pieces d"],
    points: Float[Array, "others pieces 4 d"],
    separation: Float[Array, " others"],
) -> HalfSpaces:
    """List the half-spaces n·(P x + Q u + r − c̄) ≥ R of all points that a control can move.

    Args:
        maps: P, Q and r of each control point, (T, S, 4, d, ·), of the first pieces.
        normal: Unit normals n.
        points: Control points c̄ of others [m].
        separation: Required distance R from each [m].
    """
    P, Q, r = maps
    pieces = P.shape[0] * P.shape[1]
    is_short = min(normal.shape[1], points.shape[1]) < pieces
    if is_short or not len(normal) == len(points) == len(separation):
        raise ValueError(
            f"{pieces} pieces need as many normals and points of each other, got normals of shape "
            f"{normal.shape} and points of shape {points.shape} for {len(separation)} others"
        )
    movable = np.any(Q != 0, axis=(3, 4))
    movable[1:] = True
    return HalfSpaces(*_separate(P, Q, r, movable, normal, points, separation))


@numba.njit(cache=True, nogil=True)
@no_type_check
def _separate(P, Q, r, movable, normal, points, separation):
    T, S, _, d, n = P.shape
    rows = len(points) * movable.sum()
    step_index, rhs = np.empty(rows, np.int64), np.empty(rows)
    state_coeffs, control_coeffs = np.zeros((rows, n)), np.zeros((rows, d))
    row = 0
    for other in range(len(points)):
        for k in range(T):
            for s in range(S):
                piece = k * S + s
                for i in range(4):
                    if not movable[k, s, i]:
                        continue
                    step_index[row], rhs[row] = k, separation[other]
                    for a in range(d):
                        along = normal[other, piece, a]
                        rhs[row] += along * (points[other, piece, i, a] - r[k, s, i, a])
                        for j in range(n):
                            state_coeffs[row, j] += along * P[k, s, i, a, j]
                        for j in range(d):
                            control_coeffs[row, j] += along * Q[k, s, i, a, j]
                    row += 1
    return step_index, state_coeffs, control_coeffs, rhs


@numba.njit(cache=True, nogil=True)
@no_type_check
def _violation(step_index, state_coeffs, control_coeffs, rhs, x, u):
    found = rhs.copy()
    for row in range(len(rhs)):
        k = step_index[row]
        for i in range(x.shape[1]):
            found[row] -= state_coeffs[row, i] * x[k, i]
        for i in range(u.shape[1]):
            found[row] -= control_coeffs[row, i] * u[k, i]
    return found


@numba.njit(cache=True, nogil=True)
@no_type_check
def _peaks(step_index, violation, tolerance, among_neighbors):
    # The largest violations of each step, above a tolerance; of peaks alone if among neighbors.
    rows, steps = len(violation), 0
    for row in range(rows):
        steps = max(steps, step_index[row] + 1)
    worst = np.full(steps + 2, tolerance)
    for row in range(rows):
        k = step_index[row] + 1
        worst[k] = max(worst[k], violation[row])
    found = np.zeros(rows, np.bool_)
    for row in range(rows):
        k = step_index[row] + 1
        is_peak = not among_neighbors or (worst[k] >= worst[k - 1] and worst[k] >= worst[k + 1])
        found[row] = is_peak and violation[row] > tolerance and violation[row] >= worst[k]
    return found
