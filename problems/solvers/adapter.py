"""Interface of the solver adapters, forms of a program that libraries take, and own solvers."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Annotated, Any, Protocol, cast, get_args, runtime_checkable

import numpy as np
from annotated_types import Ge, Gt, Lt
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from dynamics.callbacks import CallbackError, as_kind, as_shape, call, is_own, name_of
from dynamics.doors import checked
from dynamics.inputs import InputError
from problems.conic import (
    TOLERANCE,
    ConeType,
    ConicProgram,
    ConicSolution,
    SolverResult,
    Status,
    Unsolved,
    verify,
)

Vector = Float[Array, " m"]
LP: frozenset[ConeType] = frozenset({"linear"})
SOCP: frozenset[ConeType] = LP | {"second-order"}
SDP: frozenset[ConeType] = SOCP | {"semidefinite"}
RESULT = 'SolverResult("solved", message, x, y, iterations)'


@runtime_checkable
class SolverSession(Protocol):
    """Solver that is set up for one program."""

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side; the cost, A and the cones stay."""


def accept_all(problem: ConicProgram) -> str:
    """Accept every program with supported cones."""
    return ""


@checked
@dataclass(frozen=True)
class SolverAdapter:
    """Solver, and the way to call it.

    Args:
        name: Name in commands, tables and missions.
        cone_types: Cones that it supports.
        certifies_infeasibility: True where it reports infeasible programs with a certificate.
        session_factory: Function of a program and a relative tolerance that sets it up.
        module: Module that is imported; the name where empty.
        pip_packages: Packages that install it; the module where empty.
        unsupported_reason: Function of a program; returns "" where it is supported.
        takes_quadratic_cost: False for linear costs alone.
    """

    name: str
    cone_types: frozenset[ConeType]
    certifies_infeasibility: bool
    session_factory: Callable[[ConicProgram, float], SolverSession]
    module: str = ""
    pip_packages: str = ""
    unsupported_reason: Callable[[ConicProgram], str] = accept_all
    takes_quadratic_cost: bool = True

    def __post_init__(self) -> None:
        """Fill in the names that were left out, and check the answers of own sessions."""
        if is_own(self.session_factory):
            factory = partial(open_own_session, self.session_factory)
            object.__setattr__(self, "session_factory", factory)
        object.__setattr__(self, "module", self.module or self.name)
        object.__setattr__(self, "pip_packages", self.pip_packages or self.module)

    @property
    def is_installed(self) -> bool:
        """True where the solver's module can be imported."""
        try:
            return find_spec(self.module) is not None
        except ModuleNotFoundError:  # a parent package is missing
            return False

    def refusal(self, problem: ConicProgram) -> str:
        """Return why the solver cannot take a program; empty where it can."""
        if not self.is_installed:
            return f"{self.name} is not installed; pip install {self.pip_packages} would do"
        if missing := ", ".join(sorted(problem.cone_types - self.cone_types)):
            return f"{self.name} cannot take {missing} cones"
        if problem.P is not None and not self.takes_quadratic_cost:
            return f"{self.name} cannot take a quadratic cost"
        name, ask = f"{self.name}.unsupported_reason", self.unsupported_reason
        reason = call(name, ask, deepcopy(problem)) if is_own(ask) else ask(problem)
        return f"{self.name} {reason}" if reason else ""

    def open_session(
        self, problem: ConicProgram, tolerance: Annotated[float, Gt(0), Lt(1)]
    ) -> SolverSession:
        """Set the solver up for a program.

        Args:
            problem: The program; other right-hand sides may follow.
            tolerance: Of residuals and gap, relative, as `ConicSolution` defines them.

        Raises:
            ValueError: The solver is not installed, or does not support the program.
        """
        self.require(problem)
        session = self.session_factory(problem, tolerance)

        def solve(b: Vector) -> SolverResult:
            if np.shape(b) != problem.b.shape:
                wanted = f"must have {len(problem.b)} entries, as that of the program"
                raise InputError("b", f"{wanted}, got an array of shape {np.shape(b)}")
            return session.solve(np.asarray(b, dtype=float))

        return cast(SolverSession, SimpleNamespace(solve=solve))

    def require(self, problem: ConicProgram) -> None:
        """Refuse a program that the solver cannot take, or a solver that is not installed."""
        if reason := self.refusal(problem):
            from problems.solvers import list_able

            able = list_able(problem) if self.is_installed else ()
            raise ValueError(f"{reason}; {', '.join(able)} can" if able else reason)


def make_result(
    status: Status,
    message: str,
    iterations: int | None,
    x: Float[Array, " n"] | None,
    y: Float[Array, " m"] | None,
    ray: Float[Array, " m"] | None = None,
) -> SolverResult:
    """Make the result of a solve: a point and its duals, or the ray of an infeasible program.

    Arrays are copied, because libraries write to theirs again. A point that is not finite is
    left out. Of an infeasible program only the ray counts, which many libraries return as y.
    """
    if status == "infeasible":
        x, y = None, ray
    elif x is None or not np.isfinite(x).all():
        x = y = None
    x, y = (None if part is None else np.array(part) for part in (x, y))
    return SolverResult(status, message, x, y, iterations)


@checked
def lower_bounds(
    b: Vector, zero: Annotated[int, Ge(0)], infinity: float = np.inf
) -> Float[Array, " m"]:
    """Compute l of l ≤ A x ≤ b: equal to b for equations, which are first, else −∞."""
    if zero > len(b):
        raise InputError("zero", f"must be at most {len(b)}, got {zero}")
    return np.concatenate([b[:zero], np.full(len(b) - zero, -infinity)])


def split_rows(problem: ConicProgram) -> tuple[csc_matrix, csc_matrix, Array, Array]:
    """Split A and b into equations and the others, as matrices that older libraries accept."""
    A, b, zero = problem.A, problem.b, problem.zero
    return csc_matrix(A[:zero]), csc_matrix(A[zero:]), b[:zero], b[zero:]


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
    if not is_own(solver):
        return cast(ConicSolution, solver(program))
    name, passes = name_of(solver), (CallbackError, Unsolved)

    def check(answer: Any) -> SolverResult:
        as_kind(answer, ConicSolution | SolverResult, "a ConicSolution")
        x, y = as_shape(answer.x, program.q.shape), as_shape(answer.y, program.b.shape)
        return SolverResult("solved", name, x, y)

    result = call(name, solver, deepcopy(program), passes=passes, check=check)
    return verify(program, result, TOLERANCE).require(program)
