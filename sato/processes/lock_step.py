"""Flight of vehicles that are processes, in lock step: a barrier each round of the network."""

from collections import defaultdict
from collections.abc import Iterator, Mapping

from numpy import ndarray as Array

from sato.network.channel import NEVER, Channel
from sato.processes.fleet import Fleet, VehicleError
from sato.processes.messages import Call, Measured, Reply, SentPacket, Status
from sato.processes.presence import Presence
from sato.processes.reports import check_status
from sato.processes.world import World
from sato.reconfiguration.disturbances import disturb_control, measure
from sato.reconfiguration.state import ReconfigurationFrame

MAX_ROUNDS = 10_000  # of a decision that takes no time, before a vehicle is taken not to end it
ROUNDING = 1e-6  # of a control step, by which a round may come too soon


class LockStep:
    """Flight in which no vehicle goes on before all have acted in a round of the network.

    A paused process is waited for. One that ends is a loss; where decisions take no time, others
    begin theirs again without it.
    """

    def __init__(self, world: World, fleet: Fleet, scenario: str, seed: int) -> None:
        self.world, self.fleet, self._serial = world, fleet, 0
        self.presence = Presence(world, fleet, scenario, seed, 0.0)
        self._link_rng = world.rng.spawn(1)[0]  # draws losses and delays of messages
        self._relay: _Relay

    def fly(self) -> Iterator[ReconfigurationFrame]:
        """Fly all legs; yield a frame at every control instant."""
        world = self.world
        self.presence.begin()
        for number in range(len(world.mission.legs)):
            world.begin_leg(number)
            while True:
                while self.fleet.receive(timeout=0.0) is not None:
                    pass  # takes in what vehicles say of themselves
                world.take_up()
                self.presence.update()
                if world.end_leg():
                    break
                measured = measure(world.mission, world.x, world.rng)
                first, last = self._decide(measured)
                control = world.take_reports(first)
                world.status |= last
                intended = ((i, own.intended) for i, own in last.items())
                world.intended |= {i: later for i, later in intended if later is not None}
                applied = disturb_control(world.mission, control, world.rng)
                yield world.make_frame(control, applied, measured)
                world.fly(control, applied)
        yield world.make_frame()

    def _decide(self, measured: Array) -> tuple[dict[int, Status], dict[int, Status]]:
        """Let all act until the next instant; return their first and last reports."""
        world, seen = self.world, self.world.look_around()
        each = range(len(measured))
        told = {i: Measured(world.step_index, measured[i], seen.get(i, ())) for i in each}
        if world.mission.lag_steps:
            return self._go_on(told)
        while (reports := self._agree(told)) is None:
            pass
        return reports, reports

    def _agree(self, told: Mapping[int, Measured]) -> dict[int, Status] | None:
        """Let all decide at once; return their reports, or None where one has ended meanwhile."""
        self._relay, live = self._begin_relay(), self.world.live
        reports: dict[int, Status] = {}
        while reports.keys() != set(live):
            if self._relay.round == MAX_ROUNDS:
                late = sorted(set(live) - reports.keys())
                reason = f"have not decided after {MAX_ROUNDS:,} rounds of instant"
                raise VehicleError(f"vehicles {late} {reason} {self.world.step_index}")
            reports = self._call(told, self._relay.round == 0)
            if self.world.live != live:
                return None
        return reports

    def _go_on(self, told: Mapping[int, Measured]) -> tuple[dict[int, Status], dict[int, Status]]:
        """Let all go on with decisions that take time; return their first and last reports."""
        world, mission = self.world, self.world.mission
        if world.leg_step % mission.lag_steps == 0:
            self._relay = self._begin_relay()
        relay, ratio = self._relay, mission.link.round / mission.step
        most = mission.decision_rounds
        first: dict[int, Status] = {}
        last: dict[int, Status] = {}
        step = world.step_index - relay.instant
        while relay.round < most and int(relay.round * ratio + ROUNDING) == step:
            last = self._call(told, not first)
            first = {i: first.get(i, own) for i, own in last.items()}
        return first, last

    def _begin_relay(self) -> "_Relay":
        world = self.world
        channel = Channel(world.mission.link, world.connect(), self._link_rng.spawn(1)[0])
        return _Relay(channel, world.step_index)

    def _call(self, told: Mapping[int, Measured], begins: bool) -> dict[int, Status]:
        """Let all act in a round; return the reports of those that have decided and do not end."""
        self._serial += 1
        for i in self.world.live:
            own = told[i], tuple(self._relay.take(i)), begins
            self.fleet.send(i, Call(self._serial, self.world.leg_index, *own))
        replies: dict[int, Reply] = {}
        while replies.keys() != set(self.world.live):
            received = self.fleet.receive()
            if received is not None and self.world.alive[received[0]]:
                number, reply = received
                if not isinstance(reply, Reply) or reply.serial != self._serial:
                    raise VehicleError(f"vehicle {number} sends what is no answer to the last call")
                replies[number] = reply
            gone = self.fleet.take_gone()
            self.world.lose(gone)
            replies = {i: reply for i, reply in replies.items() if i not in gone}
        self._relay.send({i: reply.packet for i, reply in replies.items()})
        reports = {i: reply.status for i, reply in replies.items() if reply.status is not None}
        for i, status in reports.items():
            check_status(self.world.mission, i, status, self.world.step_index)
        return reports


class _Relay:
    """Packets on their way between vehicles, from the beginning of a decision on."""

    def __init__(self, channel: Channel, instant: int) -> None:
        self.instant, self.round, self._channel = instant, 0, channel
        self._arriving: defaultdict[tuple[int, int], list[SentPacket]] = defaultdict(list)

    def take(self, receiver: int) -> list[SentPacket]:
        """Take the packets that arrive at a vehicle in this round."""
        return self._arriving.pop((self.round, receiver), [])

    def send(self, packets: Mapping[int, bytes | None]) -> None:
        """Send the packets of this round, and go on to the next."""
        channel = self._channel
        channel.extend(self.round + 1)
        arrival = channel.by_round[self.round]
        for sender, receiver, at in zip(channel.sender, channel.receiver, arrival, strict=True):
            packet = packets.get(int(sender))
            if packet is not None and at != NEVER:
                self._arriving[int(at), int(receiver)].append((int(sender), packet))
        self.round += 1
