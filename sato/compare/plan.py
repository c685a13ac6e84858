"""Plan of a comparison: names become solvers and families, and impossible requests are refused."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from problems.families import SIZES, Family, list_families, load_family
from problems.solvers.adapter import SolverAdapter
from sato.scenario.errors import closest_name

DEFAULT_TOLERANCES, ALL_TOLERANCES = (1e-6,), (1e-4, 1e-6, 1e-8)
DEFAULT_SIZES = SIZES[:1]
DEFAULT_PATIENCE, ALL_PATIENCE = 0.15, 1.0  # [s]
ALL_TAKES = "--all asks all sizes at 1e-4, 1e-6 and 1e-8, in half an hour with --repeats 1"
MAX_PATIENCE = 86400.0  # ten times as long can still be waited for in 32 bits of milliseconds [s]


@dataclass(frozen=True, eq=False)
class ComparisonPlan:
    """Problems, solvers and settings of a comparison."""

    families: tuple[Family, ...]  # sizes of a name follow each other, the smallest first
    solvers: tuple[SolverAdapter, ...]
    tolerances: tuple[float, ...]  # the loosest first
    repeats: int  # number of solves from which each time is a median
    patience: float  # a solver that takes longer is given no larger or tighter problem [s]
    exclusions: tuple[str, ...] = ()  # solvers that are left out, and why

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        for tolerance in self.tolerances:
            if not 0 < tolerance < 1:
                raise ValueError(f"a tolerance lies between 0 and 1, got {tolerance:g}")
        if not 0 < self.patience <= MAX_PATIENCE:
            limits = "a time above 0 s, at most a day"
            raise ValueError(f"--patience takes {limits}, got {self.patience:g}")


def make_plan(
    known: Mapping[str, SolverAdapter],
    solvers: Collection[str] = (),
    families: Collection[str] = (),
    sizes: Collection[str] = (),
    tolerances: Collection[float] = (),
    repeats: int = 3,
    patience: float | None = None,
    takes_all: bool = False,
) -> ComparisonPlan:
    """Make a plan from names; an empty list takes all known solvers, installed or not, or families.

    Without any, the size is small, the relative tolerance of residuals and gap is 1e-6, and the
    patience is 0.15 s; all sizes, all tolerances and 1 s where the plan takes all. Refuse unknown
    names, and solvers that are named and not installed, or support none of the problems.
    """
    available = list_families()
    _check_names("solver", solvers, known)
    _check_names("family", families, available)
    _check_names("size", sizes, SIZES)
    wanted = sizes or (SIZES if takes_all else DEFAULT_SIZES)
    names = dict.fromkeys(families) or available
    chosen = [load_family(name, size) for name in names for size in SIZES if size in wanted]
    able, exclusions = [], []
    for name in dict.fromkeys(solvers) or known:
        reasons = [refusal(known[name], family) for family in chosen]
        if not all(reasons):
            able.append(known[name])
        elif not solvers:
            exclusions.append(reasons[0])
        else:
            others = [other for other in known if not refusal(known[other], chosen[0])]
            raise ValueError(f"{reasons[0]}; {', '.join(others)} can take {chosen[0].name}")
    usual = ALL_TOLERANCES if takes_all else DEFAULT_TOLERANCES
    limits = sorted(set(tolerances) or usual, reverse=True)
    problems, left_out = tuple(chosen), tuple(exclusions)
    if patience is None:
        patience = ALL_PATIENCE if takes_all else DEFAULT_PATIENCE
    return ComparisonPlan(problems, tuple(able), tuple(limits), repeats, patience, left_out)


def refusal(solver: SolverAdapter, family: Family) -> str:
    """Return why a solver cannot take all of a family; empty where it can."""
    reasons = (solver.refusal(instance.problem) for instance in family.instances)
    return next(filter(None, reasons), "")


def format_tolerance(tolerance: float) -> str:
    """Format a tolerance as it is usually written: 1e-4, 2.5e-6."""
    return np.format_float_scientific(tolerance, precision=6, trim="-", exp_digits=1)


def _check_names(kind: str, names: Collection[str], known: Collection[str]) -> None:
    for name in names:
        if name not in known:
            close = closest_name(name, known)
            hint = f"did you mean {close}? There" if close else "there"
            raise ValueError(f'there is no {kind} "{name}"; {hint} are {", ".join(known)}')
