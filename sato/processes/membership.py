"""Membership of a flight over processes: who has its key may speak.

The key is in a file that its owner alone can read, in a new folder for each flight, which the world
has locked. Beside it is a file for each vehicle, with the number of times that its process has been
started, which that has locked. So it is seen who is there: a lock ends with its process.
"""

import fcntl
import json
import os
import secrets
from hashlib import blake2b
from pathlib import Path
from time import sleep
from typing import NamedTuple

from sato.scenario.errors import InputError

HOST = "127.0.0.1"
KEY_FILE = "key"
TRIES = 3  # to lock a file, at which the world may look
LOOK_TIME = 0.01  # which that takes at most [s]


class Membership(NamedTuple):
    """Key of a flight, and the place of its world, as a process is told."""

    key: bytes
    endpoint: str  # at which the world listens, as Zenoh writes it
    vehicles: int


def create_key(folder: Path, mission: str, port: int | None, vehicles: int) -> Membership:
    """Write the key file of a new flight of a mission into a folder; the world calls this.

    Without a port, the world listens at a socket in the folder, which other users cannot open.
    """
    key = blake2b(mission.encode(), key=secrets.token_bytes(32), digest_size=32).digest()
    endpoint = f"tcp/{HOST}:{port}" if port else f"unixsock-stream/{folder / 'world'}"
    member = Membership(key, endpoint, vehicles)
    text = json.dumps(member._replace(key=key.hex())._asdict())  # type: ignore[arg-type]
    write_private(folder / KEY_FILE, text)
    return member


def read_key(file: Path, number: int) -> Membership:
    """Read a key file, for the vehicle of a number; an `InputError` refuses one of others."""
    try:
        with file.open(encoding="ascii") as opened:
            status = os.fstat(opened.fileno())
            if status.st_mode & 0o077 or status.st_uid != os.getuid():
                raise InputError("--key-file", f"{file} can be read by others; mode 600 would do")
            known = json.load(opened)
        key, vehicles = bytes.fromhex(known["key"]), int(known["vehicles"])
        member = Membership(key, str(known["endpoint"]), vehicles)
    except (OSError, ValueError, TypeError, KeyError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("--key-file", f"{file} is no key of a flight that goes on") from error
    if not 0 <= number < member.vehicles:
        reason = f"there is no vehicle {number}; they are 0 to {member.vehicles - 1}"
        raise InputError("NUMBER", reason)
    return member


class Incarnation:
    """Number of times that the process of a vehicle has been started, this one included.

    It is on the disk before anything is sent, so that a vehicle that starts again is believed, and
    none is there twice: an `InputError` says that one is.
    """

    def __init__(self, key_file: Path, number: int) -> None:
        self._file = os.open(key_file.parent / str(number), os.O_RDWR | os.O_CREAT, 0o600)
        for tries in range(TRIES, 0, -1):
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except OSError as error:
                if tries == 1:
                    reason = f"the process of vehicle {number} is there already"
                    raise InputError("", reason) from error
                sleep(LOOK_TIME)
        before = os.read(self._file, 20)
        self.number = int(before or b"0") + 1
        os.lseek(self._file, 0, os.SEEK_SET)
        os.write(self._file, str(self.number).encode())
        os.fsync(self._file)


def write_private(path: Path, text: str) -> None:
    """Write a new file that its owner alone can read."""
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(file, "w", encoding="ascii") as opened:
        opened.write(text)
