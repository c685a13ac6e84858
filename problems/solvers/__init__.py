"""One short adapter a file: standard form in, a claim out, and nothing is believed.

A new solver is one more file here, with its `Adapter` in a tuple `ADAPTERS`.
"""

from importlib import import_module
from pkgutil import iter_modules

from problems.solvers.adapter import SolverAdapter
from problems.solvers.clarabel import solve_clarabel
from problems.solvers.highs import solve_highs

__all__ = ["SolverAdapter", "load_adapters", "solve_clarabel", "solve_highs"]


def load_adapters() -> dict[str, SolverAdapter]:
    """All solvers that there is an adapter for, installed or not, by name."""
    found: dict[str, SolverAdapter] = {}
    for file in sorted(module.name for module in iter_modules(__path__)):
        for adapter in getattr(import_module(f"{__name__}.{file}"), "ADAPTERS", ()):
            found[adapter.name] = adapter
    return found
