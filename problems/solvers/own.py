"""Sessions of a user's own solver: they get copies, and their results are checked."""

from copy import deepcopy
from typing import Any, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import CallbackError, as_kind, as_shape, call, is_own, name_of
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
        session = call(name_of(factory), factory, deepcopy(program), tolerance)
        self._name, self._sizes = f"{type(session).__name__}.solve", program.A.shape[::-1]
        self._solve = call(name_of(factory), getattr, session, "solve")

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        result: SolverResult = call(self._name, self._solve, b, check=self._check)
        return result

    def _check(self, result: Any) -> SolverResult:
        status, message, *points, iterations = as_kind(result, SolverResult, RESULT)
        if status not in get_args(Status):
            raise InputError("", f"must be {RESULT}, or begin with one of {get_args(Status)}")
        sized = zip(points, self._sizes, strict=True)
        x, y = (None if part is None else as_shape(part, (size,)) for part, size in sized)
        as_kind(iterations, int | float | np.number | None, f"{RESULT}, of a whole number")
        return SolverResult(status, str(message), x, y, iterations and int(iterations))


def ask(solver: Any, program: ConicProgram) -> ConicSolution:
    """Solve by a function of a program; verify the answer of one of the user's own.

    Raises:
        Unsolved: There is no answer, or it fails verification.
        CallbackError: A function of the user's own raised, or returned no answer.
    """

    def check(answer: Any) -> ConicSolution:
        as_kind(answer, ConicSolution | SolverResult, "a ConicSolution")
        x, y = as_shape(answer.x, program.q.shape), as_shape(answer.y, program.b.shape)
        return ConicSolution.evaluate(program, x, y)

    solution: ConicSolution
    if not is_own(solver):
        solution = solver(program)
        return solution
    name, passes = name_of(solver), (CallbackError, Unsolved)
    solution = call(name, solver, deepcopy(program), passes=passes, check=check)
    worst = solution.max_residual
    if not worst <= TOLERANCE:
        reason = f"residuals or the gap are {worst:.1e}, above {TOLERANCE:.0e}"
        raise Unsolved(program, f"{name}: {reason}")
    return solution
