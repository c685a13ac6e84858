"""System 2, formation flying: gains, alignment, auction, control law [Lusk2020].

It plans nothing: a control law and collision avoidance stand in place of planning.
"""

from typing import Any


def __getattr__(name: str) -> Any:
    if name == "MISSION":
        from sato.formation.mission import Formation

        return Formation
    if name == "SYSTEM":
        from sato.formation.system import SYSTEM

        return SYSTEM
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
