"""Solver of the user's choice, its answers verified, with the default solver behind it."""

import warnings
from collections.abc import Callable
from copy import deepcopy
from typing import Any, get_args

import numpy as np

from dynamics.callbacks import CallbackError, as_shape, call, check_result, is_own, is_strict
from dynamics.inputs import InputError
from problems.conic import (
    TOLERANCE,
    ConicProgram,
    ConicSolution,
    Infeasible,
    SolverResult,
    Status,
    Unsolved,
    Verification,
    verify,
    verify_ray,
)
from problems.phase_one import read_ray, relax_cones
from problems.solvers import DEFAULT_SOLVER, SolverAdapter, load_adapters, solve_clarabel
from problems.solvers.adapter import SolverSession
from problems.solvers.clarabel import ADAPTERS

ASKED = 1e-2  # of the tolerance: many solvers scale residuals by larger numbers


class VerifiedSolver:
    """Solver chosen by name; programs on which it fails are given to the default solver.

    A session stays open while programs differ in b alone, so that solvers that start from the
    last answer do so: their answers depend on the programs before, within the tolerance. Whoever
    decides alone has a solver of its own.
    """

    def __init__(
        self,
        name: str = DEFAULT_SOLVER,
        tolerance: float = TOLERANCE,
        told: list[str] | None = None,
    ) -> None:
        """Choose a solver, and the tolerance of its answers: residuals and gap, relative.

        Solvers that share a list of what was told warn of the first failure of all alone.
        """
        self._told = [] if told is None else told
        self._name, self._tolerance = name, tolerance
        self._last: tuple[ConicProgram, SolverSession] | None = None
        self.fallback_count = 0  # programs that were given to the default solver
        self.last_rejection = ""  # reason of the last of them
        self.error_count = 0  # programs on which a solver of the user's own failed
        self.last_error = ""  # its last failure

    def __call__(self, problem: ConicProgram) -> ConicSolution:
        """Solve a program.

        Raises:
            Infeasible: No point satisfies every constraint, with a verified certificate.
            Unsolved: The default solver stopped, or its answer fails verification.
            ValueError: The solver is not installed, or cannot take the program.
        """
        found = self.answer(problem)
        if found.kind not in ("solved", "infeasible") and not self.is_default:
            self.count_fallback(f"{self._name}: {found.reason}")
            found = VerifiedSolver().answer(problem)
            both = f"{self.last_rejection}; {DEFAULT_SOLVER}: {found.reason}"
            found = found._replace(reason=both)
        if found.kind == "infeasible":
            raise Infeasible(problem, found.reason, found.ray)
        if found.solution is None or found.kind != "solved":
            raise Unsolved(problem, found.reason)
        return found.solution

    def count_fallback(self, reason: str) -> None:
        """Count a program that is given to the default solver, and keep the reason."""
        self.fallback_count += 1
        self.last_rejection = reason

    def __getstate__(self) -> dict[str, object]:
        """Leave out the session, which few libraries can copy."""
        return self.__dict__ | {"_last": None}

    @property
    def is_default(self) -> bool:
        """True where neither a solver nor a tolerance was chosen."""
        return (self._name, self._tolerance) == (DEFAULT_SOLVER, TOLERANCE)

    def answer(self, problem: ConicProgram) -> Verification:
        """Ask the chosen solver alone, and verify its answer.

        Where the solver calls a program infeasible without a certificate, or never gives one, it
        is asked for the least violation too, whose duals are one; the default solver wherever it
        fails. An exception of a library is a failure, with the message as its reason; that of a
        solver of the user's own is counted too, and the first is warned of.

        Raises:
            ValueError: The solver is not installed, or cannot take the program.
        """
        adapter = ADAPTERS[0] if self._name == DEFAULT_SOLVER else load_adapters()[self._name]
        is_open = self._last is not None and problem.differs_in_b_only(self._last[0])
        if not (is_open or self.is_default):
            self._last = None
            adapter.require(problem)
        errors = self.error_count
        result = self._ask(lambda: self._solve(adapter, problem))
        found = verify(problem, result, self._tolerance)
        if found.kind in ("solved", "infeasible"):
            return found
        self._last = None  # no start for the next
        if self.error_count > errors:
            return found
        if found.kind == "unproven" or self.is_default or not adapter.certifies_infeasibility:
            return self._certify(adapter, problem, found)
        return found

    def _solve(self, adapter: SolverAdapter, problem: ConicProgram) -> SolverResult:
        if self.is_default:
            return solve_clarabel(problem)
        if self._last is None:
            self._last = problem, _open(adapter, problem, ASKED * self._tolerance)
        return _solve_by(adapter, self._last[1], problem)

    def _ask(self, solve: Callable[[], SolverResult]) -> SolverResult:
        """Return the result of a solve; an exception of the library is its message."""
        try:
            return solve()
        except MemoryError:
            raise
        except CallbackError as error:
            if is_strict():
                raise
            if not self._told:
                self._told.append(str(error))
                text = "the default solver answers in its place, and failures are counted"
                warnings.warn(f"{error}; {text}", stacklevel=2)
            self.error_count += 1
            self.last_error = str(error)
            return SolverResult("stopped", str(error))
        except Exception as error:  # libraries raise what they like
            return SolverResult("stopped", f"{type(error).__name__}: {error}")

    def _certify(
        self, adapter: SolverAdapter, problem: ConicProgram, found: Verification
    ) -> Verification:
        """Replace a verdict where the duals of the least violation certify infeasibility."""
        relaxed = relax_cones(problem)
        if adapter.refusal(relaxed):
            return found
        tolerance = ASKED * TOLERANCE
        result = self._ask(lambda: _solve_by(adapter, _open(adapter, relaxed, tolerance), relaxed))
        if result.y is None:
            return found
        ray, objection = verify_ray(problem, read_ray(problem, result.y))
        if objection:
            return found._replace(reason=f"{found.reason}; of the least violation, {objection}")
        return Verification("infeasible", None, "by the duals of the least violation", ray)


def _open(adapter: SolverAdapter, problem: ConicProgram, tolerance: float) -> Any:
    """Open a session; one of the user's own gets a program that nobody else has."""
    factory = adapter.session_factory
    if not is_own(factory):
        return factory(problem, tolerance)
    name = getattr(factory, "__qualname__", adapter.name)
    session = call(name, factory, deepcopy(problem), tolerance)
    if not callable(getattr(session, "solve", None)):
        got = type(session).__name__
        raise CallbackError("", f"{name}: a session needs a method solve(b), got {got}")
    return session


def _solve_by(adapter: SolverAdapter, session: Any, problem: ConicProgram) -> SolverResult:
    if not is_own(adapter.session_factory):
        result: SolverResult = session.solve(problem.b)
        return result
    name = f"{type(session).__name__}.solve"
    found = call(name, session.solve, problem.b)
    answer: SolverResult = check_result(name, _check_answer, found, problem)
    return answer


def _check_answer(found: Any, problem: ConicProgram) -> SolverResult:
    """Convert what a solver of the user's own returns.

    Raises:
        InputError: It is no result of this program.
    """
    would_do = 'SolverResult("solved", message, x, y, iterations) would do'
    if not isinstance(found, tuple) or not 2 <= len(found) <= len(SolverResult._fields):
        raise InputError("", f"must be a SolverResult, got {type(found).__name__}; {would_do}")
    said, message, *numbers = found
    status: Status | None = next(
        (s for s in get_args(Status) if isinstance(said, str) and s == said), None
    )
    if status is None:
        raise InputError("", f"must have one of the states {get_args(Status)}, got {said!r}")
    arrays = []
    for part, size in zip(numbers, (len(problem.q), len(problem.b)), strict=False):
        arrays.append(None if part is None else as_shape(part, (size,)))
    count = numbers[2] if len(numbers) > 2 else None
    if not (count is None or isinstance(count, int | float | np.number)):
        raise InputError("", f"must have a number of iterations or None, got {count!r}; {would_do}")
    x, y = (*arrays, None, None)[:2]
    return SolverResult(status, str(message), x, y, None if count is None else int(count))


solve_program = VerifiedSolver()
