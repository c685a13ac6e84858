"""SYSTEM 2: formation flying. Gains → align → auction → steer → repeat [Lusk2020]."""

from typing import Any

from sato.formation.avoidance import CollisionAvoidance
from sato.formation.control_law import ControlLaw
from sato.formation.kernel import CoordinateFrames, FormationLimits
from sato.formation.loop import FormationFrame, simulate
from sato.formation.mission import (
    AssignmentSettings,
    Formation,
    OperatorCommand,
    SupervisorSettings,
    aligned_frames,
    draw_frames,
)

__all__ = [
    "AssignmentSettings",
    "CollisionAvoidance",
    "ControlLaw",
    "CoordinateFrames",
    "Formation",
    "FormationFrame",
    "FormationLimits",
    "OperatorCommand",
    "SupervisorSettings",
    "aligned_frames",
    "draw_frames",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name == "MISSION":
        return Formation
    if name == "SYSTEM":
        from sato.formation.system import SYSTEM

        return SYSTEM
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
