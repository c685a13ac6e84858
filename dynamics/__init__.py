"""Equations of motion: models, plants, orbits and discretization.

The lowest layer: nothing here knows of optimization or of swarms. A name is imported from
its module when it is first used, so that `import dynamics` is fast.
"""
# mypy: implicit-reexport
# ruff: noqa: F401

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynamics.atmosphere import Atmosphere
    from dynamics.circular_orbit import ClohessyWiltshire, SchweighartSedwick
    from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
    from dynamics.discretize import DiscreteModel, discretize_zoh, linearize_along
    from dynamics.double_integrator import DoubleIntegrator
    from dynamics.inertial import InertialPlant
    from dynamics.j2 import J2, invariant_velocity
    from dynamics.model import LinearizedModel, LinearModel, Model, NonlinearModel, SymbolicModel
    from dynamics.orbit import Orbit
    from dynamics.plant import LinearPlant, NonlinearPlant, Plant
    from dynamics.propagation import Impact, propagate
    from dynamics.tschauner_hempel import TschaunerHempel

_PUBLIC = {
    "atmosphere": ["Atmosphere"],
    "circular_orbit": ["ClohessyWiltshire", "SchweighartSedwick"],
    "coordinate_frames": ["LVLH", "inertial_state", "to_polar_nodal"],
    "discretize": ["DiscreteModel", "discretize_zoh", "linearize_along"],
    "double_integrator": ["DoubleIntegrator"],
    "inertial": ["InertialPlant"],
    "j2": ["J2", "invariant_velocity"],
    "model": ["LinearModel", "LinearizedModel", "Model", "NonlinearModel", "SymbolicModel"],
    "orbit": ["Orbit"],
    "plant": ["LinearPlant", "NonlinearPlant", "Plant"],
    "propagation": ["Impact", "propagate"],
    "tschauner_hempel": ["TschaunerHempel"],
}
_MODULES = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = sorted(_MODULES)


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
