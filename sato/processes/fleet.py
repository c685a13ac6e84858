"""Processes of all vehicles: their start, what they say, and their end."""

import signal
from collections import deque
from collections.abc import Iterable
from contextlib import AbstractContextManager, ExitStack, suppress
from multiprocessing import forkserver, resource_tracker
from pathlib import Path
from tempfile import gettempdir
from time import monotonic
from typing import Any

from sato.atomic import is_held, open_scratch
from sato.processes.codec import CodecError
from sato.processes.envelope import WORLD
from sato.processes.membership import KEY_FILE, create_key, write_private
from sato.processes.messages import Fault, Hearing
from sato.processes.network import START_TIME, USER, Connection, check_port, load_zenoh
from sato.processes.vehicle_process import run_child
from sato.scenario.errors import InputError
from sato.scenario.ranges import machine_memory
from sato.workers import check_guard, make_context, place_sockets

MAX_VEHICLES = 16
PROCESS_MEMORY = 250e6  # of one vehicle, with the libraries that it has imported [byte]
LOOK_INTERVAL = 0.1  # at which the world looks whether processes are there [s]
PRELOADED = ["sato.processes.vehicle_process"]  # by the process from which the others are forked
PREFIX = "sato-fleet-"  # of the folders of flights, which the next one removes if one is killed
MEMINFO = Path("/proc/meminfo")


class VehicleError(RuntimeError):
    """A vehicle that cannot go on."""


class Fleet(AbstractContextManager["Fleet"]):
    """Processes of all vehicles, and the connection of the world to them.

    A process that the user starts for a vehicle, by `sato vehicle`, is one of them.
    """

    def __init__(self, mission: str, vehicles: int, port: int | None = None) -> None:
        """Listen for the vehicles of a mission, at a port if asked to; refuse one in use."""
        load_zenoh()
        if port is not None:
            check_port(port)
        with ExitStack() as stack:
            self._folder = stack.enter_context(open_scratch(Path(gettempdir()), PREFIX))
            member = create_key(self._folder, mission, port, vehicles)
            users = self._folder / "users"
            write_private(users, f"{USER}:{member.key.hex()}\n")
            self._connection = Connection(member, WORLD, 1, users)
            self._closing = stack.pop_all()
        self.key_file = self._folder / KEY_FILE
        self.processes: dict[int, Any] = {}  # those that were started here
        self.ids: dict[int, int] = {}  # of all that were heard, to the operating system
        self.new: list[int] = []  # that ask for a mission
        self._replaced: set[int] = set()  # whose processes were started again
        self._looks_at = 0.0  # time at which it looks again whether processes have ended [s]
        self._received: deque[tuple[int, Any]] = deque()  # while others were started

    def __exit__(self, *error: object) -> None:
        """End all processes, also those that are paused."""
        for process in self.processes.values():
            process.kill()
        for process in self.processes.values():
            process.join()
        self._connection.close()
        self._closing.close()

    def start(self, numbers: Iterable[int]) -> None:
        """Start the processes of some vehicles, and wait until all are there.

        Refuse those for which there is no memory; a `VehicleError` says that one has ended early.
        """
        each = list(numbers)
        check_guard()
        place_sockets()
        check_memory(len(each))
        context = _context()
        for i in each:
            process = context.Process(target=run_child, args=(self.key_file, i), daemon=True)
            process.start()
            self.processes[i] = process
        until = monotonic() + START_TIME
        while not set(each) <= set(self.new):
            if (received := self._receive(LOOK_INTERVAL)) is not None:
                self._received.append(received)
            for i in each:
                if not self.processes[i].is_alive():
                    code = self.processes[i].exitcode
                    raise VehicleError(f"the process of vehicle {i} has ended with code {code}")
            if monotonic() > until:
                raise VehicleError(f"the processes were not there within {START_TIME:g} s")

    def kill(self, numbers: Iterable[int]) -> None:
        """End the processes of vehicles that are lost, as far as they were started here."""
        for i in numbers:
            if i in self.processes:
                self.processes[i].kill()

    def take_new(self) -> list[int]:
        """Return the vehicles that ask for a mission, each once."""
        found, self.new = sorted(set(self.new)), []
        return found

    def take_gone(self) -> list[int]:
        """Return the vehicles whose processes have ended, each once; look from time to time."""
        if monotonic() < self._looks_at:
            return []
        self._looks_at = monotonic() + LOOK_INTERVAL
        ended = {i for i in self.ids if not is_held(self._folder / str(i))}
        self.ids = {i: process for i, process in self.ids.items() if i not in ended}
        found, self._replaced = sorted(ended | self._replaced), set()
        return found

    def send(self, number: int, value: Any) -> None:
        """Send a value to a vehicle."""
        self._connection.send(number, value)

    def pass_on(self, number: int, data: bytes) -> None:
        """Send a value that is encoded already."""
        self._connection.send_encoded(number, data)

    def receive(self, timeout: float = LOOK_INTERVAL) -> tuple[int, Any] | None:
        """Return the next value of a vehicle, and its number; None if there is none in a time [s].

        A `VehicleError` says that one cannot go on.
        """
        return self._received.popleft() if self._received else self._receive(timeout)

    def _receive(self, timeout: float) -> tuple[int, Any] | None:
        try:
            received = self._connection.receive(timeout)
        except CodecError as error:
            raise VehicleError(str(error)) from error
        if received is None:
            return None
        number, value = received
        if isinstance(value, Hearing):
            self.new.append(number)
            if self.ids.get(number, value.process) != value.process:
                self._replaced.add(number)  # before its end was seen
            self.ids[number] = value.process
            return None
        if isinstance(value, Fault):
            raise VehicleError(f"vehicle {number}: {value.text}")
        return number, value


def check_memory(count: int) -> None:
    """Refuse more processes than memory allows."""
    free = _free_memory()
    fits = int(free // PROCESS_MEMORY)
    if count > fits:
        need, there = count * PROCESS_MEMORY / 1e9, free / 1e9
        reason = f"{count} processes take about {need:.1f} GB of memory, and {there:.1f} GB is free"
        raise InputError("swarm.agents", f"{reason}; {max(fits, 1)} would do")


def _free_memory() -> float:
    with suppress(OSError, StopIteration):
        lines = MEMINFO.read_text().splitlines()
        text = next(line for line in lines if line.startswith("MemAvailable"))
        return min(float(text.split()[1]) * 1024, machine_memory())
    return machine_memory()


def _context() -> Any:
    # Forking takes a tenth of a second, and libraries are loaded once.
    context = make_context(PRELOADED)
    if context.get_start_method() == "spawn":
        return context
    # Ctrl-C is for the world alone, which ends all others.
    resource_tracker.ensure_running()  # which unblocks it
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    forkserver.ensure_running()
    signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    return context
