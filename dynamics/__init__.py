"""How things move. Knows no optimisation and no swarm."""

from dynamics.atmosphere import Atmosphere
from dynamics.clohessy_wiltshire import ClohessyWiltshire
from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
from dynamics.discretize import DiscreteModel, discretize_zoh, linearize_along
from dynamics.double_integrator import DoubleIntegrator
from dynamics.elements import ClassicalElements
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2, invariant_velocity
from dynamics.model import LinearizedModel, LinearModel, Model, NonlinearModel, SymbolicModel
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant, Plant
from dynamics.propagation import Impact, propagate
from dynamics.relative_elements import RelativeOrbitalElements
from dynamics.schweighart_sedwick import SchweighartSedwick
from dynamics.tschauner_hempel import TschaunerHempel

__all__ = [
    "J2",
    "LVLH",
    "Atmosphere",
    "ClassicalElements",
    "ClohessyWiltshire",
    "DiscreteModel",
    "DoubleIntegrator",
    "Impact",
    "InertialPlant",
    "LinearModel",
    "LinearPlant",
    "LinearizedModel",
    "Model",
    "NonlinearModel",
    "Orbit",
    "Plant",
    "RelativeOrbitalElements",
    "SchweighartSedwick",
    "SymbolicModel",
    "TschaunerHempel",
    "discretize_zoh",
    "inertial_state",
    "invariant_velocity",
    "linearize_along",
    "propagate",
    "to_polar_nodal",
]
