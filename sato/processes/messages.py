"""Messages between the world and the vehicles; those between vehicles pass as bytes.

A vehicle is told its mission once, and then at each control instant what it measures and sees.
It is told nothing of others but what these say themselves.
"""

from typing import Any, NamedTuple

from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration.stopping import Commitment
from sato.reconfiguration.surroundings import Sensed
from sato.scenario.definition import Count


class Hearing(NamedTuple):
    """Sign of life of a vehicle that has no mission yet."""

    process: int  # its number to the operating system


class Briefing(NamedTuple):
    """All that a vehicle is told once: its mission, and how it takes part."""

    scenario: str  # TOML
    seed: int
    leg: Count  # under way
    leg_start: float | None  # time at which it began, for a vehicle that joins [s]
    tick: float  # time between two packets of a vehicle that runs freely [s]; 0 in lock step


class Measured(NamedTuple):
    """State and surroundings that a vehicle measures at a control instant."""

    instant: Count  # steps since the start of the mission
    state: Float[Array, " n"]
    seen: tuple[Sensed, ...]


SentPacket = tuple[int, bytes]  # sender, as the world knows it, and its packet


class Call(NamedTuple):
    """Request to act in one round of the network, in lock step."""

    serial: int
    leg: int  # under way
    measured: Measured
    inbox: tuple[SentPacket, ...]  # of neighbors, that arrive
    begins: bool  # the instant, once more where others have fallen silent in the middle of it


class Status(NamedTuple):
    """Report for the record; no vehicle hears it."""

    leg: Count  # under way
    is_leg_over: bool  # as the vehicle knows
    control: Float[Array, " d"]  # held [m/s²]
    commitment: Commitment | None
    intended: Commitment | None  # what is flown from the next decision on, where that takes time
    target_index: int
    target_count: int
    clock: Count
    has_plan: bool  # that leads to its target
    decides: bool  # True where it has planned
    calls: bool  # True where it has called for an auction at once
    solves: Count  # programs solved to plan among others
    blocked: tuple[int, ...]  # targets that are left out
    events: tuple[dict[str, Any], ...]

    def then(self, later: "Status") -> "Status":
        """Return a later report, with all that has happened since this one."""
        decides, calls = self.decides or later.decides, self.calls or later.calls
        return later._replace(decides=decides, calls=calls, events=(*self.events, *later.events))


class Reply(NamedTuple):
    """Packet of a vehicle in a round, and its report once its decision is made, in lock step."""

    serial: int
    packet: bytes | None
    status: Status | None


class FreePacket(NamedTuple):
    """Packet to or from others within hearing, when vehicles run freely."""

    sender: int
    until: int  # instant from which on it is void
    neighbors: tuple[int, ...] | None  # with which the sender decides; None while it listens
    round: Count  # in which the sender has acted
    content: bytes


class Intention(NamedTuple):
    """Request of a vehicle that runs freely to fly something else from an instant on."""

    commitment: Commitment
    neighbors: tuple[int, ...]  # with which it has decided


class Consent(NamedTuple):
    """Answer of the actuators: what is intended from an instant on is flown."""

    first_step: int


class Alive(NamedTuple):
    """Sign of life of a vehicle that runs freely, and has nothing else to say."""


class Held(NamedTuple):
    """Report of a vehicle that runs freely, at a control instant."""

    instant: int
    status: Status


class Fault(NamedTuple):
    """Error that has ended a vehicle."""

    kind: str
    text: str
