"""Flight of vehicles that are processes, by the clock: each runs freely, and messages take time."""

from collections.abc import Iterator
from heapq import heappop, heappush
from time import monotonic
from typing import Any

import numpy as np
from numpy import ndarray as Array

from sato.network.outages import PairOutages
from sato.processes.codec import encode
from sato.processes.fleet import Fleet
from sato.processes.free_vehicle import HEARTBEAT
from sato.processes.messages import Consent, FreePacket, Held, Intention, Measured, Status
from sato.processes.presence import Presence
from sato.processes.reports import check_commitment, check_status
from sato.processes.world import World
from sato.reconfiguration.disturbances import disturb_control, measure
from sato.reconfiguration.network_decision import stop_at_once
from sato.reconfiguration.state import ReconfigurationFrame

GRACE = 0.2  # of a step, within which vehicles say what they fly
SILENT_TIME = 5 * HEARTBEAT  # after which a vehicle that sends nothing is taken as paused [s]


class FreeRunning:
    """Flight in which the world goes on by the clock, whether vehicles have acted or not.

    A vehicle flies what its actuators have last heard from its process, to its end at rest. These
    take nothing for an instant that has come, and nothing that was decided without a vehicle that
    was within hearing, and not seen to be silent. One that says nothing, as its process is paused,
    is seen by others as one that was lost and is still there.
    """

    def __init__(
        self, world: World, fleet: Fleet, scenario: str, seed: int, speed: float = 1.0
    ) -> None:
        """Prepare to fly so many times as fast as by the clock."""
        mission = world.mission
        self.world, self.fleet = world, fleet
        self.step, self.tick = mission.step / speed, mission.link.round / speed  # [s]
        self.presence = Presence(world, fleet, scenario, seed, self.tick)
        rng = world.rng.spawn(1)[0]
        self._packets = PacketsUnderWay(world, self.tick, rng)
        self._beside: dict[int, set[int]] = {}  # vehicles within hearing, as decisions began
        self._reports: dict[int, Status] = {}  # that are not recorded yet
        self._on_time: set[int] = set()  # vehicles that have reported at this instant
        self._heard: dict[int, float] = {}  # time at which each last said anything

    def fly(self) -> Iterator[ReconfigurationFrame]:
        """Fly all legs; yield a frame at every control instant."""
        world = self.world
        self.presence.begin()
        world.begin_leg(0)
        due = monotonic()
        while True:
            world.take_up()
            self.presence.update()
            due = max(due, monotonic())  # a process that was started takes its time
            if world.end_leg():
                if world.leg_index == len(world.mission.legs) - 1:
                    break
                world.begin_leg(world.leg_index + 1)
                self.fleet.kill(world.apply_losses())
            self._stop_others()
            measured = measure(world.mission, world.x, world.rng)
            self._ask(measured)
            reports, self._reports = self._reports, {}
            control = world.take_reports(reports, set(reports) - self._on_time)
            applied = disturb_control(world.mission, control, world.rng)
            yield world.make_frame(control, applied, measured)
            world.fly(control, applied)
            due += self.step
            self._run_until(due, set())
        yield world.make_frame()

    def _stop_others(self) -> None:
        """Stop those that have not said what they fly."""
        world = self.world
        for i in world.live:
            if i not in world.committed:
                state = world.x[i]
                world.committed[i] = stop_at_once(world.mission, i, state, world.step_index)

    def _ask(self, measured: Array) -> None:
        """Tell all what they measure and see, and let them say what they fly."""
        world, now = self.world, monotonic()
        silent = [i for i in world.live if now - self._heard.setdefault(i, now) > SILENT_TIME]
        if silent:
            world.note("silent", silent)
        if world.leg_step % world.mission.lag_steps == 0:
            graph = world.connect()
            self._beside = {
                i: set(graph.neighbors[i].tolist()).difference(silent) for i in world.live
            }
        seen = world.look_around(silent)
        for i in world.live:
            self.fleet.send(i, Measured(world.step_index, measured[i], seen.get(i, ())))
        self._on_time = set()
        self._run_until(now + GRACE * self.step, set(world.live).difference(silent))
        self._reports = {i: own for i, own in self._reports.items() if world.alive[i]}

    def _run_until(self, due: float, awaited: set[int]) -> None:
        """Pass on packets until a time, or until all that are awaited have reported."""
        while (left := due - monotonic()) > 0:
            received = self.fleet.receive(min(left, self._packets.deliver(self.fleet)))
            if received is not None:
                number, value = received
                self._heard[number] = monotonic()
                self._take_in(number, value)
            if awaited and awaited <= self._on_time:
                return

    def _take_in(self, number: int, value: Any) -> None:
        world = self.world
        if not world.alive[number]:
            return
        if isinstance(value, FreePacket) and value.until > world.step_index:
            if value.sender != number:
                return
            self._packets.send(number, value)
        elif isinstance(value, Held):
            check_status(world.mission, number, value.status, world.step_index)
            if value.instant == world.step_index:
                self._on_time.add(number)
            before = self._reports.get(number)
            self._reports[number] = value.status if before is None else before.then(value.status)
        elif isinstance(value, Intention) and value.commitment.first_step > world.step_index:
            latest = world.step_index + world.mission.lag_steps
            check_commitment(world.mission, number, value.commitment, latest)
            missed = self._beside.get(number, set()).difference(value.neighbors)
            if not missed.intersection(world.live):
                world.intended[number] = value.commitment
                self.fleet.send(number, Consent(value.commitment.first_step))


class PacketsUnderWay:
    """Packets under way between vehicles: some are lost, or late."""

    def __init__(self, world: World, tick: float, rng: np.random.Generator) -> None:
        self.world, self.tick, self.rng = world, tick, rng
        self._outages = PairOutages(world.mission.link, len(world.x), rng)
        self._is_down, self._next_round = self._outages.advance(), monotonic() + tick
        self._late: list[tuple[float, int, int, int, bytes]] = []  # by time
        self._sent = 0

    def send(self, sender: int, packet: FreePacket) -> None:
        """Send a packet to all within hearing."""
        link, now, data = self.world.mission.link, monotonic(), encode(packet)
        while self._next_round <= now:
            self._is_down = self._outages.advance()
            self._next_round += self.tick
        for receiver in self.world.connect().neighbors[sender].tolist():
            is_lost = self.rng.random() < link.loss_probability
            late = int(self.rng.integers(link.late + 1))
            if not (self._is_down[sender, receiver] or is_lost):
                self._sent += 1
                own = receiver, packet.until, data
                heappush(self._late, (now + late * self.tick, self._sent, *own))

    def deliver(self, fleet: Fleet) -> float:
        """Deliver the packets that are due; return the time until the next [s]."""
        now = monotonic()
        while self._late and self._late[0][0] <= now:
            _, _, receiver, until, data = heappop(self._late)
            if self.world.alive[receiver] and until > self.world.step_index:
                fleet.pass_on(receiver, data)
        return self._late[0][0] - now if self._late else 1.0
