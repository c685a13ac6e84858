"""Solvers of the user's own: they get copies, and their results are checked."""

from copy import deepcopy
from functools import partial
from types import SimpleNamespace
from typing import Any, cast, get_args

import numpy as np

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


def open_own_session(factory: Any, program: ConicProgram, tolerance: float) -> Any:
    """Open a session of a user's own solver, with a program that nobody else has.

    Raises:
        CallbackError: It raised an exception; `solve` of the session raises one as well, and
            where the result is none of this program.
    """
    session = call(name_of(factory), factory, deepcopy(program), tolerance)
    solve = call(name_of(factory), getattr, session, "solve")
    name, check = f"{type(session).__name__}.solve", partial(_as_result, program.A.shape[::-1])
    return SimpleNamespace(solve=partial(call, name, solve, check=check))


def _as_result(sizes: tuple[int, ...], result: Any) -> SolverResult:
    status, message, *points, iterations = as_kind(result, SolverResult, RESULT)
    if status not in get_args(Status):
        raise InputError("", f"must be {RESULT}, or begin with one of {get_args(Status)}")
    sized = zip(points, sizes, strict=True)
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

    if not is_own(solver):
        return cast(ConicSolution, solver(program))
    name, passes = name_of(solver), (CallbackError, Unsolved)
    solution: ConicSolution = call(name, solver, deepcopy(program), passes=passes, check=check)
    worst = solution.max_residual
    if not worst <= TOLERANCE:
        reason = f"residuals or the gap are {worst:.1e}, above {TOLERANCE:.0e}"
        raise Unsolved(program, f"{name}: {reason}")
    return solution
