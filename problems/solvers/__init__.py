"""One short adapter a file: standard form in, a claim out, and nothing is believed.

A new solver is one more file here, with its `Adapter` in a tuple `ADAPTERS`.
"""

from importlib import import_module
from pkgutil import iter_modules

from problems.solvers.adapter import Adapter
from problems.solvers.clarabel import solve_clarabel
from problems.solvers.highs import solve_highs

__all__ = ["Adapter", "adapters", "solve_clarabel", "solve_highs"]


def adapters() -> dict[str, Adapter]:
    """All solvers that there is an adapter for, installed or not, by name."""
    found: dict[str, Adapter] = {}
    for file in sorted(module.name for module in iter_modules(__path__)):
        for adapter in getattr(import_module(f"{__name__}.{file}"), "ADAPTERS", ()):
            found[adapter.name] = adapter
    return found
