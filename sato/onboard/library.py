"""Python interface to the exported C, for tests before flight."""

import ctypes
import re
import subprocess
from pathlib import Path
from time import thread_time
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.avoidance import HalfSpaces

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
    seconds: float  # processor time of the call [s]


SOLUTION_FIELDS = OnboardSolution._fields[2:-1]  # the scalars of sato_flight, which follow u


class CompiledSolver:
    """Solver in a folder of `export_c`, compiled with `make`; it takes one call at a time."""

    def __init__(self, folder: str | Path) -> None:
        """Load the library.

        Raises:
            ValueError: The folder has none.
        """
        library = Path(folder, "libsato_onboard.so")
        if not library.is_file():
            raise ValueError(
                f"{library}: there is no such file; run make in its folder to compile it"
            )
        self._solve = ctypes.CDLL(str(library.resolve())).sato_solve
        n, m, T = _read_sizes(Path(folder, "sato_model.h"), "STATE", "AXES", "STEPS")
        self._row = np.dtype(
            [("step", "i4"), ("on_state", "f8", n), ("on_control", "f8", m), ("least", "f8")],
            align=True,
        )
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
        began = thread_time()
        code = self._solve(*map(_pointer, (*ends, rows)), count, _pointer(answer))
        seconds = thread_time() - began
        scalars = {name: float(answer[name]) for name in SOLUTION_FIELDS}
        return OnboardSolution(code, np.array(answer["u"]), **scalars, seconds=seconds)


def compile_solver(folder: str | Path) -> CompiledSolver:
    """Compile the code of `export_c`, and load it.

    Raises:
        ValueError: There is no make or no C compiler, or the code does not compile.
    """
    try:
        subprocess.run(["make", "-s"], cwd=folder, check=True, capture_output=True, text=True)
    except FileNotFoundError as error:
        raise ValueError("compilation needs make and a C compiler, and there is no make") from error
    except subprocess.CalledProcessError as error:
        raise ValueError(f"{folder}: does not compile: {error.stderr}") from error
    return CompiledSolver(folder)


def _pointer(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _read_sizes(header: Path, *names: str) -> list[int]:
    defined = dict(re.findall(r"#define SATO_(\w+) (\S+) ", header.read_text(encoding="utf-8")))
    return [int(defined[name]) for name in names]
