"""Many questions that share all but their ends, answered lot by lot on all cores."""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, no_type_check
from zlib import crc32

import numba
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems import speed_cuts
from problems.proof import Shared


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
    questions, N = len(b), len(shared.Q)
    found = Answers(
        np.empty((questions, N)),
        np.empty(questions),
        np.empty(questions, np.int64),
        np.empty(questions, np.int64),
    )

    def one(lot: int) -> None:
        here = slice(first[lot], first[lot + 1])
        _solve_lot(shared, b[here], free[here], pivots, *(field[here] for field in found))

    lots = [lot for lot in range(len(first) - 1) if first[lot] < first[lot + 1]]
    if len(lots) < 2:
        for lot in lots:
            one(lot)
        return found
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(one, lots))
    return found


def _kernel(stamp: int) -> Any:
    # Numba compiles anew when the file of a function changes, or what it closes over. The
    # stamp is of all the files that are compiled into this one function.
    @numba.njit(cache=True, nogil=True)
    @no_type_check
    def solve_lot(shared, b, free, pivots, x, bound, status, rounds):
        if stamp >= 0:
            speed_cuts.solve_lot(shared, b, free, pivots, x, bound, status, rounds)

    return solve_lot


_FILES = ("dual_simplex", "polish", "proof", "speed_cuts", "tableau")
_SOURCES = (Path(__file__).with_name(f"{name}.py").read_bytes() for name in _FILES)
_solve_lot = _kernel(crc32(b"".join(_SOURCES)))
