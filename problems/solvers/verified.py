"""Solver of the user's choice, its answers verified, with the default solver behind it."""

import warnings
from collections.abc import Callable
from typing import Annotated

from annotated_types import Gt

from dynamics.callbacks import CallbackError, is_strict
from dynamics.doors import checked
from dynamics.inputs import InputError, format_value, join_names
from problems.conic import (
    TOLERANCE,
    ConicProgram,
    ConicSolution,
    SolverResult,
    Verification,
    verify,
    verify_ray,
)
from problems.phase_one import read_ray, relax_cones
from problems.solvers import DEFAULT_SOLVER, SolverAdapter, load_adapters, solve_clarabel
from problems.solvers.adapter import SolverSession
from problems.solvers.clarabel import ADAPTERS

ASKED = 1e-2  # of the tolerance: many solvers scale residuals by larger numbers


@checked
class VerifiedSolver:
    """Solver chosen by name; programs on which it fails are given to the default solver.

    A session stays open while programs differ in b alone, so that solvers that start from the
    last answer do so: their answers depend on the programs before, within the tolerance. Whoever
    decides alone has a solver of its own.
    """

    def __init__(
        self,
        name: str = DEFAULT_SOLVER,
        tolerance: Annotated[float, Gt(0)] = TOLERANCE,
        errors: list[str] | None = None,
    ) -> None:
        """Choose a solver, and the tolerance of its answers: residuals and gap, relative.

        Of solvers that share a list of errors, the first error of all is warned of.
        """
        if name != DEFAULT_SOLVER and name not in (known := load_adapters()):
            raise InputError("name", f"must be {join_names(known)}, got {format_value(name)}")
        self._errors = [] if errors is None else errors  # of solvers of the user's own
        self._name, self._tolerance = name, tolerance
        self._last: tuple[ConicProgram, SolverSession] | None = None
        self.fallback_count = 0  # programs that were given to the default solver
        self.last_rejection = ""  # reason of the last of them
        self.error_count = 0  # those on which a solver of the user's own failed itself

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
        return found.require(problem)

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
        fails. An exception of a library is a failure, with the message as its reason; so is that
        of a solver of the user's own, which is counted too.
        """
        adapter = ADAPTERS[0] if self._name == DEFAULT_SOLVER else load_adapters()[self._name]
        is_open = self._last is not None and problem.differs_in_b_only(self._last[0])
        if not (is_open or self.is_default):
            self._last = None
            adapter.require(problem)
        errors, result = self.error_count, self._ask(lambda: self._solve(adapter, problem))
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
            self._last = problem, adapter.session_factory(problem, ASKED * self._tolerance)
        return self._last[1].solve(problem.b)

    def _ask(self, solve: Callable[[], SolverResult]) -> SolverResult:
        """Return the result of a solve; an exception of the library is its message."""
        try:
            return solve()
        except MemoryError:
            raise
        except CallbackError as error:
            if is_strict.get():
                raise
            if not self._errors:
                text = "the default solver answers in its place, and failures are counted"
                warnings.warn(f"{error}; {text}", stacklevel=2)
            self._errors.append(str(error))
            self.error_count += 1
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
        factory = adapter.session_factory
        result = self._ask(lambda: factory(relaxed, ASKED * TOLERANCE).solve(relaxed.b))
        if result.y is None:
            return found
        ray, objection = verify_ray(problem, read_ray(problem, result.y))
        if objection:
            return found._replace(reason=f"{found.reason}; of the least violation, {objection}")
        return Verification("infeasible", None, "by the duals of the least violation", ray)


solve_program = VerifiedSolver()
