"""What every solver is asked in the same words, and how it is taken at its word or not."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal, NamedTuple, Protocol, runtime_checkable

from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import Answer, Cone, Conic, Infeasible, Unsolved, proof

Said = Literal["solved", "infeasible", "stopped"]
Kind = Literal["solved", "infeasible", "wrong claim", "unproven", "failed"]


class Claim(NamedTuple):
    """What a solver says, before anything is recomputed."""

    said: Said
    words: str  # its own
    x: Float[Array, " n"] | None = None  # a point; also where it stopped with one
    y: Float[Array, " m"] | None = None  # its duals, or the ray that proves that there is none
    iterations: int | None = None
    # In the library's own calls: what hands over b, solves, and reads out the point and its duals.
    # What is done with arrays before and after is the adapter's [s].
    seconds: float = 0.0


@runtime_checkable
class Session(Protocol):
    """A solver that has read a problem."""

    def solve(self, b: Float[Array, " m"]) -> Claim:
        """Solve with another right-hand side, the rest being as it was read."""


def nothing(problem: Conic) -> str:
    """What most refuse of the problems whose cones they know."""
    return ""


@dataclass(frozen=True)
class Adapter:
    """A solver, and how to ask it."""

    name: str
    cones: frozenset[Cone]  # what it can take
    proves: bool  # whether it claims to find out that there is no point
    module: str  # without which it cannot be asked
    pip: str  # what installs that
    begin: Callable[[Conic, float], Session]  # with the tolerance that is asked of the answer
    refuses: Callable[[Conic], str] = nothing  # why it cannot take a problem of its cones, or ""

    @property
    def installed(self) -> bool:
        """Whether it can be asked here."""
        try:
            return find_spec(self.module) is not None
        except ModuleNotFoundError:  # nor is what it would be a part of
            return False

    def takes(self, problem: Conic) -> bool:
        """Whether it knows all cones of a problem, and its form."""
        return problem.kinds <= self.cones and not self.refuses(problem)

    def read(self, problem: Conic, tolerance: float) -> Session:
        """Begin with a problem.

        Args:
            problem: What is asked.
            tolerance: Of residuals and gap, relative, as `Answer` has them.

        Raises:
            ValueError: It is not installed, or does not know a cone of the problem or its form.
        """
        if not self.installed:
            raise ValueError(f"{self.name} is not installed; pip install {self.pip} would do")
        if missing := ", ".join(sorted(problem.kinds - self.cones)):
            raise ValueError(f"{self.name} cannot take {missing} cones")
        if why := self.refuses(problem):
            raise ValueError(f"{self.name} {why}")
        return self.begin(problem, tolerance)


class Verdict(NamedTuple):
    """What is left of a claim."""

    kind: Kind
    answer: Answer | None  # where there is a point with duals
    why: str


def judge(problem: Conic, claim: Claim, tolerance: float) -> Verdict:
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
    if claim.said == "infeasible":
        if claim.y is None:
            return Verdict("unproven", None, claim.words)
        _, doubt = proof(problem, claim.y)
        return Verdict("wrong claim" if doubt else "infeasible", None, doubt or claim.words)
    if claim.x is None or claim.y is None:
        kind: Kind = "wrong claim" if claim.said == "solved" else "failed"
        return Verdict(kind, None, f"{claim.words}, without a point or its duals")
    answer = Answer.of(problem, claim.x, claim.y)
    if answer.worst <= tolerance:
        return Verdict("solved", answer, claim.words)
    kind = "wrong claim" if claim.said == "solved" else "failed"
    return Verdict(kind, answer, f"{claim.words}, off by {answer.worst:.1e}")


def answered(problem: Conic, claim: Claim, name: str) -> Answer:
    """The point of a claim, for `problems.conic.solve` to judge.

    Raises:
        Infeasible: The solver claims that there is none.
        Unsolved: It stopped without one.
    """
    if claim.said == "infeasible":
        raise Infeasible(problem, f"{name}: {claim.words}", claim.y)
    if claim.x is None or claim.y is None:
        raise Unsolved(problem, f"{name} stopped: {claim.words}")
    return Answer.of(problem, claim.x, claim.y)
