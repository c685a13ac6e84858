"""Connections of the world and the vehicles, by Zenoh over the loopback interface."""

import json
import socket
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any

from sato.processes.codec import CodecError, decode, encode
from sato.processes.envelope import MAX_SIZE, WORLD, Envelopes
from sato.processes.membership import Membership
from sato.scenario.errors import InputError

INSTALL = "pip install 'sato-swarm[network]'"
HOST = "127.0.0.1"
LEASE = 24 * 3_600_000  # time for which a paused process is waited for [ms]
MAX_WAITING = 10_000  # messages that are received and not yet read
USER = "sato"  # name under which all of a flight are let in


def load_zenoh() -> Any:
    """Import Zenoh; an `InputError` says how it is installed."""
    try:
        import zenoh
    except ImportError as error:
        raise InputError("", f"--processes needs Zenoh: {INSTALL}") from error
    return zenoh


def find_port(wanted: int | None) -> int:
    """Return a port that is free: the wanted one, or any; refuse one that is in use."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, wanted or 0))
        except OSError as error:
            cure = "another one, or none, for any that is free, would do"
            reason = f"--port {wanted} cannot be used: {error.strerror}; {cure}"
            raise InputError("", reason) from error
        return int(probe.getsockname()[1])


class Connection:
    """Connection of the world, or of a vehicle, which hears what is addressed to it.

    A vehicle is heard by the world alone, which passes its messages on to those within hearing.
    Those who do not know the key are not let in, and messages without its tag are dropped.

    Args:
        member: Key of the flight, and its port.
        number: Number of the vehicle; that of the world, which listens.
        incarnation: Number of times that the process of the vehicle has been started.
        users: File of the passwords of those who are let in, of the world.
    """

    def __init__(
        self, member: Membership, number: int, incarnation: int, users: Path | None = None
    ) -> None:
        zenoh, is_world, port = load_zenoh(), number == WORLD, member.port
        config = zenoh.Config()
        for key, value in {
            "mode": "peer" if is_world else "client",
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "listen/endpoints" if is_world else "connect/endpoints": [f"tcp/{HOST}:{port}"],
            "connect/timeout_ms": 2000,
            "transport/link/tx/lease": LEASE,
            "transport/link/rx/max_message_size": MAX_SIZE,
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
            raise InputError("", f"port {port}: {what} ({error})") from error
        heard = range(member.vehicles) if is_world else (WORLD,)
        self._envelopes = Envelopes(member.key, number, incarnation, heard)
        self._options = {"congestion_control": zenoh.CongestionControl.BLOCK, "express": True}
        self._received: SimpleQueue[tuple[int, bytes]] = SimpleQueue()
        self._prefix = f"sato/{port}/to"
        incoming = f"{self._prefix}/{number}"
        self._session.declare_subscriber(incoming, zenoh.handlers.Callback(self._receive))

    def _receive(self, sample: Any) -> None:
        opened = self._envelopes.open(sample.payload.to_bytes())
        if opened is not None and self._received.qsize() < MAX_WAITING:
            self._received.put(opened)

    def send(self, to: int, value: Any) -> None:
        """Send a value to a vehicle, or to the world."""
        self.send_encoded(to, encode(value))

    def send_encoded(self, to: int, data: bytes) -> None:
        """Send a value that is encoded already."""
        self._session.put(f"{self._prefix}/{to}", self._envelopes.seal(to, data), **self._options)

    def receive(self, timeout: float) -> tuple[int, Any] | None:
        """Return the sender and the next value; None if there is none within a time [s].

        Anything that is no message is dropped.
        """
        try:
            sender, data = self._received.get(timeout=timeout)
        except Empty:
            return None
        try:
            return sender, decode(data)
        except CodecError:
            return None

    def close(self) -> None:
        """Close the connection."""
        self._session.close()
