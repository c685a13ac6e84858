"""Stages of the decision of one agent: its messages and its memory in each."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sato.auctions.bidder import VsdaaBidder, WinningBids
from sato.network.flooding import Flood, Reports
from sato.reconfiguration import assignment
from sato.reconfiguration.state import DecisionContext
from sato.scp.planner import Planner, TrajectoryMessage, update_planner


class Hello(NamedTuple):
    """Report of an agent at the beginning of an instant."""

    agent: int
    leg: tuple[int, int]  # instant at which it began; checksum of targets, steps and mission
    is_due: bool  # it plans again, if this is an instant to plan
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


class AuctionTerms(NamedTuple):
    """Report of an agent before an auction."""

    agent: int
    target_count: int  # m
    cost_range: float  # [m]
    round: int = 0


class AuctionReport(NamedTuple):
    """Report of an agent that has stopped bidding."""

    agent: int
    round: int  # in which it stopped
    target_index: int
    is_exact: bool  # else the cost of its target is only a lower bound
    won_unreachable: bool
    needs_reset: bool


class BiddingMessage(NamedTuple):
    """Message of an agent in an auction."""

    bids: WinningBids
    reports: Reports  # of agents that have stopped


class Bidding(NamedTuple):
    """Memory of an agent in an auction."""

    context: DecisionContext
    table: assignment.CostTable
    bidder: VsdaaBidder
    flood: Flood

    @property
    def message(self) -> BiddingMessage:
        """Message to the neighbors."""
        return BiddingMessage(self.bidder.bids, self.flood.message)

    @property
    def is_finished(self) -> bool:
        """True once all agents know that all have stopped."""
        return self.flood.is_finished

    def update(self, inbox: Sequence[BiddingMessage]) -> "Bidding":
        """Bid until the auction is over, and report then; pass on the reports of all."""
        bidder, flood = self.bidder, self.flood.update([message.reports for message in inbox])
        if not bidder.is_finished:
            bidder = bidder.update([message.bids for message in inbox])
            if bidder.is_finished:
                flood = flood._replace(message=flood.message | {self._report(bidder)})
        return self._replace(bidder=bidder, flood=flood)

    def _report(self, bidder: VsdaaBidder) -> AuctionReport:
        won, (mission, memory) = bidder.target_index, (self.context.mission, self.context.memory)
        i, is_lost = bidder.agent_id, ~self.table.is_reachable[:, won]
        counted = np.full(len(is_lost), bidder.bids.winner_count)
        resets = assignment.needs_reset(mission, memory, counted, is_lost)
        is_exact = bool(self.table.is_exact[i, won])
        return AuctionReport(i, bidder.round, won, is_exact, bool(is_lost[i]), bool(resets[i]))


class Exchange(NamedTuple):
    """Memory of an agent that exchanges trajectories."""

    planner: Planner
    unreachable: list[int]  # the agent's number, if its target is

    @property
    def message(self) -> TrajectoryMessage:
        """Message to the neighbors."""
        return self.planner.message

    @property
    def is_finished(self) -> bool:
        """True once the agent's own trajectory is final."""
        return self.planner.is_final

    def update(self, inbox: Sequence[TrajectoryMessage]) -> "Exchange":
        """Plan around the neighbors of higher priority."""
        return self._replace(planner=update_planner(self.planner, inbox))
