"""Reports with which the agents of a component begin an instant."""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple
from zlib import crc32

import numpy as np

from sato.network import load
from sato.network.encoding import COMMON_HELLO, HELLO
from sato.network.flooding import census_rounds
from sato.network.load import Load, fingerprint
from sato.reconfiguration.agent_inputs import AgentNumber
from sato.reconfiguration.state import DecisionContext


class Hello(NamedTuple):
    """Report of an agent at the beginning of an instant."""

    agent: AgentNumber
    leg: tuple[int, int]  # instant at which it began; checksum of targets, steps and mission
    is_due: bool  # it plans again, if this is an instant to plan
    is_auction_due: bool  # it calls for an auction, if this is an instant to plan
    joins: bool  # it calls for an auction at once
    clock: int
    claim_step: int = -1  # of its latest claim; −1 never
    together: int = 0  # checksum of those with which it decided then
    has_arrived: bool = False


def check_census(reports: list[Hello]) -> None:
    """Refuse a component that cannot decide together."""
    first = reports[0]
    for hello, other in pairwise(reports):
        if hello.agent == other.agent:
            raise ValueError(f"two agents have the number {hello.agent}: give each its own")
    for hello in reports:
        if hello.leg != first.leg:
            raise ValueError(
                f"agents {first.agent} and {hello.agent} hear each other and do not fly the same "
                "leg of the same mission: give all agents the same targets and steps, between the "
                "same two instants, and missions with the same plan, limits and radii"
            )


def has_later_leg(reports: Iterable[Hello]) -> bool:
    """Tell whether some fly a later leg than others, which do not know that the last is over."""
    return len({hello.leg[0] for hello in reports}) > 1


def has_changed_network(reports: list[Hello]) -> bool:
    """Tell whether the agents did not decide together last, as `plan.has_changed_network`."""
    steps = {hello.claim_step for hello in reports}
    if len(steps) > 1 or steps == {-1}:
        return len(steps) > 1
    now = checksum_members([hello.agent for hello in reports])
    return any(hello.together != now for hello in reports)


def checksum_members(agents: list[int]) -> int:
    """Return a checksum of the agents that decide together, in ascending order."""
    return crc32(np.array(agents, dtype=np.int16).tobytes())


def count_census(context: DecisionContext) -> Load:
    """Count the load of a census: each agent passes on all reports, and what they have in common.

    The batched equivalent of `flooding.Census` with reports `Hello`.
    """
    graph, memory, live = context.graph, context.memory, np.flatnonzero(context.graph.alive)
    messages, payload = load.count_census(graph)
    step, component = memory.claim_step.diagonal(), graph.component[live]
    together = fingerprint((memory.claim_step == step[:, None]) & (step[:, None] >= 0))
    parts = component, memory.clock[live], step[live], together[live]
    _, first = np.unique(fingerprint(np.stack(parts, axis=1)), return_index=True)
    size = HELLO * np.bincount(component, minlength=1)
    size += COMMON_HELLO * np.bincount(component[first], minlength=len(size))
    payload = payload + np.where(graph.alive, size[graph.component], 0)
    return Load.of(graph, live, census_rounds(graph.diameter), (messages, payload))
