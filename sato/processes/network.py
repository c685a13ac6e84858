"""Connections of the world and the vehicles, by Zenoh over the loopback interface."""

import socket
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any

from sato.processes.codec import CodecError, decode, encode
from sato.scenario.errors import InputError

INSTALL = "pip install 'sato-swarm[network]'"
HOST = "127.0.0.1"
LEASE = 24 * 3_600_000  # time for which a paused process is waited for [ms]
WORLD = "world"


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
    """

    def __init__(self, port: int, number: int | None = None) -> None:
        """Open a connection: of the world, which listens, or of the vehicle of a number."""
        zenoh, is_world = load_zenoh(), number is None
        config, own = zenoh.Config(), WORLD if is_world else str(number)
        for key, value in {
            "mode": '"peer"' if is_world else '"client"',
            "scouting/multicast/enabled": "false",
            "scouting/gossip/enabled": "false",
            "listen/endpoints" if is_world else "connect/endpoints": f'["tcp/{HOST}:{port}"]',
            "connect/timeout_ms": "2000",
            "transport/link/tx/lease": str(LEASE),
        }.items():
            config.insert_json5(key, value)
        zenoh.init_log_from_env_or("off")
        try:
            self._session = zenoh.open(config)
        except zenoh.ZError as error:
            what = "cannot be listened at" if is_world else "nobody listens there"
            raise InputError("", f"--port {port}: {what} ({error})") from error
        self._options = {"congestion_control": zenoh.CongestionControl.BLOCK, "express": True}
        self._received: SimpleQueue[tuple[str, bytes]] = SimpleQueue()
        self._prefix, self._own, self._gone = f"sato/{port}", own, zenoh.SampleKind.DELETE
        here = f"{self._prefix}/here/{own}"
        self.is_taken = any(True for _ in self._session.liveliness().get(here))
        self._token = self._session.liveliness().declare_token(here)
        incoming = f"{self._prefix}/to/{own}/from/*"
        self._session.declare_subscriber(incoming, zenoh.handlers.Callback(self._receive))

    def _receive(self, sample: Any) -> None:
        self._received.put((str(sample.key_expr).split("/")[-1], sample.payload.to_bytes()))

    def send(self, to: int | str, value: Any) -> None:
        """Send a value to a vehicle, or to the world."""
        self.send_encoded(to, encode(value))

    def send_encoded(self, to: int | str, data: bytes) -> None:
        """Send a value that is encoded already."""
        key = f"{self._prefix}/to/{to}/from/{self._own}"
        self._session.put(key, data, **self._options)

    def receive(self, timeout: float | None) -> tuple[str, Any] | None:
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

    def watch(self, others: str, when_gone: Callable[[str], object]) -> None:
        """Call a function, in another thread, with the name of each of some others that is gone.

        The others are the number of a vehicle, "*" for all, or the world.
        """

        def change(sample: Any) -> None:
            if sample.kind == self._gone:
                when_gone(str(sample.key_expr).split("/")[-1])

        liveliness = self._session.liveliness()
        liveliness.declare_subscriber(f"{self._prefix}/here/{others}", change, history=True)

    def close(self) -> None:
        """Close the connection."""
        self._session.close()
