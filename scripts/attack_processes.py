"""Attack flights over processes from another local process, and tell what it did to them.

Strangers know the port: they send bytes, and ask Zenoh to let them in. Insiders have the password,
hear all, and send messages that are mutated, replayed, of others, or large. Liars are vehicles that
send messages with a wrong field. Exit 1 where anything is accepted, ends a flight, takes over
50 MiB more, or changes a flight in lock step.

    python scripts/attack_processes.py --count 100000 --small 1000000 --large 20 --lies 200
    python scripts/attack_processes.py --cost
"""

import json
import os
import random
import resource
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from time import monotonic, process_time, sleep, thread_time
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
import zenoh

import sato
from sato.processes.codec import CodecError, decode, encode
from sato.processes.envelope import OVERHEAD, TAG_SIZE, VERSION, WORLD, Envelopes
from sato.processes.fleet import VehicleError
from sato.processes.membership import HOST, Membership, create_key, read_key
from sato.processes.network import PREFIX, USER, Connection
from sato.processes.vehicle_process import VehicleConnection

WATCHED = "SATO_WATCHED"  # variable of the environment: folder of the notes of a flight
HEAD = struct.Struct("<BHIQ")  # version, sender, incarnation, counter
NOTE = struct.Struct("<c8sHIQddQ")  # opened or sealed, digest, sender, incarnation, counter, times
MORE = 50 * 2**20  # of memory, that an attack may take [byte]
LONGEST = 180.0  # of a flight, after it is no longer attacked [s]
SIZES = 1_900_000, 2_100_000, 100_000_000  # of large messages [byte]
LOCK_STEP = ("crossing", "leg.0.steps=200")
TIMED = "plan.horizon_steps=8", "plan.replan_steps=4", "plan.auction_steps=8", "link.round_s=0.02"
FREE = ("crossing", *TIMED)
ODD: list[Any] = [
    None, True, -1, 0, 1, 7, 2**62, -(2**62), 0.5, float("nan"), float("inf"), -1e300, "", "x", b"",
    (), [], {}, (1, 2), ("a",) * 9, {"kind": 1}, ({},), frozenset(), np.zeros(0), np.ones(3),
    np.zeros((2, 2)), np.full(2, np.nan), np.full((3, 2), np.inf), np.full((4, 2), 1e200),
    np.arange(2), np.zeros((1, 1, 1)),
]  # fmt: skip


def watch(folder: Path) -> None:
    """Note all envelopes that this process opens or seals, and what that takes; lie if asked to."""
    refused = [0]

    def note(kind: bytes, data: bytes, spent: float) -> None:
        digest = blake2b(data, digest_size=8).digest()
        head = HEAD.unpack_from(data)[1:]
        line = NOTE.pack(kind, digest, *head, spent, process_time(), refused[0])
        with (folder / f"{os.getpid()}.log").open("ab") as file:
            file.write(line)

    plain_open, plain_seal = Envelopes.open, Envelopes.seal

    def open_watched(self: Envelopes, data: bytes) -> Any:
        before = thread_time()
        opened = plain_open(self, data)
        spent = thread_time() - before
        if opened is None:
            refused[0] += 1
        else:
            note(b"o", data, spent)
        return opened

    def seal_watched(self: Envelopes, *told: Any) -> bytes:
        before = thread_time()
        data = plain_seal(self, *told)
        note(b"s", data, thread_time() - before)
        return data

    Envelopes.open, Envelopes.seal = open_watched, seal_watched  # type: ignore[method-assign]
    if (folder / "lie").exists():
        number, seed, place = json.loads((folder / "lie").read_text())
        VehicleConnection.send = make_liar(number, seed, place)  # type: ignore[method-assign]


def make_liar(number: int, seed: int, place: int) -> Callable[..., None]:
    """Make the sending of a vehicle of a number that lies from a message on."""
    rng, count = random.Random(seed), [0]

    def send(self: VehicleConnection, to: int, value: Any) -> None:
        count[0] += 1
        if self._envelopes._own == number and count[0] >= place:
            value = lie(rng, value)
        with suppress(CodecError):  # it lies what can be sent
            Connection.send(self, to, value)

    return send


def lie(rng: random.Random, value: Any) -> Any:
    """Return a value with another in one of its fields, or in the place of all."""
    if isinstance(value, bytes) and value:
        with suppress(CodecError):
            return encode(lie(rng, decode(value)))
    if isinstance(value, tuple) and value and rng.random() < 0.85:
        changed = list(value)
        place = rng.randrange(len(changed))
        changed[place] = lie(rng, changed[place])
        return type(value)(*changed) if hasattr(value, "_fields") else tuple(changed)
    if isinstance(value, frozenset) and value and rng.random() < 0.85:
        members = list(value)
        with suppress(TypeError):
            return frozenset([lie(rng, members.pop(rng.randrange(len(members)))), *members])
    if isinstance(value, np.ndarray) and value.size and rng.random() < 0.5:
        changed_array = value.copy()
        changed_array.flat[rng.randrange(value.size)] = rng.choice([0, -1, 1, 100])
        return changed_array
    return rng.choice(ODD)


class Flight:
    """Flight over processes that is watched.

    Args:
        folder: Folder for the run and the notes.
        mode: Option of `sato run`.
        scenario: Name, and changes.
        port: At which the world listens, as only the owner can open the socket else.
    """

    def __init__(self, folder: Path, mode: str, scenario: tuple[str, ...], port: int) -> None:
        folder.mkdir()
        self.folder, changes = folder, [w for change in scenario[1:] for w in ("--set", change)]
        command = [sys.executable, __file__, "run", scenario[0], mode, "--port", str(port)]
        self.process = subprocess.Popen(
            [*command, "--out", str(folder / "run"), *changes],
            env=os.environ | {WATCHED: str(folder)}, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        self.text, self.peak = "", dict[int, int]()  # most memory of each process [byte]
        self.member: Membership | None = None
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.text += line
            if "the key of the flight is in" in line:
                numbers = [part.split(": ")[-1] for part in line.split(";")[0].split(", ")]
                member = read_key(Path(line.split(" is in ")[1].strip()), 0)
                self.peak = dict.fromkeys([*map(int, numbers), self.process.pid], 0)
                self.member = member

    def is_going_on(self) -> bool:
        """Note the memory of all processes, and tell whether the flight goes on."""
        for number in self.peak:
            with suppress(OSError, StopIteration):
                lines = Path(f"/proc/{number}/status").read_text().splitlines()
                peak = next(line for line in lines if line.startswith("VmHWM"))
                self.peak[number] = int(peak.split()[1]) * 1024
        return self.process.poll() is None

    def wait_for_key(self) -> Membership | None:
        """Wait until all vehicles are there; None where the flight ends before."""
        while self.member is None and self.is_going_on():
            sleep(0.01)
        return self.member

    def end(self) -> str:
        """Wait for the end of the flight; return what is wrong about it."""
        until = monotonic() + LONGEST
        while self.is_going_on() and monotonic() < until:
            sleep(0.02)
        is_late = self.process.poll() is None
        if is_late:
            self.process.kill()
        self.process.wait()
        self._reader.join()
        if is_late:
            return "the flight hangs"
        is_told = "Traceback" in self.text or "fault of the program" in self.text
        is_wrong = is_told or self.process.returncode or "KEPT" not in self.text
        told = [x for x in self.text.splitlines() if x[:1].isalpha()]
        return " / ".join(told) if is_wrong else ""

    def read_notes(self) -> dict[int, list[tuple[Any, ...]]]:
        """Return the notes of each process."""
        logs = self.folder.glob("*.log")
        return {int(log.stem): list(NOTE.iter_unpack(log.read_bytes())) for log in logs}

    def read_record(self) -> dict[str, bytes]:
        """Return the bytes of each variable of the record."""
        data = sato.load(self.folder / "run").data
        return {str(name): values.values.tobytes() for name, values in data.variables.items()} | {
            "event": repr(data["event"].values.tolist()).encode()
        }


def connect(endpoint: str, user: str | None, password: str, mode: str = "client") -> Any:
    """Ask Zenoh to let one in."""
    config = zenoh.Config()
    settings: dict[str, Any] = {"mode": mode, "connect/endpoints": [endpoint]}
    settings |= {"connect/timeout_ms": 300, "scouting/multicast/enabled": False}
    settings |= {"listen/endpoints": [], "connect/exit_on_failure": True}
    if user is not None:
        settings |= {
            f"transport/auth/usrpwd/{k}": v for k, v in (("user", user), ("password", password))
        }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


class Strangers(threading.Thread):
    """Those who know only the port, from before the flight begins until it ends."""

    def __init__(self, port: int, seed: int) -> None:
        super().__init__()
        self.port, self.rng, self.is_over = port, random.Random(seed), False
        self.sent, self.asked, self.let_in = 0, 0, 0
        self._held: deque[socket.socket] = deque()

    def run(self) -> None:
        """Send bytes, leave connections open, and ask to be let in."""
        greeting = record_greeting()
        while not self.is_over:
            for _ in range(20):
                with suppress(OSError):
                    self._send(greeting)
            self._ask()
        for opened in self._held:
            opened.close()

    def _send(self, greeting: bytes) -> None:
        opened, rng = socket.create_connection((HOST, self.port), 0.2), self.rng
        opened.settimeout(0.2)
        choice = rng.randrange(4)
        data = mutate(rng, greeting) if choice else rng.randbytes(rng.randrange(1, 4000))
        if choice == 1:
            data = greeting + rng.randbytes(rng.choice([10, 1000, 60_000]))
        if choice == 2 and rng.random() < 0.01:
            data = greeting + bytes(100_000_000)
        opened.sendall(data)
        self.sent += 1
        self._held.append(opened)
        if len(self._held) > 150:
            self._held.popleft().close()

    def _ask(self) -> None:
        user = self.rng.choice([None, USER, "root", ""])
        self.asked += 1
        with suppress(zenoh.ZError):
            mode = self.rng.choice(["client", "peer"])
            session = connect(f"tcp/{HOST}:{self.port}", user, self.rng.randbytes(16).hex(), mode)
            if list(session.info.peers_zid()) + list(session.info.routers_zid()):
                self.let_in += 1
            session.close()


def record_greeting() -> bytes:
    """Return the first bytes by which Zenoh asks to be let in."""
    with socket.socket() as listener:
        listener.bind((HOST, 0))
        listener.listen()

        def ask() -> None:
            with suppress(zenoh.ZError):
                connect(f"tcp/{HOST}:{listener.getsockname()[1]}", USER, "x")

        asking = threading.Thread(target=ask)
        asking.start()
        opened, _ = listener.accept()
        with opened:
            greeting = opened.recv(4096)
        asking.join()
        return greeting


def find_port() -> int:
    """Return a port that is free."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


Forged = tuple[int, bytes]  # receiver, and envelope


def seal(key: bytes, head: tuple[int, int, int, int], receiver: int, content: bytes) -> bytes:
    """Seal an envelope with any version, sender, incarnation and counter."""
    data, person = HEAD.pack(*head) + content, struct.pack("<HI", receiver, 1)
    return data + blake2b(data, key=key, digest_size=TAG_SIZE, person=person).digest()


def mutate(rng: random.Random, data: bytes) -> bytes:
    """Change some bytes."""
    changed = bytearray(data)
    for _ in range(rng.randrange(1, 6)):
        place, choice = rng.randrange(len(changed) or 1), rng.randrange(4)
        if choice == 0:
            del changed[place : place + rng.randrange(1, 9)]
        elif choice == 1:
            changed[place:place] = rng.randbytes(rng.randrange(1, 9))
        elif changed:
            changed[place % len(changed)] ^= rng.randrange(1, 256)
    return bytes(changed)


KEYED = (
    "of another version", "of a sender that is not there", "to another receiver", "older",
    "of an older incarnation",
)  # fmt: skip


def forge(
    rng: random.Random, member: Membership, other: bytes, receiver: int, data: bytes
) -> tuple[str, bytes]:
    """Draw a kind, and make such an envelope of one that was sent; some have the right key."""
    version, sender, incarnation, count = HEAD.unpack_from(data)
    content, later = data[HEAD.size : -TAG_SIZE], count + rng.randrange(1, 1000)
    kind = rng.choice(["mutated", "truncated", "replayed", "noise", "of another mission", *KEYED])
    if kind == "mutated":
        return kind, mutate(rng, data)
    if kind == "truncated":
        return kind, data[: rng.randrange(len(data))]
    if kind == "replayed":
        return kind, data
    if kind == "noise":
        return kind, rng.randbytes(rng.randrange(2000))
    key = other if kind == "of another mission" else member.key
    if kind == "of another version":
        version = rng.choice([0, VERSION + 1, 255])
    elif kind == "of a sender that is not there":
        sender = rng.randrange(member.vehicles, WORLD)
    elif kind == "to another receiver":
        receiver ^= 1
    elif kind == "older":
        later, content = rng.randrange(count), mutate(rng, content)
    elif kind == "of an older incarnation":
        incarnation = 0
    return kind, seal(key, (version, sender, incarnation, later), receiver, content)


def feed(count: int, seed: int) -> int:
    """Feed envelopes that are forged from those of a flight to its ends; return those accepted."""
    rng, vehicles, kinds, accepted = random.Random(seed), 3, Counter[str](), Counter[str]()
    key, other = rng.randbytes(32), rng.randbytes(32)
    member = Membership(key, "", vehicles)
    ends = {i: Envelopes(key, i, 1, [WORLD]) for i in range(vehicles)}
    ends[WORLD] = Envelopes(key, WORLD, 1, range(vehicles))
    heard = deque[Forged](maxlen=1000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    while kinds.total() < count:
        number, content = rng.randrange(vehicles), rng.randbytes(rng.randrange(3000))
        for sender, receiver in ((number, WORLD), (WORLD, number)):
            data = ends[sender].seal(receiver, content)
            assert ends[receiver].open(data) == (sender, content)
            heard.append((receiver, data))
        for _ in range(20):
            receiver, data = rng.choice(heard)
            kind, forged = forge(rng, member, other, receiver, data)
            kinds[kind] += 1
            to = [receiver] if kind in KEYED else ends
            accepted[kind] += any(ends[end].open(forged) is not None for end in to)
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    for size in SIZES:
        accepted["large"] += any(end.open(data + bytes(size)) is not None for end in ends.values())
    print(f"fed {dict(kinds)}: {accepted.total()} accepted, {more:.0f} MiB more", flush=True)
    return accepted.total()


class Insider:
    """One who has the password, hears all, and sends what is no message of the flight."""

    def __init__(self, member: Membership, seed: int) -> None:
        self.member, self.rng, self.kinds = member, random.Random(seed), Counter[str]()
        self.session = connect(member.endpoint, USER, member.key.hex())
        self.heard = deque[Forged](maxlen=5000)
        remote = {"allowed_origin": zenoh.Locality.REMOTE}
        self.session.declare_subscriber(f"{PREFIX}/*", self._hear, **remote)
        self.forged, self.tokens = set[bytes](), 0
        with tempfile.TemporaryDirectory() as folder:
            self.other = create_key(Path(folder), "another mission", None, 2).key

    def _hear(self, sample: Any) -> None:
        receiver, data = int(str(sample.key_expr).rpartition("/")[2]), sample.payload.to_bytes()
        self.heard.append((receiver, data))

    def send(self, to: int | str, data: bytes, kind: str) -> None:
        """Send bytes to a vehicle or the world, and keep their digest."""
        if kind not in ("replayed", "older"):  # of which the counters tell
            self.forged.add(blake2b(data, digest_size=8).digest())
        self.kinds[kind] += 1
        self.session.put(f"{PREFIX}/{to}", data, congestion_control=zenoh.CongestionControl.BLOCK)

    def send_forged(self) -> None:
        """Send one that was drawn."""
        heard = list(self.heard)[-50:] if self.rng.random() < 0.5 else self.heard
        receiver, data = self.rng.choice(heard)
        kind, forged = forge(self.rng, self.member, self.other, receiver, data)
        if kind == "replayed" or forged != data:
            to = receiver if kind in KEYED else self.rng.choice([receiver, "*", WORLD, 0])
            self.send(to, forged, kind)

    def send_small(self) -> None:
        """Send a few bytes."""
        data = self.rng.randbytes(self.rng.randrange(60))
        self.send(self.rng.choice([WORLD, WORLD, 0, "*"]), data, "small")

    def send_large(self) -> None:
        """Send one of each size, and declare tokens of presence."""
        for size in SIZES:
            receiver, data = self.rng.choice(self.heard)
            self.send(receiver, data + bytes(size - len(data)), f"of {size // 10**6} MB")
        for name in ("world", WORLD, 0, 1):
            token = self.session.liveliness().declare_token(f"sato/here/{name}")
            token.undeclare()
            self.tokens += 1


class Result(NamedTuple):
    """Outcome of one flight."""

    wrong: str
    refused: int
    accepted: int
    peak: list[int]
    sent: Counter[str]


def count_accepted(notes: dict[int, list[tuple[Any, ...]]], forged: set[bytes]) -> int:
    """Count what was opened though it was forged, or is no newer than what came from its sender."""
    accepted = 0
    for rows in notes.values():
        newest = dict[int, tuple[int, int]]()
        for _, digest, sender, *counter, _, _, _ in (row for row in rows if row[0] == b"o"):
            is_newer = tuple(counter) > newest.get(sender, (-1, -1))
            accepted += digest in forged or not is_newer
            newest[sender] = max(tuple(counter), newest.get(sender, (-1, -1)))
    return accepted


def attack(flight: Flight, how: str, seed: int, strangers: Strangers | None) -> Result:
    """Attack a flight to its end."""
    insider, sent = None, Counter[str]()
    member = flight.wait_for_key()
    if member is not None and how != "none":
        with suppress(zenoh.ZError):  # the flight is over already
            insider = Insider(member, seed)
    while insider is not None and flight.is_going_on():
        if not insider.heard:
            sleep(0.001)
            continue
        for _ in range(1 if how == "large" else 200):
            getattr(insider, f"send_{how}")()
    wrong = flight.end()
    if strangers is not None:
        strangers.is_over = True
        strangers.join()
        sent |= {"of strangers": strangers.sent, "asked to be let in": strangers.asked}
        wrong += "; a stranger was let in" * bool(strangers.let_in)
    notes = flight.read_notes()
    accepted = count_accepted(notes, insider.forged if insider is not None else set())
    if insider is not None:
        sent |= insider.kinds | Counter({"tokens": insider.tokens})
        with suppress(zenoh.ZError):
            insider.session.close()
    refused = sum(rows[-1][-1] for rows in notes.values())
    return Result(wrong, refused, accepted, sorted(flight.peak.values()), sent)


def attack_all(
    base: Path, mode: str, scenario: tuple[str, ...], asked: dict[str, int], seed: int
) -> int:
    """Attack flights of a mode until so many messages of each kind were refused; count faults."""
    undisturbed = Flight(base / f"alone{mode}", mode, scenario, find_port())
    alone = attack(undisturbed, "none", seed, None)
    print(f"{mode}: undisturbed: {alone.wrong or 'kept'}", flush=True)
    expected = None if mode == "--free-running" else undisturbed.read_record()
    faults, flights, total, sent = int(bool(alone.wrong)), 0, Counter[str](), Counter[str]()
    for how, count in asked.items():
        while total[how] < count:
            flights += 1
            port = find_port()
            strangers = Strangers(port, seed + flights)
            strangers.start()
            flight = Flight(base / f"{how}{mode}-{flights}", mode, scenario, port)
            result = attack(flight, how, seed + flights, strangers)
            large = sum(number for kind, number in result.sent.items() if kind.endswith(" MB"))
            total[how] += large if how == "large" else result.refused
            sent += result.sent
            more = sum(result.peak) - sum(alone.peak)
            wrong = judge(result, more, flight, expected)
            faults += len(wrong)
            told = f"{result.refused} refused, {more / 2**20:+.0f} MiB"
            print(f"{mode}: {how}: {told}: {'; '.join(wrong) or 'kept'}", flush=True)
    print(f"{mode}: {flights} flights, {dict(total)}; sent: {dict(sent)}", flush=True)
    return faults


def judge(
    result: Result, more: int, flight: Flight, expected: dict[str, bytes] | None
) -> list[str]:
    """List what is wrong about a flight that was attacked, also where its record differs."""
    if result.wrong:
        return [result.wrong]
    wrong = [f"{result.accepted} accepted"] if result.accepted else []
    wrong += [f"{more / 2**20:.0f} MiB more"] if more > MORE else []
    record = flight.read_record() if expected else {}
    differ = [name for name, value in (expected or {}).items() if record[name] != value]
    return wrong + ([f"another flight: {', '.join(differ)}"] if differ else [])


def fly_liars(base: Path, lies: int, seed: int) -> int:
    """Fly with a vehicle that lies, in both modes; count flights that end without a sentence."""
    os.environ[WATCHED], faults, told = str(base), 0, Counter[str]()
    for number in range(lies):
        rng = random.Random(f"{seed} {number}")
        is_free = number % 2
        (base / "lie").write_text(
            json.dumps([rng.randrange(2), rng.random(), rng.randrange(2, 60)])
        )
        name, *changes = FREE if is_free else rng.choice([("crossing",), FREE])
        mode = "free-running" if is_free else "lock-step"
        began, wrong = monotonic(), ""
        try:
            run = sato.run(name, overrides=changes, processes=mode, speed=10)
            stopped = str(run.data.attrs.get("stopped", ""))
            told[stopped[:70]] += 1
            if "fault" in stopped or "\n" in stopped or len(stopped) > 300:
                wrong = stopped
        except VehicleError as error:  # before anything was flown
            told[str(error)[:70]] += 1
        except Exception as error:
            wrong = f"no record: {type(error).__name__}: {error}"
        if monotonic() - began > LONGEST:
            wrong += f" takes {monotonic() - began:.0f} s"
        if wrong:
            faults += 1
            print(f"lie {number}, {mode}: {wrong}", flush=True)
    for text, count in told.most_common():
        print(f"{count:5} {text or '(the flight goes on)'}")
    return faults


def measure_cost(base: Path) -> int:
    """Fly ten vehicles in lock step; print what authentication takes of each and of a message."""
    scenario = ("random", "swarm.agents=10", "swarm.comm_radius_m=20", "leg.0.steps=60")
    flight = Flight(base / "cost", "--processes", scenario, find_port())
    result = attack(flight, "none", 0, None)
    assert flight.member is not None, flight.text
    notes = flight.read_notes()
    shares, messages = [], 0
    for number, rows in notes.items():
        if number == flight.process.pid or number not in flight.peak:
            continue
        shares.append(sum(row[5] for row in rows) / (rows[-1][6] - rows[0][6]))
        messages += len(rows)
    print(
        f"{len(shares)} vehicles, {messages} messages: authentication takes {np.mean(shares):.2%} "
        f"of a vehicle's processor time, {max(shares):.2%} at most; {OVERHEAD} bytes a message"
    )
    return int(bool(result.wrong) or max(shares) > 0.1 or OVERHEAD > 40)


def main(
    count: Annotated[int, typer.Option(help="Forged messages of insiders, in each mode.")] = 10_000,
    small: Annotated[int, typer.Option(help="Messages of a few bytes.")] = 20_000,
    large: Annotated[int, typer.Option(help="Messages of 2 to 100 MB.")] = 3,
    lies: Annotated[int, typer.Option(help="Flights with a vehicle that lies.")] = 10,
    seed: Annotated[int, typer.Option(help="Random seed.")] = 2026,
    cost: Annotated[bool, typer.Option("--cost", help="Measure authentication alone.")] = False,
) -> None:
    """Attack flights in both modes."""
    zenoh.init_log_from_env_or("off")
    with tempfile.TemporaryDirectory(prefix="attack-") as folder:
        base = Path(folder)
        if cost:
            sys.exit(measure_cost(base))
        asked = {"forged": count, "small": small, "large": large}
        faults = feed(max(count, 10_000), seed)
        faults += attack_all(base, "--processes", LOCK_STEP, asked, seed)
        faults += attack_all(base, "--free-running", FREE, asked, seed)
        faults += fly_liars(base, lies, seed)
    print(f"{faults} wrong")
    sys.exit(bool(faults))


if WATCHED in os.environ:  # in a process of a flight
    watch(Path(os.environ[WATCHED]))
if __name__ == "__main__":
    if WATCHED in os.environ:
        from sato.__main__ import main as run_sato

        run_sato()
    else:
        typer.run(main)
