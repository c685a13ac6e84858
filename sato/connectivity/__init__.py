"""SYSTEM 3: connectivity maintenance. See → talk → reckon → keep together [Bernard2023]."""

from typing import Any

from sato.connectivity.loop import ConnectivityFrame, simulate
from sato.connectivity.mission import AgentLoss, Connectivity

__all__ = ["AgentLoss", "Connectivity", "ConnectivityFrame", "simulate"]


def __getattr__(name: str) -> Any:
    if name == "MISSION":
        return Connectivity
    if name == "SYSTEM":
        from sato.connectivity.system import SYSTEM

        return SYSTEM
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
