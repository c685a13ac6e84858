"""Reports with which the agents of a component begin an instant."""

from itertools import pairwise
from typing import NamedTuple


class Hello(NamedTuple):
    """Report of an agent at the beginning of an instant."""

    agent: int
    leg: tuple[int, int]  # instant at which it began; checksum of targets, steps and mission
    is_due: bool  # it plans again, if this is an instant to plan
    is_auction_due: bool  # it calls for an auction, if this is an instant to plan
    joins: bool  # it calls for an auction at once
    clock: int
    claims: tuple[tuple[int, int, int], ...]  # agent, step and target of each claim that it knows
    blocked: tuple[int, ...] = ()  # targets that it knows to be blocked

    @property
    def claim_step(self) -> int:
        """Step of its own latest claim; −1 never."""
        return next((step for agent, step, _ in self.claims if agent == self.agent), -1)


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
    """Tell whether the agents did not decide together last, as `plan.has_changed_network`."""
    steps = {hello.claim_step for hello in reports}
    if len(steps) > 1 or steps == {-1}:
        return len(steps) > 1
    together = {agent for agent, step, _ in reports[0].claims if step in steps}
    return together != {hello.agent for hello in reports}
