"""SYSTEM 3: connectivity maintenance. See → talk → reckon → keep together [Bernard2023]."""

from sato.connectivity.loop import ConnectivityFrame, simulate
from sato.connectivity.mission import AgentLoss, Connectivity

__all__ = ["AgentLoss", "Connectivity", "ConnectivityFrame", "simulate"]
