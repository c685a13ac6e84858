"""Messages between the world and the vehicles; those between vehicles pass as bytes.

A vehicle is told its mission once, and then at each control instant what it measures and sees.
It is told nothing of others but what these say themselves.
"""

from typing import Any, NamedTuple

from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration.stopping import Commitment
from sato.reconfiguration.surroundings import Sensed


class Briefing(NamedTuple):
    """All that a vehicle is told once: its mission, and how it takes part."""

    scenario: str  # TOML
    seed: int
    leg: int  # under way
    leg_start: float | None  # time at which it began, for a vehicle that joins [s]
    tick: float  # time between two packets of a vehicle that runs freely [s]; 0 in lock step


class Hearing(NamedTuple):
    """Sign of life of a vehicle that has no mission yet."""

    number: int
    process: int  # its number to the operating system


class Call(NamedTuple):
    """Request to act in one round of messages."""

    serial: int
    leg: int  # under way
    time: float  # [s]
    state: Float[Array, " n"]  # measured
    inbox: tuple[bytes, ...]  # packets of neighbors that arrive
    seen: tuple[Sensed, ...]
    begins: bool  # the instant, once more where others have fallen silent in the middle of it


class Status(NamedTuple):
    """Report for the record, after a decision; no vehicle hears it."""

    control: Float[Array, " d"]  # held [m/s²]
    commitment: Commitment | None
    target_index: int
    target_count: int
    clock: int
    has_plan: bool  # that leads to its target
    decides: bool  # True where it has planned
    calls: bool  # True where it has called for an auction at once
    solves: int  # programs solved to plan among others
    blocked: tuple[int, ...]  # targets that are left out
    events: tuple[dict[str, Any], ...]


class Reply(NamedTuple):
    """Packet of a vehicle in a round, and its report once its decision is made."""

    serial: int
    packet: bytes
    status: Status | None


class Fault(NamedTuple):
    """Error that has ended a vehicle."""

    kind: str
    text: str
