"""Many questions that share all but their ends, answered lot by lot on all cores."""

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.certificates import TransferProgram
from problems.cutting_planes import solve_batch_kernel

TASKS_PER_CORE = 8  # of the work, for each core
MIN_PARALLEL = (
    500  # questions without a speed limit, which one core answers before others are awake
)


class BatchSolutions(NamedTuple):
    """What was found, and how each question ended; see `proof`."""

    x: Float[Array, "questions N"]  # NaN where there is none
    dual_bound: Float[Array, " questions"]
    status: Int[Array, " questions"]
    cut_rounds: Int[Array, " questions"]  # of cuts


def solve_batches(
    shared: TransferProgram,
    b: Float[Array, "questions m"],
    free: Float[Array, "questions K d"],
    batch_starts: Int[Array, " fences"],
    max_pivots: int,
) -> BatchSolutions:
    """Answer every question; those of other lots do not change a bit of it.

    Args:
        shared: What the questions have in common.
        b: What each one asks for.
        free: s, the speeds without control.
        first: The question with which each lot begins, and at the end how many there are.
        pivots: After how many a climb is given up.
    """
    questions, N = len(b), len(shared.w)
    found = BatchSolutions(
        np.empty((questions, N)),
        np.empty(questions),
        np.empty(questions, np.int64),
        np.empty(questions, np.int64),
    )

    def some(bounds: Array) -> None:
        here = slice(bounds[0], bounds[-1])
        fields = (field[here] for field in found)
        solve_batch_kernel(shared, b[here], free[here], bounds - bounds[0], max_pivots, *fields)

    # Some take far longer than others: many parts of the work keep every core busy.
    threads, lots = os.cpu_count() or 1, len(batch_starts) - 1
    parts = min(lots, TASKS_PER_CORE * threads)
    if parts < 2 or (len(shared.velocity_response) == 0 and questions < MIN_PARALLEL):
        some(batch_starts)
        return found
    cuts = np.arange(parts + 1) * lots // parts
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(some, (batch_starts[a : b + 1] for a, b in pairwise(cuts))))
    return found
