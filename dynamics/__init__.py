"""How things move. Knows no optimisation and no swarm."""

from dynamics.clohessy_wiltshire import ClohessyWiltshire
from dynamics.discretise import Steps, hold
from dynamics.double_integrator import DoubleIntegrator
from dynamics.model import Linearised, LinearModel, Model, SymbolicModel

__all__ = [
    "ClohessyWiltshire",
    "DoubleIntegrator",
    "LinearModel",
    "Linearised",
    "Model",
    "Steps",
    "SymbolicModel",
    "hold",
]
