"""Process of one vehicle: its state and its memory, and messages to and from others."""

import os
import signal
import sys
import time
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from sato.atomic import is_held
from sato.processes.codec import CodecError, encode
from sato.processes.envelope import WORLD
from sato.processes.free_vehicle import FreeVehicle
from sato.processes.membership import Incarnation, Membership, read_key
from sato.processes.messages import Briefing, Call, Fault, Hearing, Reply
from sato.processes.network import Connection
from sato.processes.vehicle import Vehicle, open_packet
from sato.scenario.errors import InputError

MAX_REASON = 500  # characters of what has ended a vehicle
PATIENCE = 0.2  # time after which a vehicle says again that it is there [s]


def run_child(key_file: Path, number: int) -> None:
    """Run the process of one vehicle for the world, which ends it; Ctrl-C is for the world."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        run_vehicle(key_file, number)
    except InputError as error:
        sys.exit(f"sato: vehicle {number}: {error}")


def run_vehicle(key_file: Path, number: int) -> None:
    """Run the process of one vehicle, until the flight is over.

    Args:
        key_file: File of the key of the flight.
        number: Number of the vehicle.

    Raises:
        InputError: There is no such flight or vehicle, or the vehicle is there already.
    """
    member = read_key(key_file, number)
    incarnation = Incarnation(key_file, number)
    connection = VehicleConnection(member, number, incarnation.number, key_file)
    with threadpool_limits(1, user_api="blas"), closing(connection):
        try:
            briefing = _hear_mission(connection)
            vehicle = Vehicle(number, briefing)
            if briefing.tick:
                send = partial(connection.send, WORLD)
                FreeVehicle(vehicle, send, briefing.tick).run(connection.receive)
            _act_when_called(vehicle, connection)
        except Exception as error:  # the world ends the flight, and tells the reason
            kind, is_told = type(error).__name__, isinstance(error, ValueError | RuntimeError)
            text = str(error) if is_told else f"cannot go on, a {kind}: {error}"
            connection.send(WORLD, Fault(kind, text[:MAX_REASON]))
            while True:
                with suppress(CodecError):
                    connection.receive(timeout=PATIENCE)


class VehicleConnection(Connection):
    """Connection of a vehicle, whose process ends with the flight."""

    def __init__(self, member: Membership, number: int, incarnation: int, key_file: Path) -> None:
        super().__init__(member, number, incarnation)
        self._flight, self._looks_at = key_file.parent, 0.0

    def receive(self, timeout: float) -> tuple[int, Any] | None:
        """Return the sender and the next value, as `Connection` does."""
        if time.monotonic() > self._looks_at:
            self._looks_at = time.monotonic() + PATIENCE
            if not is_held(self._flight):
                os._exit(0)
        return super().receive(timeout)


def _hear_mission(connection: VehicleConnection) -> Briefing:
    """Say that the vehicle is there, until the world answers."""
    while True:
        connection.send(WORLD, Hearing(os.getpid()))
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            received = connection.receive(timeout=PATIENCE)
            if received is not None and isinstance(received[1], Briefing):
                return received[1]


def _act_when_called(vehicle: Vehicle, connection: VehicleConnection) -> None:
    """Act in every round of the network, in lock step."""
    agent, before = vehicle.agent, vehicle.agent.memory
    while True:
        received = connection.receive(timeout=PATIENCE)
        if received is None or not isinstance(call := received[1], Call):
            continue
        inbox = [open_packet(*sent) for sent in call.inbox]
        if call.begins:
            if agent.memory.instant == call.measured.instant:  # once more
                agent.memory = before
            if not vehicle.mission.lag_steps:  # the end of a leg is agreed on otherwise
                vehicle.begin_leg(call.leg)
            before = agent.memory
            packet = vehicle.begin(call.measured, inbox)
        else:
            packet = vehicle.act(call.measured, inbox)
        has_decided = agent.is_finished or vehicle.mission.lag_steps > 0
        status = vehicle.report() if has_decided else None
        data = None if packet is None else encode(packet)
        connection.send(WORLD, Reply(call.serial, data, status))
