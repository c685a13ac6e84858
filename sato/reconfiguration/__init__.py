"""System 1, swarm reconfiguration: auction, then sequential convex programming [Morgan2016]."""

from typing import Any


def __getattr__(name: str) -> Any:
    if name == "MISSION":
        from sato.reconfiguration.mission import Reconfiguration

        return Reconfiguration
    if name == "SYSTEM":
        from sato.reconfiguration.system import SYSTEM

        return SYSTEM
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
