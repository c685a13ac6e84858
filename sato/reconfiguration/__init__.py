"""SYSTEM 1: swarm reconfiguration. Cost → auction → SCP → fly → repeat [Morgan2016]."""

from sato.reconfiguration.flight import fly
from sato.reconfiguration.frame import Frame
from sato.reconfiguration.mission import Arrival, Leg, Loss, Reconfiguration

__all__ = ["Arrival", "Frame", "Leg", "Loss", "Reconfiguration", "fly"]
