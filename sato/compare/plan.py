"""Who is asked what: names become solvers and families, and what cannot be is refused."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite

from problems.families import SIZES, Family, Instance, list_families, load_family
from problems.solvers.adapter import SolverAdapter

DEFAULT_TOLERANCES = (1e-4, 1e-6, 1e-8)
DEFAULT_SOLVER = "clarabel"  # what the toolkit itself asks where there are cones


@dataclass(frozen=True, eq=False)
class ComparisonPlan:
    """A comparison before it begins."""

    families: tuple[Family, ...]  # those of a name follow each other, the smallest first
    solvers: tuple[SolverAdapter, ...]
    tolerances: tuple[float, ...]  # the loosest first
    repeats: int
    excluded: tuple[str, ...] = ()  # who is not asked, and why

    def __post_init__(self) -> None:
        """Refuse a comparison that would compare nothing."""
        if self.repeats < 1:
            raise ValueError(f"there must be at least one repeat, got {self.repeats}")
        for tolerance in self.tolerances:
            if not (isfinite(tolerance) and 0 < tolerance < 1):
                raise ValueError(f"a tolerance lies between 0 and 1, got {tolerance:g}")
        if list(self.tolerances) != sorted(set(self.tolerances), reverse=True):
            raise ValueError(f"tolerances come once, the loosest first, got {self.tolerances}")
        for what, some in (
            ("tolerance", self.tolerances),
            ("family", self.families),
            ("solver", self.solvers),
        ):
            if not some:
                raise ValueError(f"nothing to compare: there is no {what}")

    def capable_solvers(self, questions: Family) -> tuple[SolverAdapter, ...]:
        """Who can be asked about a family."""
        return capable_solvers(self.solvers, questions)

    @property
    def solve_count(self) -> int:
        """How often a solver will be asked, if none is given up."""
        each = len(self.tolerances) * self.repeats
        return sum(each * len(f.instances) * len(self.capable_solvers(f)) for f in self.families)


def make_plan(
    known: Mapping[str, SolverAdapter],
    solvers: Iterable[str] = (),
    names: Iterable[str] = (),
    sizes: Iterable[str] = (),
    tolerances: Iterable[float] = (),
    repeats: int = 3,
) -> ComparisonPlan:
    """Turn what is asked for into what will be done; nothing said means all there is.

    Args:
        known: The solvers that there are adapters for, installed or not.
        solvers: Their names.
        names: Of families.
        sizes: Of families.
        tolerances: That residuals and gap must keep, relative.
        repeats: Of each measurement.

    Raises:
        ValueError: There is no such name, a solver that is asked for by its name is not installed
            or can take none of what it is asked, or nothing is left.
    """
    asked = _validate_names("solver", solvers, known)
    there = list_families()
    chosen = _validate_names("family", names, there)
    lengths = _validate_names("size", sizes, SIZES)
    questions = [
        load_family(name, size)
        for name in chosen or there
        for size in there[name]
        if not lengths or size in lengths
    ]
    if not there:
        raise ValueError("there are no families: the data files of problems/families are missing")
    if not questions:
        raise ValueError(f"{', '.join(chosen)}: there is nothing of size {' or '.join(lengths)}")
    left_out = []
    able_to = []
    for solver in (known[name] for name in asked or known):
        why = _exclusion_reason(solver, questions, known)
        if why and asked:
            raise ValueError(why)
        left_out += [why] if why else []
        able_to += [] if why else [solver]
    if asked and chosen:
        for solver in able_to:
            for each in questions:
                if not capable_solvers([solver], each):
                    raise ValueError(_incapability_message(solver, each, known))
    limits = tuple(sorted(set(tolerances) or DEFAULT_TOLERANCES, reverse=True))
    return ComparisonPlan(tuple(questions), tuple(able_to), limits, repeats, tuple(left_out))


def capable_solvers(
    solvers: Iterable[SolverAdapter], questions: Family
) -> tuple[SolverAdapter, ...]:
    """Who can take every instance of a family."""
    return tuple(
        solver
        for solver in solvers
        if all(solver.supports(instance.problem) for instance in questions.instances)
    )


def next_with_same_matrix(questions: Family) -> tuple[Instance | None, ...]:
    """For each instance the next that differs from it in b alone, in a ring; or none."""
    some = questions.instances
    found: list[Instance | None] = []
    for i, one in enumerate(some):
        others = [
            other
            for other in (*some[i + 1 :], *some[:i])
            if other.problem.A is one.problem.A and other.problem.q is one.problem.q
        ]
        found.append(others[0] if others else None)
    return tuple(found)


def format_tolerance(tolerance: float) -> str:
    """A tolerance as it is mostly written: 1e-4, 2.5e-6."""
    digits, _, exponent = f"{tolerance:e}".partition("e")
    return f"{float(digits):g}e{int(exponent)}"


def _exclusion_reason(
    solver: SolverAdapter, questions: Sequence[Family], known: Mapping[str, SolverAdapter]
) -> str:
    if not solver.is_installed:
        return f"{solver.name} is not installed; pip install {solver.pip_packages} would do"
    if not any(capable_solvers([solver], each) for each in questions):
        return _incapability_message(solver, questions[0], known)
    return ""


def _incapability_message(
    solver: SolverAdapter, questions: Family, known: Mapping[str, SolverAdapter]
) -> str:
    some = [instance.problem for instance in questions.instances]
    missing = " or ".join(
        sorted({cone for problem in some for cone in problem.cone_types - solver.cone_types})
    )
    why = f"cannot take {missing} cones, which {questions.name} has"
    if not missing:
        why = f"cannot take {questions.name}: it {next(filter(None, map(solver.unsupported_reason, some)))}"
    can = ", ".join(other.name for other in capable_solvers(known.values(), questions)) or "nobody"
    return f"{solver.name} {why}; {can} can"


def _validate_names(what: str, names: Iterable[str], known: Iterable[str]) -> list[str]:
    # Each once, in the order in which they were asked for.
    there, asked = list(known), list(dict.fromkeys(names))
    for name in asked:
        if name not in there:
            close = get_close_matches(name, there, n=1, cutoff=0.5)
            hint = f"did you mean {close[0]}? There" if close else "there"
            raise ValueError(f'there is no {what} "{name}"; {hint} are {", ".join(there)}')
    return asked
