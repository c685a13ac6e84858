"""SYSTEM 1: swarm reconfiguration. Cost → auction → SCP → fly → repeat [Morgan2016]."""

from sato.reconfiguration.frame import ReconfigurationFrame
from sato.reconfiguration.loop import fly
from sato.reconfiguration.mission import Join, Leg, Loss, Reconfiguration

__all__ = ["Join", "Leg", "Loss", "Reconfiguration", "ReconfigurationFrame", "fly"]
