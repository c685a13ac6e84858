"""Reports with which the agents of a component begin an instant."""

from itertools import pairwise
from typing import NamedTuple


class Hello(NamedTuple):
    """Report of an agent at the beginning of an instant."""

    agent: int
    leg: tuple[int, int]  # instant at which it began; checksum of targets, steps and mission
    is_due: bool  # it plans again, if this is an instant to plan
    bids: bool  # it calls for an auction, if this is an instant to plan
    joins: bool  # it calls for an auction at once
    clock: int
    claims: tuple[tuple[int, int, int], ...]  # agent, step and target of each claim that it knows


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


def has_changed_network(reports: list[Hello]) -> bool:
    """Tell whether an agent decided among others before, as `plan.has_changed_network`."""
    members = {hello.agent for hello in reports}
    for hello in reports:
        step = {agent: at_step for agent, at_step, _ in hello.claims}
        own = step.get(hello.agent)
        if own is not None and members != {agent for agent in step if step[agent] == own}:
            return True
    return False
