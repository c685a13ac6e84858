"""Avoidance problem with the states as unknowns: sparse, and so faster over many steps."""

from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import block_array, block_diag, coo_array, csr_array, eye_array, vstack

from problems.conic import ConicProgram
from problems.transfer import TransferProblem

if TYPE_CHECKING:
    from problems.avoidance import AvoidanceProblem


class _Rows(NamedTuple):
    """Constraints that are the same whatever the start, the goal and the half-spaces."""

    motion: csr_array  # and the arrival
    limits: csr_array
    whitening: Float[Array, "n n"]


def assemble_sparse(
    problem: "AvoidanceProblem", limited: Int[Array, " instants"], penalty: float = inf
) -> ConicProgram:
    """Assemble the program of least fuel, with speed limits at some instants.

    Unknowns are u⁺ and u⁻ in units of each axis's limit, then the states x[1] … x[T], then the
    slacks of the half-spaces, if they may be violated. The arrival is that of
    `AvoidanceProblem.assemble_conic`, without the states, and as exact.

    Args:
        problem: The problem, of least fuel; its terminal state is not relaxed.
        limited: Instants between the ends with speed limits.
        penalty: Cost of violating a half-space by a meter [m/s]; infinite where none may be.
    """
    transfer, spaces, start = problem.transfer, problem.half_spaces, problem.start
    model, limit = transfer.model, transfer.control_limit
    (T, n, m), U = model.B.shape, limit.most
    N, states, fixed = T * m, T * n, _assemble_rows(transfer)
    # x[k+1] − A[k] x[k] − B[k] u[k] = z[k]
    begin = model.z.copy()
    begin[0] += model.A[0] @ start
    goal = fixed.whitening @ (problem.goal - transfer.coast(start)[T])
    # Half-spaces at the start constrain its control alone.
    is_first = spaces.step_index == 0
    known = np.where(is_first, spaces.state_coeffs @ start, 0.0)
    on_u = U * spaces.control_coeffs * limit.shares
    on_x = np.where(is_first[:, None], 0.0, spaces.state_coeffs)
    at_u, at_x = spaces.step_index * m, 2 * N + np.maximum(spaces.step_index - 1, 0) * n
    avoid = _place([(-on_u, at_u), (on_u, N + at_u), (-on_x, at_x)], 2 * N + states)
    slacks = len(known) if penalty < inf else 0
    unit = np.broadcast_to(np.eye(m), (len(limited), m, m))
    speed, speed_rhs = transfer.speed_limit.constrain(unit, np.zeros((len(limited), m)))
    first = 2 * N + np.repeat((limited - 1) * n + m, len(speed) // max(len(limited), 1))
    slow = _place([(-speed, first)], 2 * N + states)
    cones = len(speed) if transfer.speed_limit.faces is None else 0
    if slacks:
        own, width = -eye_array(slacks), 2 * N + states
        rows = [[fixed.motion, None], [avoid, own], [coo_array((slacks, width)), own]]
        A = block_array([*rows, [fixed.limits, None], [slow, None]], format="csc")
    else:
        A = vstack([fixed.motion, avoid, fixed.limits, slow], format="csc")
    bounds = np.repeat([1.0, 0.0], 2 * N)
    b = [begin.ravel(), goal / U, known - spaces.rhs, np.zeros(slacks), bounds, speed_rhs]
    weights = np.repeat(transfer.weights, m) * np.tile(limit.shares, T)
    cost = np.tile(U * model.dt * weights, 2), np.zeros(states), np.full(slacks, penalty)
    q = np.concatenate(cost)
    nonnegative = len(known) + slacks + 4 * N + len(speed) - cones
    sizes = (m + 1,) * (cones // (m + 1))
    return ConicProgram(q, A, np.concatenate(b), states + n, nonnegative, sizes)


@lru_cache(maxsize=64)
def _assemble_rows(transfer: TransferProblem) -> _Rows:
    model, limit = transfer.model, transfer.control_limit
    (T, n, m), U = model.B.shape, limit.most
    N, states = T * m, T * n
    on_controls = block_diag(list(U * model.B * limit.shares))
    later = block_diag([np.zeros((n, n)), *model.A[1:]], format="coo")
    is_there = later.coords[1] >= n
    place = later.coords[0][is_there], later.coords[1][is_there] - n
    motion = eye_array(states) - coo_array((later.data[is_there], place), shape=(states, states))
    response, factor = transfer.response_matrices
    whitening = np.linalg.inv(factor)
    reach = coo_array(whitening @ response[T])
    rows = [[-on_controls, on_controls, motion], [reach, -reach, coo_array((n, states))]]
    controls, none = eye_array(2 * N), coo_array((2 * N, states))
    limits = [[controls, none], [-controls, none]]
    return _Rows(block_array(rows, format="csr"), block_array(limits, format="csr"), whitening)


def _place(blocks: list[tuple[Float[Array, "k _"], Int[Array, " k"]]], width: int) -> csr_array:
    """Place the entries of each row of some blocks side by side, from a column on."""
    data = np.hstack([entries for entries, _ in blocks])
    column = np.hstack([first[:, None] + np.arange(own.shape[1]) for own, first in blocks])
    return csr_array(
        (data.ravel(), column.ravel(), np.arange(0, data.size + 1, data.shape[1])),
        shape=(len(data), width),
    )
