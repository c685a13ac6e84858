"""How things move. Knows no optimisation and no swarm."""

from dynamics.atmosphere import Atmosphere
from dynamics.clohessy_wiltshire import ClohessyWiltshire
from dynamics.discretise import Steps, follow, hold
from dynamics.double_integrator import DoubleIntegrator
from dynamics.eccentric import Eccentric
from dynamics.elements import Elements
from dynamics.frames import LVLH, inertial_state, osculating
from dynamics.inertial import Inertial
from dynamics.j2 import J2, invariant_velocity
from dynamics.model import Linearised, LinearModel, Model, NonlinearModel, SymbolicModel
from dynamics.orbit import Orbit
from dynamics.plant import Modelled, Plant
from dynamics.propagation import Impact, propagate
from dynamics.relative_elements import RelativeElements
from dynamics.schweighart_sedwick import SchweighartSedwick

__all__ = [
    "J2",
    "LVLH",
    "Atmosphere",
    "ClohessyWiltshire",
    "DoubleIntegrator",
    "Eccentric",
    "Elements",
    "Impact",
    "Inertial",
    "LinearModel",
    "Linearised",
    "Model",
    "Modelled",
    "NonlinearModel",
    "Orbit",
    "Plant",
    "RelativeElements",
    "SchweighartSedwick",
    "Steps",
    "SymbolicModel",
    "follow",
    "hold",
    "inertial_state",
    "invariant_velocity",
    "osculating",
    "propagate",
]
