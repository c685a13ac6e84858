"""Avoidance problem with the states as unknowns: sparse, and so faster over many steps."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import block_array, block_diag, coo_array, csc_array, eye_array

from problems.conic import ConicProgram

if TYPE_CHECKING:
    from problems.avoidance import AvoidanceProblem


def assemble_sparse(problem: "AvoidanceProblem", limited: Int[Array, " instants"]) -> ConicProgram:
    """Assemble the program of least fuel, with speed limits at some instants.

    Unknowns are u⁺ and u⁻ in units of each axis's limit, then the states x[1] … x[T]. The arrival
    is that of `AvoidanceProblem.assemble_conic`, without the states, and as exact.

    Args:
        problem: The problem, of least fuel and without relaxation.
        limited: Instants between the ends with speed limits.
    """
    transfer, spaces, start = problem.transfer, problem.half_spaces, problem.start
    model, limit = transfer.model, transfer.control_limit
    (T, n, m), U = model.B.shape, limit.most
    N, states, rows = T * m, T * n, len(spaces.rhs)
    # x[k+1] − A[k] x[k] − B[k] u[k] = z[k]
    on_controls = block_diag(list(U * model.B * limit.shares), format="csc")
    later = block_diag([np.zeros((n, n)), *model.A[1:]], format="coo")
    below = later.data, (later.coords[0], later.coords[1] - n)
    motion = eye_array(states, format="csc") - csc_array(_keep(below), shape=(states, states))
    begin = model.z.copy()
    begin[0] += model.A[0] @ start
    response, factor = transfer.response_matrices
    whitening = np.linalg.inv(factor)
    reach, goal = csc_array(whitening @ response[T]), problem.goal - transfer.coast(start)[T]
    # Half-spaces at the start constrain its control alone.
    is_first, instant = spaces.step_index == 0, spaces.step_index * n
    known = np.where(is_first, spaces.state_coeffs @ start, 0.0)
    coeffs = np.where(is_first[:, None], 0.0, spaces.state_coeffs)
    on_x = _place(coeffs, np.maximum(instant - n, 0), states)
    on_u = _place(U * spaces.control_coeffs * limit.shares, spaces.step_index * m, N)
    unit = np.broadcast_to(np.eye(m), (len(limited), m, m))
    speed, speed_rhs = transfer.speed_limit.constrain(unit, np.zeros((len(limited), m)))
    first = np.repeat((limited - 1) * n + m, len(speed) // max(len(limited), 1))
    speed_x, none = _place(-speed, first, states), csc_array((len(speed), N))
    cones = len(speed) if transfer.speed_limit.faces is None else 0
    bounds = np.vstack([np.ones((2 * N, 1)), np.zeros((2 * N, 1))]).ravel()
    limits = [[eye_array(N), None, None], [None, eye_array(N), None]]
    limits += [[-eye_array(N), None, None], [None, -eye_array(N), None]]
    A = block_array(
        [
            [-on_controls, on_controls, motion],
            [reach, -reach, csc_array((n, states))],
            [-on_u, on_u, -on_x],
            *limits,
            [none, none, speed_x],
        ],
        format="csc",
    )
    b = [begin.ravel(), whitening @ goal / U, known - spaces.rhs, bounds, speed_rhs]
    weights = np.repeat(transfer.weights, m) * np.tile(limit.shares, T)
    q = np.concatenate([np.tile(U * model.dt * weights, 2), np.zeros(states)])
    nonnegative, sizes = rows + 4 * N + len(speed) - cones, (m + 1,) * (cones // (m + 1))
    return ConicProgram(q, A, np.concatenate(b), states + n, nonnegative, sizes)


def _keep(entries: tuple[Array, tuple[Array, Array]]) -> tuple[Array, tuple[Array, Array]]:
    data, (row, column) = entries
    there = column >= 0
    return data[there], (row[there], column[there])


def _place(rows: Float[Array, "k entries"], first: Int[Array, " k"], width: int) -> csc_array:
    """Place the entries of each row side by side, from a column on."""
    count, size = rows.shape
    row, column = np.repeat(np.arange(count), size), (first[:, None] + np.arange(size)).ravel()
    return csc_array(coo_array((rows.ravel(), (row, column)), shape=(count, width)))
