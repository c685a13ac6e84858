"""Sessions of a user's own solver: they get copies, and their results are checked."""

from copy import deepcopy
from typing import Any, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import CallbackError, as_kind, as_shape, call, is_own
from dynamics.inputs import InputError
from problems.conic import (
    TOLERANCE,
    ConicProgram,
    ConicSolution,
    SolverResult,
    Status,
    Unsolved,
)

RESULT = 'SolverResult("solved", message, x, y, iterations)'


class OwnSession:
    """Session of a user's own solver, with a program that nobody else has.

    Raises:
        CallbackError: It raised an exception, or returned what is no result of this program.
    """

    def __init__(self, factory: Any, program: ConicProgram, tolerance: float) -> None:
        name = getattr(factory, "__qualname__", type(factory).__name__)
        session = call(name, factory, deepcopy(program), tolerance)
        self._sizes = len(program.q), len(program.b)
        self._name, self._solve = (
            f"{type(session).__name__}.solve",
            call(name, getattr, session, "solve"),
        )

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        found: SolverResult = call(self._name, self._solve, b, check=self._check)
        return found

    def _check(self, found: Any) -> SolverResult:
        said, message, *numbers = (*as_kind(found, tuple, RESULT), None, None, None, None, None)[:5]
        status: Status | None = next((s for s in get_args(Status) if str(said) == s), None)
        if status is None or len(found) > 5:
            raise InputError("", f"must be {RESULT}, or begin with one of {get_args(Status)}")
        sized = zip(numbers, self._sizes, strict=False)
        x, y = (None if part is None else as_shape(part, (size,)) for part, size in sized)
        count = as_kind(numbers[2], int | float | np.number | None, f"{RESULT}, of a whole number")
        return SolverResult(status, str(message), x, y, None if count is None else int(count))


def ask(solver: Any, program: ConicProgram) -> ConicSolution:
    """Solve by a function of a program; verify the answer of one of the user's own.

    Raises:
        Unsolved: There is no answer, or it fails verification.
        CallbackError: A function of the user's own raised, or returned no answer.
    """

    def check(found: Any) -> ConicSolution:
        as_kind(found, ConicSolution | SolverResult, "a ConicSolution")
        x, y = as_shape(found.x, program.q.shape), as_shape(found.y, program.b.shape)
        return ConicSolution.evaluate(program, x, y)

    if not is_own(solver):
        solution: ConicSolution = solver(program)
        return solution
    name, passes = getattr(solver, "__qualname__", type(solver).__name__), (CallbackError, Unsolved)
    solution = call(name, solver, deepcopy(program), passes=passes, check=check)
    if not solution.max_residual <= TOLERANCE:
        reason = (
            f"{name}: residuals or the gap are {solution.max_residual:.1e}, above {TOLERANCE:.0e}"
        )
        raise Unsolved(program, reason)
    return solution
