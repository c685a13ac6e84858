"""Avoidance problem with the states as unknowns: sparse, and so faster over many steps."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array
from scipy.sparse import block_array, block_diag, coo_array, csc_array, eye_array

from problems.conic import ConicProgram

if TYPE_CHECKING:
    from problems.avoidance import AvoidanceProblem

FEWEST_STEPS = 24  # with which it is faster than the program without states


def pays_off(problem: "AvoidanceProblem") -> bool:
    """Tell whether a problem is better posed with its states as unknowns."""
    transfer = problem.transfer
    return transfer.objective == "fuel" and len(transfer.model) >= FEWEST_STEPS


def assemble_sparse(problem: "AvoidanceProblem", limited: Int[Array, " instants"]) -> ConicProgram:
    """Assemble the program of least fuel, with speed limits at some instants.

    Unknowns are u⁺ and u⁻ in units of each axis's limit, then the states x[1] … x[T]. The arrival
    is that of the program without states, so that it is as exact.

    Args:
        problem: The problem.
        limited: Instants between the ends with speed limits.
    """
    transfer, spaces = problem.transfer, problem.half_spaces
    (T, n, m), limit = transfer.model.B.shape, transfer.control_limit
    N, U, start = T * m, limit.most, problem.start
    R, factor = transfer.response_matrices
    model = transfer.model
    # x[k+1] − A x[k] − B u[k] = z[k]
    scaled = U * model.B * limit.shares
    motion_u = block_diag(list(scaled), format="csc")
    motion_x = eye_array(T * n, format="csc")
    if T > 1:
        below = block_diag(list(model.A[1:]), format="coo")
        rows, columns = below.coords
        motion_x = motion_x - csc_array((below.data, (rows + n, columns)), shape=(T * n, T * n))
    first = model.z.copy()
    first[0] += model.A[0] @ start
    whitening = np.linalg.inv(factor)
    reach = csc_array(whitening @ R[T])
    goal = whitening @ (problem.goal - transfer.coast(start)[T]) / U

    count = len(spaces.rhs)
    row, k = np.arange(count), spaces.step_index
    held = k == 0
    on_start = np.where(held, spaces.state_coeffs @ start, 0.0)
    space_x = _scatter(np.where(held[:, None], 0.0, spaces.state_coeffs), row, (k - 1) * n, T * n)
    space_u = _scatter(U * spaces.control_coeffs * limit.shares, row, k * m, N)

    unit = np.broadcast_to(np.eye(m), (len(limited), m, m))
    blocks, speed_rhs = transfer.speed_limit.constrain(unit, np.zeros((len(limited), m)))
    per = len(blocks) // max(len(limited), 1)
    at = np.repeat((limited - 1) * n + m, per)
    speed_x = -_scatter(blocks, np.arange(len(blocks)), at, T * n)
    is_cone = transfer.speed_limit.faces is None
    linear, cones = (0, len(blocks)) if is_cone else (len(blocks), 0)

    bounds_u = block_array([[eye_array(2 * N)], [-eye_array(2 * N)]])
    parts = [
        [-motion_u, motion_u, motion_x],
        [reach, -reach, None],
        [-space_u, space_u, -space_x],
    ]
    speeds = [[csc_array((len(blocks), N))] * 2 + [speed_x]] if len(blocks) else []
    top = block_array([*parts, *(speeds if linear else [])], format="csc")
    middle = block_array([[bounds_u, csc_array((4 * N, T * n))]], format="csc")
    bottom = [block_array(speeds, format="csc")] if cones else []
    from scipy.sparse import vstack

    A = vstack([top, middle, *bottom], format="csc")
    bounds = np.concatenate([np.ones(2 * N), np.zeros(2 * N)])
    b = np.concatenate([
        first.ravel(), goal, on_start - spaces.rhs, speed_rhs[:linear], bounds, speed_rhs[linear:]
    ])  # fmt: skip
    weights = np.repeat(transfer.weights, m) * np.tile(limit.shares, T)
    q = np.concatenate([np.tile(U * model.dt * weights, 2), np.zeros(T * n)])
    nonnegative = count + linear + len(bounds)
    return ConicProgram(q, A, b, T * n + n, nonnegative, (m + 1,) * (cones // (m + 1)))


def _scatter(blocks: Array, row: Array, column: Array, width: int) -> csc_array:
    """Place the entries of rows at columns from one on."""
    own = np.arange(blocks.shape[1])
    rows, columns = np.repeat(row, len(own)), (np.maximum(column, 0)[:, None] + own).ravel()
    return csc_array(coo_array((blocks.ravel(), (rows, columns)), shape=(len(blocks), width)))
