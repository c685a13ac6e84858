"""Flight of vehicles that are processes, in lock step: a barrier each round of the network."""

from collections import defaultdict
from collections.abc import Iterator

from numpy import ndarray as Array

from sato.network.channel import NEVER, Channel
from sato.processes.fleet import Fleet
from sato.processes.messages import Call, Reply, Status
from sato.processes.presence import Presence
from sato.processes.world import World
from sato.reconfiguration.disturbances import measure
from sato.reconfiguration.leg import MAX_LEG_FACTOR
from sato.reconfiguration.state import ReconfigurationFrame


class LockStep:
    """Flight in which no vehicle goes on before all have acted in a round.

    A paused process is waited for. One that ends is a loss; if others were about to decide with it,
    they begin their decision again without it, for no time has passed.
    """

    def __init__(self, world: World, fleet: Fleet, scenario: str, seed: int) -> None:
        self.world, self.fleet, self._serial = world, fleet, 0
        self.presence = Presence(world, fleet, scenario, seed, 0.0)
        self._link_rng = world.rng.spawn(1)[0]  # draws losses and delays of messages

    def fly(self) -> Iterator[ReconfigurationFrame]:
        """Fly all legs; yield a frame at every control instant."""
        self.presence.begin()
        for number in range(len(self.world.mission.legs)):
            self.world.begin_leg(number)
            yield from self._fly_leg()
        yield self.world.make_frame()

    def _fly_leg(self) -> Iterator[ReconfigurationFrame]:
        world = self.world
        most = MAX_LEG_FACTOR * world.mission.legs[world.leg_index].steps
        while True:
            self.fleet.drain()
            self.presence.update()
            is_given_up = world.leg_step == most
            if is_given_up or (world.leg_step > 0 and world.have_arrived()):
                world.end_leg(is_given_up)
                return
            measured = measure(world.mission, world.x, world.rng)
            control = world.take_reports(self._decide(measured))
            applied = world.disturb(control)
            yield world.make_frame(control, applied, measured)
            world.fly(control, applied)

    def _decide(self, measured: Array) -> dict[int, Status]:
        """Let all decide in rounds of messages; return what they report."""
        reports = None
        while reports is None:
            reports = self._try_to_decide(measured)
        return reports

    def _try_to_decide(self, measured: Array) -> dict[int, Status] | None:
        """Let all decide; return what they report, or None where one has ended meanwhile."""
        world, reports, now = self.world, dict[int, Status](), 0
        graph, seen = world.connect(), world.look_around()
        channel = Channel(world.mission.link, graph, self._link_rng.spawn(1)[0])
        arriving: defaultdict[tuple[int, int], list[bytes]] = defaultdict(list)
        while len(reports) < len(world.live):
            self._serial += 1
            calls = {
                i: Call(
                    serial=self._serial,
                    leg=world.leg_index,
                    time=world.time,
                    state=measured[i],
                    inbox=tuple(arriving.pop((now, i), ())),
                    seen=seen.get(i, ()),
                    begins=now == 0,
                )
                for i in world.live
            }
            replies = self._call(calls)
            if replies is None:
                return None
            reports = {i: r.status for i, r in replies.items() if r.status is not None}
            channel.extend(now + 1)
            edges = zip(channel.sender, channel.receiver, channel.arrival[:, now], strict=True)
            for sender, receiver, at in edges:
                if at != NEVER:
                    arriving[int(at), int(receiver)].append(replies[int(sender)].packet)
            now += 1
        return reports

    def _call(self, calls: dict[int, Call]) -> dict[int, Reply] | None:
        """Call all once, and wait for their replies; None where one has ended instead."""
        for i, call in calls.items():
            self.fleet.send(i, call)
        replies: dict[int, Reply] = {}
        while replies.keys() != calls.keys():
            received = self.fleet.receive()
            if received is not None and isinstance(received[1], Reply):
                number, reply = received
                if reply.serial == self._serial:
                    replies[number] = reply
            gone = self.fleet.take_gone()
            if gone:
                self.world.lose(gone)
                return None
        return replies
