"""Optimization and estimation problems, each solved once from data; no swarm.

    from problems import TransferProblem, design_gains

Names are imported when they are first used, for some take long.
"""

from importlib import import_module
from typing import Any

_NAMES_BY_MODULE = {
    "alignment": ("Pose", "align"),
    "assignment": ("solve_assignment",),
    "auction_cost": ("TransferCosts", "compute_transfer_costs", "solve_transfer"),
    "avoidance": ("AvoidanceProblem", "AvoidanceResult", "HalfSpaces", "empty_half_spaces"),
    "centralized": ("CentralizedProblem",),
    "centralized_nlp": ("NonlinearProgram",),
    "centralized_solution": ("CentralizedResult",),
    "conic": ("ConicProgram", "ConicSolution", "Infeasible", "SolverResult", "Unsolved"),
    "convexify": ("AvoidanceHorizon",),
    "desired_formation": ("DesiredFormation",),
    "families": ("list_families", "load_family"),
    "fixed_size_avoidance": ("FixedSizeAvoidanceProblem",),
    "gain_design": ("design_gains",),
    "gain_matrix": ("GainMatrix",),
    "interaction_graph": ("Camera", "algebraic_connectivity"),
    "minimum_fuel": ("solve_minimum_fuel",),
    "pair_avoidance": ("PairProblem",),
    "rigidity": ("is_globally_rigid", "is_redundantly_rigid", "is_rigid"),
    "solvers": ("SolverAdapter", "load_adapters"),
    "transfer": ("Trajectory", "TransferProblem"),
}
_MODULES = {name: module for module, names in _NAMES_BY_MODULE.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_MODULES)
