"""Plan of a comparison: names become solvers and families, and impossible requests are refused."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from problems.families import SIZES, Family, Instance, list_families, load_family
from problems.solvers.adapter import SolverAdapter

DEFAULT_TOLERANCES = (1e-4, 1e-6, 1e-8)
DEFAULT_SOLVER = "clarabel"  # the toolkit's own default for conic programs
MAX_PATIENCE = 86400.0  # ten times as long can still be waited for in 32 bits of milliseconds [s]


@dataclass(frozen=True, eq=False)
class ComparisonPlan:
    """Problems, solvers and settings of a comparison."""

    families: tuple[Family, ...]  # sizes of a name follow each other, the smallest first
    solvers: tuple[SolverAdapter, ...]
    tolerances: tuple[float, ...]  # the loosest first
    repeats: int
    patience: float = 1.0  # a solver that takes longer is given no larger size [s]
    exclusions: tuple[str, ...] = ()  # solvers that are left out, and why

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        if self.repeats < 1:
            raise ValueError(f"there must be at least one repeat, got {self.repeats}")
        for tolerance in self.tolerances:
            if not 0 < tolerance < 1:
                raise ValueError(f"a tolerance lies between 0 and 1, got {tolerance:g}")
        if not 0 < self.patience <= MAX_PATIENCE:
            raise ValueError(
                f"--patience takes a time above 0 s, at most a day, got {self.patience:g}"
            )
        if not self.solvers:
            raise ValueError("nothing to compare: there is no solver")

    @property
    def solve_count(self) -> int:
        """Number of requests to solvers, if none is skipped."""
        each = len(self.tolerances) * self.repeats
        return sum(
            each * len(f.instances) * len(capable_solvers(self.solvers, f)) for f in self.families
        )


def make_plan(
    known: Mapping[str, SolverAdapter],
    solvers: Iterable[str] = (),
    families: Iterable[str] = (),
    sizes: Iterable[str] = (),
    tolerances: Iterable[float] = (),
    repeats: int = 3,
    patience: float = 1.0,
) -> ComparisonPlan:
    """Make a plan from names; an empty list takes all that there are.

    Args:
        known: Adapters of solvers, installed or not.
        solvers: Names of solvers.
        families: Names of families.
        sizes: Sizes of the families.
        tolerances: Relative limits on residuals and gap.
        repeats: Number of solves from which each time is a median.
        patience: Time after which a solver is given no larger or tighter problem [s].

    Raises:
        ValueError: There is no such name, a solver that is named is not installed or supports
            none of the problems, or nothing is left.
    """
    solver_names = _validate_names("solver", solvers, known)
    available = list_families()
    family_names = _validate_names("family", families, available)
    size_names = _validate_names("size", sizes, SIZES)
    chosen = [
        load_family(name, size)
        for name in family_names or available
        for size in available[name]
        if not size_names or size in size_names
    ]
    if not available:
        raise ValueError("there are no families: the data files of problems/families are missing")
    if not chosen:
        raise ValueError(
            f"{', '.join(family_names)}: there is nothing of size {' or '.join(size_names)}"
        )
    candidates = [known[name] for name in solver_names or known]
    reasons = {solver.name: _exclusion_reason(solver, chosen, known) for solver in candidates}
    if solver_names:
        for solver in candidates:
            if reason := reasons[solver.name]:
                raise ValueError(reason)
            for family in chosen:
                if family_names and not capable_solvers([solver], family):
                    raise ValueError(_incapability_message(solver, family, known))
    return ComparisonPlan(
        tuple(chosen),
        tuple(solver for solver in candidates if not reasons[solver.name]),
        tuple(sorted(set(tolerances) or DEFAULT_TOLERANCES, reverse=True)),
        repeats,
        patience,
        tuple(filter(None, reasons.values())),
    )


def capable_solvers(solvers: Iterable[SolverAdapter], family: Family) -> tuple[SolverAdapter, ...]:
    """Return the solvers that support every instance of a family."""
    return tuple(
        solver
        for solver in solvers
        if all(solver.supports(instance.problem) for instance in family.instances)
    )


def next_with_same_matrix(family: Family) -> tuple[Instance | None, ...]:
    """Return for each instance the next, cyclically, that differs in b alone, or None."""
    instances = family.instances
    found: list[Instance | None] = []
    for i, instance in enumerate(instances):
        problem = instance.problem
        others = (
            other
            for other in (*instances[i + 1 :], *instances[:i])
            if other.problem.A is problem.A and other.problem.q is problem.q
        )
        found.append(next(others, None))
    return tuple(found)


def format_tolerance(tolerance: float) -> str:
    """Format a tolerance as it is usually written: 1e-4, 2.5e-6."""
    digits, _, exponent = f"{tolerance:e}".partition("e")
    return f"{float(digits):g}e{int(exponent)}"


def _exclusion_reason(
    solver: SolverAdapter, families: Sequence[Family], known: Mapping[str, SolverAdapter]
) -> str:
    if not solver.is_installed:
        return f"{solver.name} is not installed; pip install {solver.pip_packages} would do"
    if not any(capable_solvers([solver], family) for family in families):
        return _incapability_message(solver, families[0], known)
    return ""


def _incapability_message(
    solver: SolverAdapter, family: Family, known: Mapping[str, SolverAdapter]
) -> str:
    programs = [instance.problem for instance in family.instances]
    missing = sorted({cone for p in programs for cone in p.cone_types - solver.cone_types})
    if missing:
        reason = f"cannot take {' or '.join(missing)} cones, which {family.name} has"
    else:
        unsupported = next(filter(None, map(solver.unsupported_reason, programs)))
        reason = f"cannot take {family.name}: it {unsupported}"
    capable = ", ".join(other.name for other in capable_solvers(known.values(), family))
    return f"{solver.name} {reason}; {capable or 'no solver'} can"


def _validate_names(kind: str, names: Iterable[str], known: Iterable[str]) -> list[str]:
    # Returns each name once, in the order given.
    options, given = list(known), list(dict.fromkeys(names))
    for name in given:
        if name not in options:
            close = get_close_matches(name, options, n=1, cutoff=0.5)
            hint = f"did you mean {close[0]}? There" if close else "there"
            raise ValueError(f'there is no {kind} "{name}"; {hint} are {", ".join(options)}')
    return given
