"""Adapters of conic solvers, one short file each; results are verified by `problems.conic`.

A new solver is one more file here, with its `SolverAdapter` in a tuple `ADAPTERS`.
"""

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter
from problems.solvers.clarabel import solve_clarabel
from problems.solvers.highs import solve_highs

__all__ = [
    "DEFAULT_SOLVER",
    "SolverAdapter",
    "list_able",
    "load_adapters",
    "solve_clarabel",
    "solve_highs",
]

DEFAULT_SOLVER = "clarabel"  # of conic programs


@cache
def load_adapters() -> dict[str, SolverAdapter]:
    """Load the adapters of all solvers, installed or not, by name."""
    found: dict[str, SolverAdapter] = {}
    for file in sorted(module.name for module in iter_modules(__path__)):
        for adapter in getattr(import_module(f"{__name__}.{file}"), "ADAPTERS", ()):
            found[adapter.name] = adapter
    return found


def list_able(problem: ConicProgram) -> list[str]:
    """List the names of the installed solvers that can take a program."""
    return [name for name, each in load_adapters().items() if not each.refusal(problem)]
