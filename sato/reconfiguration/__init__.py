"""SYSTEM 1: swarm reconfiguration. Cost → auction → SCP → fly → repeat [Morgan2016]."""

from sato.reconfiguration.flight import fly
from sato.reconfiguration.mission import Arrival, Leg, Loss, Reconfiguration

__all__ = ["Arrival", "Leg", "Loss", "Reconfiguration", "fly"]
