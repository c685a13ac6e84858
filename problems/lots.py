"""Many questions that share all but their ends, answered lot by lot on all cores."""

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.proof import Shared
from problems.speed_cuts import solve_lots

PARTS = 8  # of the work, for each core
FEW = 500  # questions without a speed limit, which one core answers before others are awake


class Answers(NamedTuple):
    """What was found, and how each question ended; see `proof`."""

    x: Float[Array, "questions N"]  # NaN where there is none
    bound: Float[Array, " questions"]
    status: Int[Array, " questions"]
    rounds: Int[Array, " questions"]  # of cuts


def answer(
    shared: Shared,
    b: Float[Array, "questions m"],
    free: Float[Array, "questions K d"],
    first: Int[Array, " fences"],
    pivots: int,
) -> Answers:
    """Answer every question; those of other lots do not change a bit of it.

    Args:
        shared: What the questions have in common.
        b: What each one asks for.
        free: s, the speeds without control.
        first: The question with which each lot begins, and at the end how many there are.
        pivots: After how many a climb is given up.
    """
    questions, N = len(b), len(shared.w)
    found = Answers(
        np.empty((questions, N)),
        np.empty(questions),
        np.empty(questions, np.int64),
        np.empty(questions, np.int64),
    )

    def some(bounds: Array) -> None:
        here = slice(bounds[0], bounds[-1])
        fields = (field[here] for field in found)
        solve_lots(shared, b[here], free[here], bounds - bounds[0], pivots, *fields)

    # Some take far longer than others: many parts of the work keep every core busy.
    threads, lots = os.cpu_count() or 1, len(first) - 1
    parts = min(lots, PARTS * threads)
    if parts < 2 or (len(shared.push) == 0 and questions < FEW):
        some(first)
        return found
    cuts = np.arange(parts + 1) * lots // parts
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(some, (first[a : b + 1] for a, b in pairwise(cuts))))
    return found
