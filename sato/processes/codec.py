"""Encoding of messages: plain values, arrays, and named tuples and dataclasses of a fixed list.

A value is a byte that tells its type, and its content; lengths and numbers are little-endian. An
array is its type, its shape and its numbers as they are in memory. A named tuple or dataclass is
its place in the list of types, and its fields in order, which are checked as its annotations say:
types, shapes, and that numbers are finite. Members of a set, reports that are passed
on from round to round, have their lengths before them, and are encoded and decoded once. Nothing is
called by name, as a pickle can ask for. Sense is not checked.
"""

import struct
from collections.abc import Callable, Hashable, Iterable
from dataclasses import fields, is_dataclass
from functools import cache, lru_cache
from itertools import chain
from math import inf, prod
from pkgutil import resolve_name
from typing import Any, get_type_hints

import numpy as np
from annotated_types import Ge, Le
from numpy import ndarray as Array

from dynamics.door_checks import Check, NumberRule, Sizes, Wrong, describe, make_check
from dynamics.inputs import InputError

# Types that vehicles and the world send each other. Both ends have the same version.
TYPES = """
    problems.drifts:Drifts
    problems.obstacle_paths:ObstaclePaths
    sato.auctions.bidder:WinningBids
    sato.network.flooding:CensusMessage
    sato.network.synchronous_agent:Packet
    sato.obstacles:Box
    sato.obstacles:Ellipsoid
    sato.obstacles:Polytope
    sato.obstacles:Sphere
    sato.processes.messages:Alive
    sato.processes.messages:Briefing
    sato.processes.messages:Call
    sato.processes.messages:Consent
    sato.processes.messages:Fault
    sato.processes.messages:Hearing
    sato.processes.messages:Held
    sato.processes.messages:Intention
    sato.processes.messages:Measured
    sato.processes.messages:FreePacket
    sato.processes.messages:Reply
    sato.processes.messages:Status
    sato.reconfiguration.agent_inputs:AgentMessage
    sato.reconfiguration.agent_inputs:AgentPacket
    sato.reconfiguration.agent_stages:AuctionReport
    sato.reconfiguration.agent_stages:AuctionTerms
    sato.reconfiguration.agent_stages:BiddingMessage
    sato.reconfiguration.agent_stages:ChoiceReport
    sato.reconfiguration.agent_stages:CommittedMessage
    sato.reconfiguration.agent_stages:ExchangeMessage
    sato.reconfiguration.agent_stages:ExchangeReport
    sato.reconfiguration.agent_stages:OfferMessage
    sato.reconfiguration.census:Hello
    sato.reconfiguration.evasion:EvasionReport
    sato.reconfiguration.halfway_stages:BendingMessage
    sato.reconfiguration.stopping:Commitment
    sato.scp.bending:PathMessage
    sato.scp.planner:TrajectoryMessage
""".split()

IN_RANGE = NumberRule(limits=(Ge(-inf), Le(inf)))  # as small or large as they like, but finite
MAX_DEPTH = 32  # of values within values
MAX_KEPT = 4096  # members of sets, encoded or decoded
_TAGS: dict[type, bytes] = {tuple: b"t", list: b"l", dict: b"d"}
NUMBERS = "<f8 <f4 <i8 <i4 <i2 |i1 |u1 |b1".split()  # types of arrays


class CodecError(ValueError):
    """A value that cannot be sent, or bytes that are no message."""


def encode(value: Any) -> bytes:
    """Encode a value; a `CodecError` refuses types that are not on the list."""
    out = bytearray()
    _write(out, value)
    return bytes(out)


def decode(data: bytes) -> Any:
    """Decode a value; a `CodecError` refuses bytes that are none."""
    try:
        return _Reader(data).read_all(0)
    except CodecError:
        raise
    except (ValueError, TypeError, struct.error, OverflowError, MemoryError) as error:
        raise CodecError(f"is no message: {error}") from error


@cache
def _registry() -> tuple[dict[type, int], tuple[type, ...]]:
    kinds = tuple(resolve_name(name) for name in TYPES)
    return {kind: n for n, kind in enumerate(kinds)}, kinds


@cache
def _field_names(kind: type) -> tuple[str, ...]:
    if is_dataclass(kind):
        return tuple(field.name for field in fields(kind))
    return tuple(getattr(kind, "_fields"))  # noqa: B009


@cache
def _field_checks(kind: Any) -> dict[str, Check]:
    hints = get_type_hints(kind, include_extras=True)
    return {name: make_check(hints[name], IN_RANGE) for name in _field_names(kind)}


def _write(out: bytearray, value: Any) -> None:
    place = _registry()[0].get(type(value))
    if place is not None:
        out += struct.pack("<cB", b"r", place)
        for name in _field_names(_registry()[1][place]):
            _write(out, getattr(value, name))
    elif value is None or isinstance(value, bool | np.bool_):
        out += b"n" if value is None else b"T" if value else b"F"
    elif isinstance(value, int | np.integer) and -(2**63) <= value < 2**63:
        out += struct.pack("<cq", b"i", value)
    elif isinstance(value, int | np.integer):
        size = int(value).bit_length() // 8 + 1
        out += struct.pack("<cI", b"j", size) + int(value).to_bytes(size, "little", signed=True)
    elif isinstance(value, float):
        out += struct.pack("<cd", b"f", value)
    elif isinstance(value, str | bytes):
        content = value.encode() if isinstance(value, str) else value
        out += struct.pack("<cI", b"b" if value is content else b"s", len(content)) + content
    elif isinstance(value, Array):
        _write_array(out, value)
    elif type(value) in _TAGS:
        parts = [*chain.from_iterable(value.items())] if type(value) is dict else value
        out += struct.pack("<cI", _TAGS[type(value)], len(parts))
        for part in parts:
            _write(out, part)
    elif type(value) is frozenset:
        out += struct.pack("<cI", b"z", len(value))
        for member in value:
            # Named tuples are equal only where all of their fields are.
            is_tuple = isinstance(member, tuple)
            kind = _registry()[0].get(type(member), -1)
            own = _encode_member(kind, member) if is_tuple else encode(member)
            out += struct.pack("<I", len(own)) + own
    else:
        raise CodecError(f"a {type(value).__name__} cannot be sent: it is on no list of types")


@lru_cache(MAX_KEPT)
def _encode_member(kind: int, member: Hashable) -> bytes:
    return encode(member)


@lru_cache(MAX_KEPT)
def _decode_member(data: bytes, depth: int) -> Any:
    return _Reader(data).read_all(depth)


def _write_array(out: bytearray, value: Array) -> None:
    kind = value.dtype.newbyteorder("<").str
    if kind not in NUMBERS:
        raise CodecError(f"an array of {value.dtype} cannot be sent")
    out += struct.pack(f"<cBB{value.ndim}I", b"a", NUMBERS.index(kind), value.ndim, *value.shape)
    out += value.astype(kind, copy=False).tobytes()


class _Reader:
    """Bytes of a message, and the place up to which they are read."""

    def __init__(self, data: bytes) -> None:
        self.data, self.place = data, 0

    def read_all(self, depth: int) -> Any:
        """Read a value, which is so deep within others, and all there is."""
        value = self.read_value(depth)
        if self.place != len(self.data):
            left = len(self.data) - self.place
            raise CodecError(f"is no message: {left} bytes follow its end")
        return value

    def read_value(self, depth: int) -> Any:
        """Read a value that is so deep within others."""
        if depth > MAX_DEPTH:
            raise CodecError(f"is no message: it is deeper than {MAX_DEPTH} values")
        (tag,) = self._unpack("<c")
        if tag in _SIMPLE:
            return _SIMPLE[tag]
        if tag in b"if":
            return self._unpack("<q" if tag == b"i" else "<d")[0]
        if tag == b"j":
            return int.from_bytes(self._take(*self._unpack("<I")), "little", signed=True)
        if tag == b"a":
            return self._read_array()
        if tag == b"r":
            return self._read_record(depth)
        if tag not in b"sbz" and tag not in _COUNTED:
            raise CodecError(f"is no message: no type has the mark {tag!r}")
        (count,) = self._unpack("<I")
        if tag in b"sb":
            content = self._take(count)
            return content.decode() if tag == b"s" else content
        if tag == b"z":
            each = (self._take(*self._unpack("<I")) for _ in range(count))
            return frozenset(_decode_member(own, depth + 1) for own in each)
        return _COUNTED[tag](self.read_value(depth + 1) for _ in range(count))

    def _read_record(self, depth: int) -> Any:
        (place,) = self._unpack("<B")
        kinds = _registry()[1]
        if place >= len(kinds):
            raise CodecError(f"is no message: no type has the number {place}")
        kind, sizes = kinds[place], Sizes({})
        given = {name: self.read_value(depth + 1) for name in _field_names(kind)}
        for name, check in _field_checks(kind).items():
            try:
                given[name] = check(given[name], sizes)
            except (Wrong, InputError) as error:
                what = f"{kind.__name__}.{name} is {describe(given[name])}"
                raise CodecError(f"is no message: {what}") from error
        return kind(**given)

    def _read_array(self) -> Array:
        kind, axes = self._unpack("<BB")
        if kind >= len(NUMBERS):
            raise CodecError(f"is no message: no array has the type {kind}")
        shape, dtype = self._unpack(f"<{axes}I"), np.dtype(NUMBERS[kind])
        data = self._take(prod(shape) * dtype.itemsize)
        return np.frombuffer(data, dtype).reshape(shape).copy()

    def _unpack(self, format: str) -> tuple[Any, ...]:
        return struct.unpack(format, self._take(struct.calcsize(format)))

    def _take(self, count: int) -> bytes:
        after = self.place + count
        if after > len(self.data):
            raise CodecError("is no message: it ends too soon")
        taken, self.place = self.data[self.place : after], after
        return taken


def _pair_up(values: Iterable[Any]) -> dict[Any, Any]:
    each = list(values)
    return dict(zip(each[::2], each[1::2], strict=True))


_SIMPLE = {b"n": None, b"T": True, b"F": False}
_COUNTED: dict[bytes, Callable[[Iterable[Any]], Any]] = {b"t": tuple, b"l": list, b"d": _pair_up}
