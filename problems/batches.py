"""Many programs that differ in their right-hand sides, solved in batches on all cores."""

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.certificates import TransferProgram
from problems.cutting_planes import solve_batch_kernel

TASKS_PER_CORE = 8  # some batches take far longer than others: small tasks balance the cores
MIN_PARALLEL = 500  # programs without a speed limit that are worth starting threads for


class BatchSolutions(NamedTuple):
    """Solutions, and the status of each program, as in `certificates`."""

    x: Float[Array, "programs N"]  # NaN where there is none
    dual_bound: Float[Array, " programs"]
    status: Int[Array, " programs"]


def solve_batches(
    shared: TransferProgram,
    b: Float[Array, "programs m"],
    free_velocity: Float[Array, "programs K d"],
    batch_starts: Int[Array, " fences"],
    max_pivots: int,
) -> BatchSolutions:
    """Solve every program; those of other batches do not change a bit of its solution.

    Args:
        shared: Data that the programs have in common.
        b: Right-hand sides of the equations.
        free_velocity: s, the velocities without control.
        batch_starts: First program of each batch, and at the end the number of programs.
        max_pivots: Pivots after which an ascent is stopped.
    """
    count, N = len(b), len(shared.w)
    found = BatchSolutions(np.empty((count, N)), np.empty(count), np.empty(count, np.int64))

    def solve_some(starts: Array) -> None:
        some = slice(starts[0], starts[-1])
        fields = (field[some] for field in found)
        first = starts - starts[0]
        solve_batch_kernel(shared, b[some], free_velocity[some], first, max_pivots, *fields)

    threads, batches = os.cpu_count() or 1, len(batch_starts) - 1
    tasks = min(batches, TASKS_PER_CORE * threads)
    if tasks < 2 or (len(shared.velocity_response) == 0 and count < MIN_PARALLEL):
        solve_some(batch_starts)
        return found
    ends = np.arange(tasks + 1) * batches // tasks
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(solve_some, (batch_starts[i : j + 1] for i, j in pairwise(ends))))
    return found
