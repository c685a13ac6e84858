"""Encoding of messages between processes: what is sent arrives, and nothing else is made of it."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from agents import fly_by_messages
from hypothesis import given
from hypothesis import strategies as st
from reconfiguration_runs import crowd_in_the_way, make_mission, row, wreck_in_the_way

import sato
from sato.processes.codec import CodecError, decode, encode
from sato.reconfiguration.agent import Agent
from sato.reconfiguration.agent_inputs import AgentMessage
from sato.reconfiguration.census import Hello
from sato.reconfiguration.stopping import Commitment

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text()
    | st.binary(),
    lambda inner: st.lists(inner, max_size=3)
    | st.lists(inner, max_size=3).map(tuple)
    | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip


def parts(value):
    """A value as plain parts that compare by value, with their types."""
    if isinstance(value, np.ndarray):
        return "array", value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, float):
        return "float", np.float64(value).tobytes()
    if is_dataclass(value):
        return type(value), tuple(parts(getattr(value, f.name)) for f in fields(value))
    if isinstance(value, dict):
        return type(value), tuple((parts(a), parts(b)) for a, b in value.items())
    if isinstance(value, tuple | list):
        return type(value), tuple(map(parts, value))
    if isinstance(value, frozenset):
        return frozenset, frozenset(map(parts, value))
    return type(value), value


@given(PLAIN)
def test_plain_values_arrive_as_they_were_sent(value):
    assert parts(decode(encode(value))) == parts(value)


def crossing(rng):
    return sato.read("crossing").draw(rng)


def in_turns(rng):
    leg = sato.Leg(row(4, 3.0)[::-1], 14)
    return make_mission(row(4, 0.0), leg, position_noise=2e-3, comm_radius=3.7, max_control=0.3)


@pytest.mark.parametrize("make", [crossing, in_turns, crowd_in_the_way, wreck_in_the_way])
def test_all_messages_of_a_flight_arrive_as_they_were_sent(make, rng):
    stages = set()
    for n, (*_, rounds) in enumerate(fly_by_messages(make(rng))):
        for message in [message for sent in rounds for message in sent.values()]:
            stages.add(type(message.content))
            assert parts(decode(encode(message))) == parts(message)
        if n == 8:
            break
    assert len(stages) >= 4


def test_obstacles_arrive_as_they_were_sent():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    seen = (
        sato.Sphere((1.0, 2.0), 0.5, velocity=(0.1, 0.0), known=False),
        sato.Box((0.0, 0.0), (1.0, 2.0)),
        sato.Ellipsoid((0.0, 0.0, 1.0), (1.0, 2.0, 3.0)),
        sato.Polytope(square),
        (3, np.arange(4.0)),
    )
    assert parts(decode(encode(seen))) == parts(seen)


def test_values_of_other_types_are_not_sent(rng):
    agent = Agent(sato.read("crossing").draw(rng), 0)
    for value in (agent, {1, 2}, print, np.array(["a"]), AgentMessage(0, 0, 0, agent)):
        with pytest.raises(CodecError, match="cannot be sent"):
            encode(value)


def test_damaged_messages_are_refused_and_never_anything_else(rng):
    *_, rounds = next(fly_by_messages(sato.read("crossing").draw(rng)))
    whole = encode(rounds[-1][0])
    for cut in range(len(whole)):
        with pytest.raises(CodecError):
            decode(whole[:cut])
    for _ in range(2000):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] = rng.integers(256)
        try:
            decode(bytes(damaged))
        except CodecError:
            pass


@given(st.binary(max_size=60))
def test_noise_is_no_reason_for_another_error(data):
    try:
        decode(data)
    except CodecError:
        pass


def test_records_whose_fields_are_of_another_type_are_no_messages():
    commitment = Commitment(3, np.zeros((4, 2)))
    assert parts(decode(encode(commitment))) == parts(commitment)
    odd = None, "x", 0.5, (), np.full((4, 2), np.nan), np.zeros(3), np.zeros((1, 1, 1))
    for value in odd:
        with pytest.raises(CodecError, match=r"is no message: Commitment\.u is "):
            decode(encode(commitment._replace(u=value)))
    with pytest.raises(CodecError, match=r"is no message: Commitment\.first_step is "):
        decode(encode(commitment._replace(first_step=1.5)))
    hello = Hello(1, (0, 2**32 - 1), True, False, False, 0)
    assert decode(encode(hello)) == hello
    for number in (-1, 2**40, "1", None):
        with pytest.raises(CodecError, match=r"is no message: Hello\.agent is "):
            decode(encode(hello._replace(agent=number)))
