"""Inputs of one agent, checked: its number, its state, the time and its inbox."""

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from math import ceil, floor
from typing import Annotated, Any, NamedTuple
from zlib import crc32

import numpy as np
from annotated_types import Ge, Le
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.inputs import LARGEST
from dynamics.labels import STATES, to_plain
from dynamics.orbit import MAX_TIME
from sato.network.synchronous_agent import Packet
from sato.obstacles import Obstacle
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.surroundings import Sensed
from sato.scenario.definition import Count, as_array
from sato.scenario.errors import InputError, format_value

INSTANT_PRECISION = 1e-6  # of a control step, for times that are sums of steps
MAX_OFF = 0.25  # of a control step, by which a call may be early or late
# Fields of the mission that agents must have in common to decide together.
SHARED = "axes step horizon_steps foresight replan_steps auction_steps freeze_steps".split()
SHARED += "assignment bidder_ids reset objective cost tie_break".split()
MAX_NUMBER = 4095  # of an agent: it keeps tables with a row and a column for each number


AgentNumber = Annotated[int, Ge(0), Le(MAX_NUMBER)]


@checked
class AgentMessage(NamedTuple):
    """Message of an agent to all neighbors within hearing, a plain value."""

    sender: AgentNumber
    instant: Count
    stage: Count
    content: Any


@checked
class AgentPacket(NamedTuple):
    """All that an agent sends in a round of a network that loses or delays messages."""

    packet: Packet
    commits: bool  # to what it has chosen

    @property
    def sender(self) -> int:
        """Number of the agent."""
        return self.packet.sender


def check_agent(mission: Reconfiguration, number: int) -> None:
    """Refuse a mission that an agent cannot fly, and a number that it has no entry for."""
    limits = mission.max_control, mission.max_speed, mission.collision_radius, mission.priority
    lengths = [len(each) for each in limits if isinstance(each, tuple)]
    most = min([MAX_NUMBER, *(length - 1 for length in lengths)])
    if not 0 <= number <= most:
        reason = ", the last of the mission's lists for each vehicle" if lengths else ""
        raise ValueError(
            f"number must be a whole number from 0 to {most}{reason}, got {format_value(number)}"
        )
    if mission.is_passively_safe:
        raise ValueError(
            "plan.passive_safety_m: drifts lead beyond hearing, and an agent hears only its "
            "neighbors' plans; leave it out, or fly the mission by sato.run"
        )
    if mission.printed:
        raise ValueError(
            "plan.printed: an agent commits to what it has checked, which the printed methods do "
            "not; leave it out, or fly the mission by sato.run"
        )
    if mission.orders > 1 or mission.bargains or mission.assignment == "central":
        raise ValueError(
            f"plan.orders = {mission.orders}, plan.bargains = {mission.bargains} and "
            f"plan.assignment = {mission.assignment!r}: an agent bids for its target or is "
            "given it, and resolves conflicts under one order of priority; orders = 1, "
            "bargains = 0 and assignment = 'auction' or 'given' would do"
        )


@lru_cache(maxsize=2)  # asked for by each agent of a mission
def list_doubts(mission: Reconfiguration) -> tuple[str, ...]:
    """List what `sato.run` warns of before it flies the same drawn mission."""
    return tuple(mission.warnings())


def as_instant(mission: Reconfiguration, name: str, time: Any) -> int:
    """Return the control instant of a call, which may be early or late by some of a step.

    That is the nearest one; a time that is near none is refused. Where rounds take time, each
    instant has calls at multiples of the round, and the time is that of the nearest of these.
    """
    step, round_time = mission.step, mission.link.round
    if not isinstance(time, float | int | np.number) or not -MAX_OFF * step <= time <= MAX_TIME:
        limits = f"between 0 and {MAX_TIME:.0e}"
        raise ValueError(
            f"{name} must be the seconds since the start of the mission, {limits}, got {time!r}"
        )
    before = floor(time / step + INSTANT_PRECISION)
    if 0 < round_time < step:
        last = (ceil(step / round_time * (1 - INSTANT_PRECISION)) - 1) * round_time
        is_next = 2 * (time - before * step) > last + step
        return max(0, before + int(is_next))
    nearest = round(time / step)
    if abs(time - nearest * step) > MAX_OFF * step:
        raise ValueError(
            f"{name} = {time:.10g} s lies between the instants {before} at {before * step:.10g} s "
            f"and {before + 1} at {(before + 1) * step:.10g} s: all rounds of an instant have its "
            f"time, early or late by {MAX_OFF * step:g} s at most; where messages take time, a "
            "mission with link.round_s would do"
        )
    return nearest


def as_state(mission: Reconfiguration, state: Any) -> Float[Array, " n"]:
    """Return a state as an array of as many finite numbers as the model has states."""
    n = 2 * mission.axes
    with suppress(InputError):
        array = as_array(to_plain(state, "m", STATES), 1)
        if array.shape == (n,) and abs(array).max() <= LARGEST:
            return array
    raise ValueError(
        f"state must be {n} finite numbers, position [m] and velocity [m/s], at most {LARGEST:g} "
        f"in size, got {state!r}"
    )


def check_seen(mission: Reconfiguration, number: int, seen: Sequence[Sensed]) -> list[Sensed]:
    """Return what an agent has seen, with states as arrays; refuse what it cannot have seen."""
    found: list[Sensed] = []
    for k, thing in enumerate(seen):
        if not isinstance(thing, Obstacle):
            if thing[0] == number:
                reason = f"is agent {number} itself; others that are lost would do"
                raise InputError(f"seen.{k}", reason)
            found.append((thing[0], as_state(mission, thing[1])))
        elif thing.axes == mission.axes:
            found.append(thing)
        else:
            reason = f"has {thing.axes} coordinates, and the mission {mission.axes}"
            raise InputError(f"seen.{k}", reason)
    return found


def check_inbox(number: int, inbox: Any, is_ideal: bool = True) -> Any:
    """Return what an agent heard, which is nothing but messages of other agents.

    They come in packets where messages are lost or late.
    """
    kind = AgentMessage if is_ideal else AgentPacket
    for message in inbox:
        if not isinstance(message, kind):
            raise ValueError(
                f"agent {number}: inbox must hold messages that other agents returned, got a "
                f"{type(message).__name__}; leave out those of agents that have sent none"
            )
    if any(message.sender == number for message in inbox):
        raise ValueError(
            f"agent {number} hears an agent of its own number: give each its own, and leave out "
            "its own message"
        )
    return inbox


def select_messages(
    number: int, now: AgentMessage, inbox: Sequence[AgentMessage], heard: frozenset[int] | None
) -> list[AgentMessage]:
    """Return the messages of an agent's own instant and stage, by the number of the sender.

    Its own last message tells these. In the first round of an instant, no agents were heard in the
    round before (None). A sender that is ahead of the agent, sent twice, sent something else than
    the agent, or was not heard in the round before, is refused.
    """
    place = now[1:3]
    found = sorted((m for m in inbox if m[1:3] == place), key=lambda message: message.sender)
    senders = [message.sender for message in found]
    where = f"agent {number}, in instant {now.instant} and stage {now.stage},"
    cure = "in each round call each agent once, with what its neighbors returned in the last round"
    for message in inbox:
        if message[1:3] > place:
            ahead = f"agent {message.sender} in instant {message.instant}, stage {message.stage}"
            raise ValueError(f"{where} hears {ahead}: {cure}")
    if len(set(senders)) < len(senders):
        raise ValueError(f"{where} hears one agent twice, of agents {senders}: {cure}")
    if heard is not None and heard != set(senders):
        raise ValueError(
            f"{where} hears agents {senders}, and in the round before {sorted(heard)}: who hears "
            "whom, and who is lost, may change between two instants, not between two rounds"
        )
    kind = type(now.content)
    for message in found:
        if type(message.content) is not kind:
            got = type(message.content).__name__
            raise ValueError(
                f"{where} hears {got} from agent {message.sender} in place of {kind.__name__}: "
                "give all agents the same mission"
            )
    return found


def checksum(mission: Reconfiguration, leg: Leg) -> int:
    """Return a checksum of what agents must have in common to decide together."""
    shared = [getattr(mission, name) for name in SHARED]
    shared += [mission.least_separation, float(mission.top_speeds.max()), leg.steps]
    own = b"" if mission.assignment == "given" else leg.targets.tobytes()
    return crc32(repr(shared).encode() + own)
