"""Envelopes of messages: who has sent one, to whom, and that it has not come before.

An envelope is the version, the sender, its incarnation, a counter, the content, and a tag of keyed
BLAKE2 over all of these, the receiver and its incarnation. Anything without the right tag, or that
has come before, also to a process of the receiver that has ended, is no message.
"""

import struct
from collections.abc import Collection
from hashlib import blake2b
from hmac import compare_digest

VERSION = 1
WORLD = 0xFFFF  # number of the world as a sender or a receiver
TAG_SIZE = 16
MAX_SIZE = 2_000_000  # of a message [byte]
_HEAD, _RECEIVER = struct.Struct("<BHIQ"), struct.Struct("<HI")
OVERHEAD = _HEAD.size + TAG_SIZE


class Envelopes:
    """Writer and reader of envelopes, at one end of a connection.

    Args:
        key: Key of the flight.
        own: Number of this end.
        incarnation: Number of times that this end has been started.
        heard: Numbers of those that this end listens to.
    """

    def __init__(self, key: bytes, own: int, incarnation: int, heard: Collection[int]) -> None:
        self._key, self._own, self._incarnation, self._heard = key, own, incarnation, heard
        self._count = 0
        self._last: dict[int, tuple[int, int]] = {}  # incarnation and counter of each sender

    def seal(self, receiver: int, content: bytes) -> bytes:
        """Put content for a receiver into an envelope; a `ValueError` refuses what is too large."""
        if len(content) > MAX_SIZE - OVERHEAD:
            raise ValueError(f"a message of {len(content):,} bytes is more than {MAX_SIZE:,}")
        self._count += 1
        data = _HEAD.pack(VERSION, self._own, self._incarnation, self._count) + content
        started = self._last.get(receiver, (1, 0))[0]  # the world is, once
        return data + self._tag(receiver, started, data)

    def open(self, data: bytes) -> tuple[int, bytes] | None:
        """Return the sender and the content of an envelope; None for anything else."""
        if not OVERHEAD <= len(data) <= MAX_SIZE:
            return None
        signed, tag = data[:-TAG_SIZE], data[-TAG_SIZE:]
        version, sender, *place = _HEAD.unpack_from(data)
        if version != VERSION or sender not in self._heard:
            return None
        if not compare_digest(tag, self._tag(self._own, self._incarnation, signed)):
            return None
        if tuple(place) <= self._last.get(sender, (0, 0)):
            return None
        self._last[sender] = tuple(place)
        return sender, signed[_HEAD.size :]

    def _tag(self, receiver: int, incarnation: int, data: bytes) -> bytes:
        person = _RECEIVER.pack(receiver, incarnation)
        return blake2b(data, key=self._key, digest_size=TAG_SIZE, person=person).digest()
