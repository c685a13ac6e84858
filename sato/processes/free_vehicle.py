"""Vehicle that runs freely: it acts once it has what it waits for, and repeats itself by the clock.

It asks its actuators before it tells others that it commits to something new. These refuse what
comes too late, as from a process that was paused, and what was decided without a vehicle beside it:
then it keeps what it had. It also does where it hears one that does not hear it, or heard it too
late: both decide again in the next period.
"""

from collections.abc import Callable
from functools import lru_cache
from time import monotonic
from typing import Any

from sato.network.channel import NEVER
from sato.processes.codec import encode
from sato.processes.messages import Alive, Consent, FreePacket, Held, Intention, Measured
from sato.processes.vehicle import Vehicle, begun_at, open_packet

HEARTBEAT = 0.1  # longest time between two signs of life [s]
LATE_START = 0.1  # time by which processes may begin a decision one after another [s]
_open_once = lru_cache(64)(open_packet)


class FreeVehicle:
    """Vehicle that runs freely."""

    def __init__(self, vehicle: Vehicle, send: Callable[[Any], object], tick: float) -> None:
        self.vehicle, self.send, self.tick = vehicle, send, tick
        self._measured: Measured | None = None
        self._begun: Any = None  # decision under way, as it began
        self._until: int | None = None  # instant at which it ends; None where it is given up
        self._inbox: list[Any] = []
        self._listens_until = 0.0  # time at which it knows its neighbors [s]
        self._rounds: dict[int, int] = {}  # last in which each neighbor has acted
        self._version: Any = None  # of the packet, which is sent again until it changes
        self._packet: FreePacket
        self._age = 0  # ticks since it changed; it is sent again after 1, 2, 4 …
        self._sent = 0.0  # time at which anything was sent [s]
        self._asked: int | None = None  # instant from which on it intends to fly what is new
        self._has_consent = False

    def run(self, receive: Callable[[float], tuple[int, Any] | None]) -> None:
        """Act until the world is gone; what others send is received within a time [s]."""
        due = monotonic()
        while True:
            received = receive(max(0.0, due - monotonic()))
            if received is not None:
                self._take_in(received[1])
            elif monotonic() >= due:
                due = monotonic() + self.tick
                self._act()
                if monotonic() > self._sent + HEARTBEAT:
                    self._send(Alive())

    def _send(self, value: Any) -> None:
        self._sent = monotonic()
        self.send(value)

    def _take_in(self, value: Any) -> None:
        if isinstance(value, FreePacket):
            if value.until == self._until:
                self._hear(value)
        elif isinstance(value, Consent):
            self._has_consent |= value.first_step == self._asked
        elif isinstance(value, Measured):
            self._begin(value)

    def _hear(self, packet: FreePacket) -> None:
        own, number = self._decides_with, self.vehicle.number
        is_unheard = packet.neighbors is not None and number not in packet.neighbors
        if is_unheard or (own is not None and packet.sender not in own):
            self._give_up()
            return
        self._inbox.append(_open_once(packet.sender, packet.content))
        heard = self._rounds.get(packet.sender, -1)
        self._rounds[packet.sender] = max(heard, packet.round)
        under_way = self.vehicle.agent.memory.under_way
        assert under_way is not None
        agent = under_way.agent
        if own and not agent.is_finished and packet.round > heard:
            if min(self._rounds.get(i, -1) for i in own) >= agent.round:
                self._act()

    @property
    def _decides_with(self) -> tuple[int, ...] | None:
        """Neighbors with which it decides; None while it listens for them."""
        own = self.vehicle.agent.memory.under_way
        assert own is not None
        is_listening = own.agent.network_round < own.agent.discovery_rounds
        return None if is_listening else tuple(sorted(own.agent.neighbors))

    def _give_up(self) -> None:
        """Keep what it had, unless others may count on something else."""
        if self._asked is None and self._begun is not None:
            self._go_on(self._begun, network_round=self._begun.agent.last_network_round)
            self._until = None

    def _go_on(self, decision: Any, **changed: int) -> Any:
        """Go on with a decision under way whose agent is changed, and return it."""
        memory = self.vehicle.agent.memory
        decision = decision._replace(agent=decision.agent._replace(**changed))
        self.vehicle.agent.memory = memory._replace(under_way=decision)
        return decision

    def _begin(self, measured: Measured) -> None:
        agent = self.vehicle.agent
        if measured.instant == self._asked and not self._has_consent:
            self._asked = None
            self._give_up()
        before = begun_at(agent)
        self.vehicle.begin(measured, [])
        self._measured = measured
        begun = agent.memory.under_way
        if begun is not None and begun_at(agent) != before:
            listens = begun.agent.discovery_rounds * self.tick + LATE_START
            self._listens_until = monotonic() + listens
            # Not so many rounds, but so long.
            self._begun = self._go_on(begun, discovery_rounds=NEVER, last_network_round=NEVER)
            self._until = begun.decision.context.instant
            self._inbox, self._asked, self._has_consent = [], None, False
            self._rounds = {}
        self.send(Held(measured.instant, self.vehicle.report()))

    def _act(self) -> None:
        """Act once, and send a packet."""
        measured, agent = self._measured, self.vehicle.agent
        if measured is None or self._until is None:
            return
        if self._decides_with is None and monotonic() >= self._listens_until:
            heard: Any = agent.memory.under_way
            self._go_on(heard, discovery_rounds=heard.agent.network_round)
        inbox, self._inbox = self._inbox, []
        packet = self.vehicle.act(measured, inbox)
        under_way = agent.memory.under_way
        assert under_way is not None
        intended = self.vehicle.intended
        if under_way.commits and not self._has_consent:
            if self._asked is None and intended is not None:
                self._asked = intended.first_step
                self.send(Intention(intended, self._decides_with or ()))
            return
        own = self._decides_with, under_way.agent.round
        head = self.vehicle.number, self._until, *own
        version = *head, packet.commits
        self._age += 1
        if version != self._version:
            self._version, self._packet, self._age = version, FreePacket(*head, encode(packet)), 0
        is_listening, is_power = own[0] is None, self._age & (self._age - 1) == 0
        if is_listening or is_power or monotonic() > self._sent + HEARTBEAT:
            self._send(self._packet)
