"""Connections of the world and the vehicles, by Zenoh, at a socket or the loopback interface."""

import json
import socket
from collections import Counter
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from sato.processes.codec import CodecError, decode, encode
from sato.processes.envelope import MAX_SIZE, WORLD, Envelopes
from sato.processes.membership import HOST, Membership
from sato.scenario.errors import InputError

INSTALL = "pip install 'sato-swarm[network]'"
LEASE = 24 * 3_600_000  # time for which a paused process is waited for [ms]
START_TIME = 60.0  # within which all processes are there [s]
CONNECT_TIME = 15.0  # after which a vehicle ends that finds no world, as where it was killed [s]
ACCEPT_TIME = 2.0  # within which those who connect say who they are [s]
MAX_WAITING = 4 * MAX_SIZE  # of the messages of each sender that are not yet read [byte]
PREFIX = "sato/to"  # of what is sent, before the number of the receiver
USER = "sato"  # name under which all of a flight are let in


def load_zenoh() -> Any:
    """Import Zenoh; an `InputError` says how it is installed."""
    try:
        import zenoh
    except ImportError as error:
        raise InputError("", f"--processes needs Zenoh: {INSTALL}") from error
    return zenoh


def check_port(wanted: int) -> None:
    """Refuse a port that is in use."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, wanted))
        except OSError as error:
            cure = "another one, or none, for a socket that no other user can open, would do"
            reason = f"--port {wanted} cannot be used: {error.strerror}; {cure}"
            raise InputError("", reason) from error


class Connection:
    """Connection of the world, or of a vehicle, which hears what is addressed to it.

    A vehicle is heard by the world alone, which passes its messages on to those within hearing.
    Those who do not know the key are not let in, and messages without its tag are dropped.

    Args:
        member: Key of the flight, and its place.
        number: Number of the vehicle; that of the world, which listens.
        incarnation: Number of times that the process of the vehicle has been started.
        users: File of the passwords of those who are let in, of the world.
    """

    def __init__(
        self, member: Membership, number: int, incarnation: int, users: Path | None = None
    ) -> None:
        zenoh, is_world, place = load_zenoh(), number == WORLD, member.endpoint
        config = zenoh.Config()
        for key, value in {
            "mode": "peer" if is_world else "client",
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "listen/endpoints" if is_world else "connect/endpoints": [place],
            "connect/timeout_ms": int(CONNECT_TIME * 1000),
            "connect/retry": {"period_init_ms": 100, "period_max_ms": 500},
            "transport/unicast/accept_timeout": int(ACCEPT_TIME * 1000),
            "transport/link/tx/lease": LEASE,
            "transport/link/rx/max_message_size": MAX_SIZE,
            "transport/shared_memory/enabled": False,  # which a stranger could fill
            "transport/auth/usrpwd/user": USER,
            "transport/auth/usrpwd/password": member.key.hex(),
            "transport/auth/usrpwd/dictionary_file": None if users is None else str(users),
        }.items():
            if value is not None:
                config.insert_json5(key, json.dumps(value))
        zenoh.init_log_from_env_or("off")
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            what = "cannot be listened at" if is_world else "nobody of this flight listens there"
            raise InputError("", f"{place}: {what} ({error})") from error
        heard = range(member.vehicles) if is_world else (WORLD,)
        self._envelopes = Envelopes(member.key, number, incarnation, heard)
        self._options = {"congestion_control": zenoh.CongestionControl.BLOCK, "express": True}
        self._received: SimpleQueue[tuple[int, bytes]] = SimpleQueue()
        self._put, self._taken = Counter[int](), Counter[int]()  # of each sender [byte]
        self._failure = zenoh.ZError
        incoming = f"{PREFIX}/{number}"
        self._session.declare_subscriber(incoming, zenoh.handlers.Callback(self._receive))

    def _receive(self, sample: Any) -> None:
        opened = self._envelopes.open(sample.payload.to_bytes())
        if opened is None:
            return
        sender, size = opened[0], len(opened[1])
        if self._put[sender] - self._taken[sender] + size <= MAX_WAITING:
            self._put[sender] += size
            self._received.put(opened)

    def send(self, to: int, value: Any) -> None:
        """Send a value to a vehicle, or to the world."""
        self.send_encoded(to, encode(value))

    def send_encoded(self, to: int, data: bytes) -> None:
        """Send a value that is encoded already."""
        self._session.put(f"{PREFIX}/{to}", self._envelopes.seal(to, data), **self._options)

    def receive(self, timeout: float) -> tuple[int, Any] | None:
        """Return the sender and the next value; None if there is none within a time [s].

        A `CodecError` says that a sender, which has the key, has sent what is none.
        """
        try:
            sender, data = self._received.get(timeout=timeout)
        except Empty:
            return None
        self._taken[sender] += len(data)
        try:
            return sender, decode(data)
        except CodecError as error:
            who = "the world" if sender == WORLD else f"vehicle {sender}"
            raise CodecError(f"{who} sends what {error}") from error

    def close(self) -> None:
        """Close the connection; one that a stranger holds open lasts, and is no fault."""
        with suppress(self._failure):
            self._session.close()
