"""What every solver is asked in the same words, and how it is taken at its word or not."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConeType, ConicProgram, ConicSolution, Infeasible, Unsolved, verify_ray

Status = Literal["solved", "infeasible", "stopped"]
Verified = Literal["solved", "infeasible", "wrong claim", "unproven", "failed"]


class SolverResult(NamedTuple):
    """What a solver says, before anything is recomputed."""

    status: Status
    message: str  # its own
    x: Float[Array, " n"] | None = None  # a point; also where it stopped with one
    y: Float[Array, " m"] | None = None  # its duals, or the ray that proves that there is none
    iterations: int | None = None
    # In the library's own calls: what hands over b, solves, and reads out the point and its duals.
    # What is done with arrays before and after is the adapter's [s].
    seconds: float = 0.0


@runtime_checkable
class SolverSession(Protocol):
    """A solver that has read a problem."""

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, the rest being as it was read."""


def accept_all(problem: ConicProgram) -> str:
    """What most refuse of the problems whose cones they know."""
    return ""


@dataclass(frozen=True)
class SolverAdapter:
    """A solver, and how to ask it."""

    name: str
    cone_types: frozenset[ConeType]  # what it can take
    certifies_infeasibility: bool  # whether it claims to find out that there is no point
    module: str  # without which it cannot be asked
    pip_packages: str  # what installs that
    session_factory: Callable[
        [ConicProgram, float], SolverSession
    ]  # with the tolerance that is asked of the answer
    unsupported_reason: Callable[[ConicProgram], str] = (
        accept_all  # why it cannot take a problem of its cones, or ""
    )

    @property
    def is_installed(self) -> bool:
        """Whether it can be asked here."""
        try:
            return find_spec(self.module) is not None
        except ModuleNotFoundError:  # nor is what it would be a part of
            return False

    def supports(self, problem: ConicProgram) -> bool:
        """Whether it knows all cones of a problem, and its form."""
        return problem.cone_types <= self.cone_types and not self.unsupported_reason(problem)

    def open_session(self, problem: ConicProgram, tolerance: float) -> SolverSession:
        """Begin with a problem.

        Args:
            problem: What is asked.
            tolerance: Of residuals and gap, relative, as `Answer` has them.

        Raises:
            ValueError: It is not installed, or does not know a cone of the problem or its form.
        """
        if not self.is_installed:
            raise ValueError(
                f"{self.name} is not installed; pip install {self.pip_packages} would do"
            )
        if missing := ", ".join(sorted(problem.cone_types - self.cone_types)):
            raise ValueError(f"{self.name} cannot take {missing} cones")
        if why := self.unsupported_reason(problem):
            raise ValueError(f"{self.name} {why}")
        return self.session_factory(problem, tolerance)


class Verification(NamedTuple):
    """What is left of a claim."""

    kind: Verified
    solution: ConicSolution | None  # where there is a point with duals
    reason: str


def verify(problem: ConicProgram, claim: SolverResult, tolerance: float) -> Verification:
    """Recompute what a solver claims.

    *solved* is a point that has residuals and gap within the tolerance, even of a solver that
    stopped; *infeasible* is what comes with a ray that proves it, as `problems.conic.proof` says.
    A solver that says solved, and it is not, or infeasible with a ray that proves nothing, has
    made a *wrong claim*; one that says infeasible and gives no ray leaves it *unproven*; and any
    other has *failed*.

    Args:
        problem: What was asked.
        claim: What the solver says.
        tolerance: Of residuals and gap, relative.
    """
    if claim.status == "infeasible":
        if claim.y is None:
            return Verification("unproven", None, claim.message)
        _, doubt = verify_ray(problem, claim.y)
        return Verification("wrong claim" if doubt else "infeasible", None, doubt or claim.message)
    if claim.x is None or claim.y is None:
        kind: Verified = "wrong claim" if claim.status == "solved" else "failed"
        return Verification(kind, None, f"{claim.message}, without a point or its duals")
    answer = ConicSolution.evaluate(problem, claim.x, claim.y)
    if answer.max_residual <= tolerance:
        return Verification("solved", answer, claim.message)
    kind = "wrong claim" if claim.status == "solved" else "failed"
    return Verification(kind, answer, f"{claim.message}, off by {answer.max_residual:.1e}")


def to_solution(problem: ConicProgram, claim: SolverResult, name: str) -> ConicSolution:
    """The point of a claim, for `problems.conic.solve` to judge.

    Raises:
        Infeasible: The solver claims that there is none.
        Unsolved: It stopped without one.
    """
    if claim.status == "infeasible":
        raise Infeasible(problem, f"{name}: {claim.message}", claim.y)
    if claim.x is None or claim.y is None:
        raise Unsolved(problem, f"{name} stopped: {claim.message}")
    return ConicSolution.evaluate(problem, claim.x, claim.y)
