"""Trajectories of least fuel by constraint generation: constraints join where they are violated.

A trajectory is subject to thousands of half-spaces, and few of them bind. A program begins with the
motion alone. The half-spaces that its solution violates most join, and tangents of the speed
limit, until none is violated; the program goes on from its last basis each time.
"""

from collections.abc import Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.conic import Infeasible, Unsolved
from problems.fuel_program import REFRESHED_TOLERANCE, FuelProgram
from problems.half_spaces import HalfSpaces
from problems.limit import Limit
from problems.solvers.verified import VerifiedSolver
from problems.transfer import Solver, Trajectory, TransferProblem

SPEED_ROOM = 1e-8  # of a speed limit, by which its tangents lie inside, beside rounding
TIE_BREAK = 1e-7  # of the weights, which makes optima unique, at the cost of at most this part
MAX_ROUNDS = 60


class Goal(NamedTuple):
    """State to be in after some steps, and the cost of an error in each of its entries.

    A penalty is that of a unit, over fuel; infinite where there may be no error, zero where it is
    of no matter.
    """

    step: int
    state: Float[Array, " n"]
    penalty: Float[Array, " n"]


def try_generating(transfer: TransferProblem, solver: Solver, *rest: Any) -> Trajectory | None:
    """Return what `generate_constraints` finds, for its further arguments.

    None where norms are not linear, where a solver was chosen, and where the method stops without
    an answer, which counts as a fallback to the conic solver; raises `Infeasible`.
    """
    if not isinstance(solver, VerifiedSolver) or not can_generate(transfer, solver):
        return None
    try:
        return generate_constraints(transfer, *rest)
    except Infeasible:
        raise
    except Unsolved as error:
        solver.count_fallback(f"constraint generation: {error}")
        return None


def can_generate(transfer: TransferProblem, solver: VerifiedSolver) -> bool:
    """Return True where constraint generation serves: norms are linear, and no solver is chosen."""
    return transfer.is_linear and solver.is_default


def generate_constraints(
    transfer: TransferProblem,
    start: Float[Array, " n"],
    goals: Sequence[Goal],
    spaces: HalfSpaces,
    tolerance: float,
    slack_penalty: float = inf,
) -> Trajectory:
    """Find the trajectory of least fuel, and penalties of what it misses, inside half-spaces.

    Args:
        transfer: Motion, limits and weights of the fuel.
        start: State at the start.
        goals: States to be in.
        spaces: Half-spaces.
        tolerance: By which a half-space may be violated [m].
        slack_penalty: Cost of the largest violation beyond it [1/s]; infinite where none may be.

    Raises:
        Infeasible: No trajectory satisfies the constraints that must hold.
        Unsolved: The method stopped without an answer.
    """
    limit, axes = transfer.control_limit, transfer.model.axes
    free, response = transfer.coast(start), limit.most * transfer.response_matrices[0]
    cost = limit.most * transfer.model.dt * np.repeat(transfer.weights, axes)
    cost = cost * np.tile(limit.shares, len(transfer.model))
    # Of equal optima one is the best: burns cost more in the middle, and along later axes.
    steps = len(transfer.model)
    time, axis = (np.arange(1, steps + 1) / (steps + 1))[:, None], np.arange(axes) / 8
    cost = cost * (1 + TIE_BREAK * (time * (1 - time) * (1 + time / 4) * (1 + axis)).ravel())
    unit = float(cost.max())
    program = FuelProgram(cost / unit, slack_penalty / unit)
    for k, state, penalty in goals:
        some = penalty > 0
        program.add(response[k][some], (free[k] - state)[some], penalty[some] / unit)
    known, is_confirmed = np.zeros(len(spaces.rhs), dtype=bool), False
    for _ in range(MAX_ROUNDS):
        status = program.confirm() if is_confirmed else program.solve()
        if status == "infeasible":
            raise Infeasible(transfer, "no trajectory satisfies the constraints")
        if status == "stopped":
            break
        shares = program.controls
        u = shares.reshape(-1, axes) * limit.most * limit.shares
        flown = transfer.simulate(start, u) if is_confirmed else None
        x = free + response @ shares if flown is None else flown.x
        violation = spaces.violation(x, u)
        new = spaces.find_peaks(np.where(known, 0.0, violation - program.slack), tolerance)
        fast = np.flatnonzero(transfer.is_too_fast(x)) + 1
        if not (new.any() or len(fast)):
            if flown is not None:
                return flown
            is_confirmed = True
            continue
        is_confirmed = False
        if new.any():
            known |= new
            coeffs, rhs = spaces.select(new).condense(transfer, free)
            program.add(coeffs * limit.most, rhs, is_relaxed=slack_penalty < inf)
        if len(fast):
            rows, most, at = _list_tangents(transfer.speed_limit, x[fast, axes:], fast)
            slower = -np.einsum("km,kmj->kj", rows, response[at, axes:])
            room = SPEED_ROOM * most + 3 * REFRESHED_TOLERANCE * np.linalg.norm(slower, axis=1)
            offset = most - np.einsum("km,km->k", rows, free[at, axes:]) - room
            program.add(slower, offset, room=room)
    raise Unsolved(transfer, f"no answer within {program.pivot_count} pivots")


def _list_tangents(
    limit: Limit, v: Float[Array, "k d"], instants: Int[Array, " k"]
) -> tuple[Float[Array, "rows d"], float, Int[Array, " rows"]]:
    """List rows F with F v ≤ L in the limit, and their instants, that cut off velocities beyond it.

    Of a ball, a velocity that is too fast is near a corner between two tangents. The tangent at
    its direction halves the angle between these; those on each side of it halve it once more.
    """
    if limit.faces is not None:
        count = len(limit.faces)
        return np.tile(limit.faces, (len(v), 1)), limit.most, np.repeat(instants, count)
    size = limit.measure(v)[:, None]
    unit = v / limit.shares / size
    width = np.sqrt(2 * np.maximum(size / limit.most - 1, 0.0)) / 2
    # Rows of the last factor are perpendicular to the first, which is the direction itself.
    across = width[..., None] * np.linalg.svd(unit[:, None, :])[2][:, 1:]
    ways = np.concatenate([unit[:, None], unit[:, None] + across, unit[:, None] - across], axis=1)
    ways /= np.linalg.norm(ways, axis=2, keepdims=True) * limit.shares
    return ways.reshape(-1, v.shape[1]), limit.most, np.repeat(instants, ways.shape[1])
