"""SYSTEM 3: connectivity maintenance. See → talk → reckon → keep together [Bernard2023]."""

from sato.connectivity.flight import Frame, fly
from sato.connectivity.mission import ConnectivityFlight, Death

__all__ = ["ConnectivityFlight", "Death", "Frame", "fly"]
