"""System 3, connectivity maintenance with cameras [Bernard2023]."""

from typing import Any


def __getattr__(name: str) -> Any:
    if name == "MISSION":
        from sato.connectivity.mission import Connectivity

        return Connectivity
    if name == "SYSTEM":
        from sato.connectivity.system import SYSTEM

        return SYSTEM
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
