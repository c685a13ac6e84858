"""Synchronous rounds of messages.

Distributed means: what an agent does is a pure function of its own memory and its inbox, the
messages of its neighbors. `run_round` alone calls such functions.

Code that computes the same for all agents at once is called batched. It pretends three things:
all agents act in lock step, a message is heard by all neighbors one round after it was sent,
and none is lost. Where some are, repetition makes up for it: `network.synchronizer` computes in
which rounds of the network agents get through those that are pretended here. (CBAA has a model of
delay and loss of its own.) Each batched path is tested to be equal to its definition by messages,
in `network.flooding`, `auctions.bidder`, `scp.planner` or `tests/messages.py`, and the whole
decision of an instant to `reconfiguration.agent`:

    definition                  batched
    Census                      CommunicationGraph.diameter
    flood, Flood                CommunicationGraph.component_max,
                                scp.priority_orders.component_costs, select_components
    flood, then sort            schedule_turns
    VsdaaBidder, CbaaBidder     auctions.vsdaa, auctions.cbaa
    update_planner              scp.exchange.run_batched
    Bending, Meeting            scp.halfway.meet_halfway
    Choosing, Turns             reconfiguration.commitment.commit
    Holding, Choosing           reconfiguration.orbital_commitment.commit_in_orbit
    Agent                       assignment.assign_targets, planning.plan_trajectories
"""

from collections.abc import Callable, Iterable, Mapping
from itertools import zip_longest
from typing import TypeVar

from sato.network.graph import CommunicationGraph

State = TypeVar("State")
Message = TypeVar("Message")
Result = TypeVar("Result")


def run_round(
    graph: CommunicationGraph,
    states: Mapping[int, State],
    update: Callable[[State, list[Message]], Result],
    messages: Mapping[int, Message],
) -> dict[int, Result]:
    """Let each of these agents act once, on the messages of its neighbors.

    The update is a pure function of one agent's memory and inbox, most often its new memory. An
    agent that has sent no message has none under its number.
    """
    return {
        i: update(state, [messages[j] for j in graph.neighbors[i] if j in messages])
        for i, state in states.items()
    }


def schedule_turns(
    graph: CommunicationGraph, groups: Iterable[tuple[int, ...]]
) -> list[list[tuple[int, ...]]]:
    """Give each group one turn, one group of every component at a time, in ascending order.

    The agents of a group are of one component, and act in the same turn. The batched equivalent
    of a flood of the groups, which each agent then sorts.
    """
    queues: dict[int, list[tuple[int, ...]]] = {}
    for group in sorted(groups):
        queues.setdefault(int(graph.component[group[0]]), []).append(group)
    return [[group for group in turn if group] for turn in zip_longest(*queues.values())]
