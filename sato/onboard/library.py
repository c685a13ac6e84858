"""Python interface to the exported C, for tests before flight."""

import ctypes
import re
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.half_spaces import HalfSpaces

LIBRARY = "libsato_onboard.so"
SOLVED, UNSOLVED, INVALID_INPUT = 0, 1, 2  # as in sato_onboard.h


class OnboardSolution(NamedTuple):
    """Solution of the C code; see sato_flight in sato_onboard.h."""

    code: int
    u: Float[Array, "T m"]  # [m/s²]
    fuel: float  # [m/s]
    cost: float  # [m/s]
    position_error: float  # [m]
    velocity_error: float  # [m/s]
    half_space_violation: float  # in the unit of its right-hand side
    speed_violation: float  # [m/s]
    residual: float  # relative


SOLUTION_FIELDS = OnboardSolution._fields[2:]  # the scalars of sato_flight, which follow u


class CompiledSolver:
    """Solver in a folder of `export_c`, compiled with `make`; it takes one call at a time."""

    def __init__(self, folder: str | Path) -> None:
        """Compile the code where that was not done yet, and load it; say why it cannot be."""
        made = subprocess.run(["make", "-s"], cwd=folder, capture_output=True, text=True)
        if made.returncode != 0:
            raise ValueError(f"{folder}: does not compile: {made.stderr}")
        self._solve = ctypes.CDLL(str(Path(folder, LIBRARY).resolve())).sato_solve
        header = Path(folder, "sato_model.h").read_text(encoding="utf-8")
        defined = dict(re.findall(r"#define SATO_(\w+) (\S+) ", header))
        n, m, T = (int(defined[name]) for name in ("STATE", "AXES", "STEPS"))
        row = [("step", "i4"), ("on_state", "f8", n), ("on_control", "f8", m), ("least", "f8")]
        self._row = np.dtype(row, align=True)
        self._answer = np.dtype([("u", "f8", (T, m)), *((name, "f8") for name in SOLUTION_FIELDS)])

    def solve(
        self, start: Float[Array, " n"], target: Float[Array, " n"], half_spaces: HalfSpaces
    ) -> OnboardSolution:
        """Solve for a transfer from start to target among half-spaces."""
        count = len(half_spaces.rhs)
        rows = np.zeros(max(count, 1), self._row)
        for name, column in zip(self._row.names or (), half_spaces, strict=True):
            rows[name][:count] = column
        answer = np.zeros((), self._answer)
        ends = [np.ascontiguousarray(state, dtype=float) for state in (start, target)]
        code = self._solve(*map(_pointer, (*ends, rows)), count, _pointer(answer))
        scalars = (float(answer[name]) for name in SOLUTION_FIELDS)
        return OnboardSolution(code, np.array(answer["u"]), *scalars)


def _pointer(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
