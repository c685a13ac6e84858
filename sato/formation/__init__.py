"""SYSTEM 2: formation flying. Gains → align → auction → steer → repeat [Lusk2020]."""

from sato.formation.avoidance import Avoidance
from sato.formation.flight import Frame, fly
from sato.formation.law import Law
from sato.formation.mission import Assigning, FormationFlight, Protocol, Push, aligned, misaligned
from sato.formation.swarm import Frames, Limits

__all__ = [
    "Assigning",
    "Avoidance",
    "FormationFlight",
    "Frame",
    "Frames",
    "Law",
    "Limits",
    "Protocol",
    "Push",
    "aligned",
    "fly",
    "misaligned",
]
