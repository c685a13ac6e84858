"""Stages of the decision of one agent: its messages and its memory in each."""

from collections.abc import Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.trajectory_geometry import hull_distance
from problems.convexify import AvoidanceHorizon
from problems.path_separation import are_hulls_separated
from sato.auctions.bidder import VsdaaBidder, WinningBids
from sato.network.flooding import Flood, Reports
from sato.reconfiguration import assignment, target_costs
from sato.reconfiguration.agent_inputs import AgentNumber
from sato.reconfiguration.commitment import improve, next_choice
from sato.reconfiguration.evasion import ROUNDING
from sato.reconfiguration.offers import Offers
from sato.reconfiguration.orbital_commitment import give_up_unclear
from sato.reconfiguration.orbital_evasion import Detours, offer_detour
from sato.reconfiguration.plan import Plan
from sato.reconfiguration.state import DecisionContext
from sato.scp.planner import Planner, Priority, TrajectoryMessage, pair_clearances, update_planner


class AuctionTerms(NamedTuple):
    """Report of an agent before an auction."""

    agent: AgentNumber
    target_count: int  # m
    cost_range: float  # [m]
    state: tuple[float, ...]  # by which it plans
    claims: tuple[tuple[int, int, int], ...] = ()  # agent, step and target, of all that it knows
    blocked: tuple[int, ...] = ()  # targets that it knows to be blocked
    round: int = 0


class AuctionReport(NamedTuple):
    """Report of an agent that has stopped bidding."""

    agent: AgentNumber
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
    table: target_costs.CostTable
    bidder: VsdaaBidder
    order: Int[Array, " targets"]  # in which it bids on them
    flood: Flood

    @property
    def target_index(self) -> int:
        """Target for which it has the standing bid; −1 none."""
        place = self.bidder.target_index
        return int(self.order[place]) if place >= 0 else -1

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
        won = self._replace(bidder=bidder).target_index
        i, is_lost = bidder.agent_id, ~self.table.is_reachable[:, won]
        counted = np.full(len(is_lost), bidder.bids.winner_count)
        resets = assignment.needs_reset(self.context, counted, is_lost)
        is_exact = bool(self.table.is_exact[i, won])
        return AuctionReport(i, bidder.round, won, is_exact, bool(is_lost[i]), bool(resets[i]))


class ExchangeReport(NamedTuple):
    """Report of an agent whose trajectory is final."""

    agent: AgentNumber
    round: int  # in which it became final


class ExchangeMessage(NamedTuple):
    """Message of an agent in an exchange of trajectories."""

    trajectory: TrajectoryMessage
    reports: Reports  # of agents whose trajectories are final


class Exchange(NamedTuple):
    """Memory of an agent that exchanges trajectories."""

    planner: Planner
    flood: Flood

    @property
    def message(self) -> ExchangeMessage:
        """Message to the neighbors."""
        return ExchangeMessage(self.planner.message, self.flood.message)

    @property
    def is_finished(self) -> bool:
        """True once all agents know that all trajectories are final."""
        return self.flood.is_finished

    def update(self, inbox: Sequence[ExchangeMessage]) -> "Exchange":
        """Plan around the neighbors of higher priority; pass on the reports of all."""
        flood = self.flood.update([message.reports for message in inbox])
        planner = update_planner(self.planner, [message.trajectory for message in inbox])
        if planner.is_final and not self.planner.is_final:
            report = ExchangeReport(planner.priority[2], flood.round)
            flood = flood._replace(message=flood.message | {report})
        return self._replace(planner=planner, flood=flood)


class CommittedMessage(NamedTuple):
    """Message of an agent: what it has committed to now."""

    path: Float[Array, "pieces 4 d"]
    clearance: float  # that two of the sender's kind would keep [m]
    step_count: int  # of the controls


class Holding(NamedTuple):
    """Memory of an agent in orbit that compares what it and its neighbors have committed to."""

    offers: Offers  # its own
    detours: Detours | None = None  # where something comes over both offers
    is_unclear: bool = False  # True where it is not clear of a neighbor's
    is_finished: bool = False

    @property
    def message(self) -> CommittedMessage:
        """Message to the neighbors."""
        steps = int(self.offers.steps[0])
        return CommittedMessage(self.offers.paths[0, -1], float(self.offers.clearance[0]), steps)

    @property
    def kept_offers(self) -> Offers:
        """Its offers, without what it has committed to where that is not clear."""
        return give_up_unclear(self.offers, np.array([self.is_unclear]))

    def update(self, inbox: Sequence[CommittedMessage]) -> "Holding":
        """Compare, and choose a detour that is clear of all; all do so in the same round."""
        own, offers = self.message, self.offers
        is_unclear = not all(keeps_clear(own.path, own.clearance, other) for other in inbox)
        if self.detours is not None:
            others = stack_others(inbox, own.path, own.clearance)
            offers = offer_detour(offers, 0, self.detours, *others)
        return self._replace(offers=offers, is_unclear=is_unclear, is_finished=True)


class OfferMessage(NamedTuple):
    """Message of an agent that looks for an offer that is clear of all others."""

    priority: Priority
    path: Float[Array, "pieces 4 d"]  # of its choice
    choice: int  # the larger, the shorter it follows its plan
    clearance: float  # that two of the sender's kind would keep [m]
    last_change: int  # last round in which an agent is known to have changed its choice
    step_count: int  # of the controls that are not those of the plan
    # Of the earlier commitment of the sender, where it may go on flying that.
    held: Float[Array, "pieces 4 d"] | None = None

    @property
    def agent(self) -> int:
        """Number of the sender."""
        return self.priority[2]

    @property
    def kept(self) -> CommittedMessage:
        """Committed trajectory that the sender may go on flying."""
        path = self.path if self.held is None else self.held
        return CommittedMessage(path, self.clearance, self.step_count)


class Choosing(NamedTuple):
    """Memory of an agent that looks for an offer that is clear of all others."""

    offers: Offers  # its own
    priority: Priority
    diameter: int
    choice: int
    is_confirmed: bool = False  # True where agents commit once all that they could meet have
    round: int = 0
    last_change: int = 0
    neighbors: tuple[OfferMessage, ...] = ()  # their last messages

    @property
    def message(self) -> OfferMessage:
        """Message to the neighbors."""
        path, clearance = self.offers.paths[0, self.choice], float(self.offers.clearance[0])
        (steps,) = self.offers.count_own_steps(np.zeros(1, int), np.array([self.choice])).tolist()
        held = self.offers.paths[0, self.offers.last] if self.is_confirmed else None
        own = self.priority, path, self.choice, clearance, self.last_change, steps
        return OfferMessage(*own, held)

    @property
    def kept_below(self) -> tuple[CommittedMessage, ...]:
        """Committed trajectories that neighbors of lower priority may go on flying."""
        below = (other for other in self.neighbors if other.priority > self.priority)
        return tuple(other.kept for other in below) if self.is_confirmed else ()

    def keeps_clear_of_held(
        self, other: CommittedMessage, path: Float[Array, "pieces 4 d"] | None = None
    ) -> bool:
        """Return True where its choice, or a path, is clear of what another may go on flying.

        Or as far from it as what it has committed to itself.
        """
        clearance, held = float(self.offers.clearance[0]), self.offers.paths[0, self.offers.last]
        path = self.offers.paths[0, self.choice] if path is None else path
        if keeps_clear(held, clearance, other):
            return keeps_clear(path, clearance, other)
        pieces = max(len(held), len(other.path))
        apart = hull_distance(extend(held, pieces) - extend(other.path, pieces))[0].min()
        kept = min((clearance + other.clearance) / 2, float(apart) * (1 - ROUNDING))
        return keeps_clear(path, kept, other._replace(clearance=kept))

    @property
    def is_finished(self) -> bool:
        """True once all agents know that none changed its choice; in the same round for all."""
        return self.round > self.last_change + self.diameter

    def find_met(self) -> OfferMessage | None:
        """Find a neighbor that has chosen what is not clear of the agent's own choice."""
        own = self.message
        met = (not keeps_clear(own.path, own.clearance, other) for other in self.neighbors)
        return next(compress(self.neighbors, met), None)

    def update(self, inbox: Sequence[OfferMessage]) -> "Choosing":
        """Take the next offer where the agent meets another, and is the one that has to."""
        own, round = self.message, self.round + 1
        last_change = max([self.last_change, *(message.last_change for message in inbox)])
        after = self._replace(round=round, last_change=last_change, neighbors=tuple(inbox))
        # The one that follows its plan for a shorter time, or that of higher priority, stays.
        turn = -own.choice, own.priority
        ahead = (other for other in inbox if (-other.choice, other.priority) < turn)
        is_clear = all(keeps_clear(own.path, own.clearance, other) for other in ahead)
        is_clear = is_clear and all(map(after.keeps_clear_of_held, after.kept_below))
        if own.choice == self.offers.last or is_clear:
            return after
        choice = next_choice(self.offers.is_allowed[0], self.choice)
        return after._replace(choice=choice, last_change=round)


def keeps_clear(path: Array, clearance: float, other: CommittedMessage | OfferMessage) -> bool:
    """Return True where the trajectory of an agent with a clearance is clear of another."""
    pieces = max(len(path), len(other.path))
    relative = extend(path, pieces) - extend(other.path, pieces)
    return bool(are_hulls_separated(relative, (clearance + other.clearance) / 2).all())


def extend(path: Float[Array, "pieces 4 d"], pieces: int) -> Float[Array, "_ 4 d"]:
    """Return the first pieces of a path; after its end an agent rests."""
    rest = np.broadcast_to(path[-1, -1], (max(pieces - len(path), 0), *path.shape[1:]))
    return np.concatenate([path[:pieces], rest])


def stack_others(
    messages: Sequence[CommittedMessage], path: Float[Array, "pieces 4 d"], clearance: float
) -> tuple[Float[Array, "others pieces 4 d"], Float[Array, " others"]]:
    """Stack the paths of others, as long as an agent's own, and the distances to keep [m]."""
    paths = np.array([extend(other.path, len(path)) for other in messages])
    return paths.reshape(-1, *path.shape), pair_clearances(messages, clearance)


class ChoiceReport(NamedTuple):
    """Report of an agent that has chosen an offer."""

    agent: AgentNumber
    priority: Priority | None  # None where it commits to its plan
    steps: int  # in which all its offers have come to rest
    is_met: bool  # something comes over what it has chosen
    round: int = 0


class Turns(NamedTuple):
    """Memory of an agent while, in turn, all that could not commit to their plans change theirs."""

    context: DecisionContext
    plan: Plan
    agent: AgentNumber
    order: tuple[int, ...]  # agents whose turns they are
    horizon: AvoidanceHorizon
    u: Float[Array, "T m"]  # to which it is committed now
    path: Float[Array, "pieces 4 d"]
    clearance: float
    plan_steps: int  # for which that follows the plan
    kept_below: tuple[CommittedMessage, ...] = ()  # by neighbors of lower priority
    round: int = 0

    @property
    def message(self) -> CommittedMessage:
        """Message to the neighbors."""
        return CommittedMessage(self.path, self.clearance, self.horizon.steps)

    @property
    def is_finished(self) -> bool:
        """True once all have had their turns."""
        return self.round == len(self.order)

    def update(self, inbox: Sequence[CommittedMessage]) -> "Turns":
        """Change the committed trajectory in the agent's own turn."""
        after = self._replace(round=self.round + 1)
        if self.order[self.round] != self.agent:
            return after
        others = stack_others([*inbox, *self.kept_below], self.path, self.clearance)
        found = improve(self.context, self.agent, self.plan, self.horizon, self.path, *others)
        if found is None:
            return after
        u, path, plan_steps = found
        return after._replace(u=u, path=path, plan_steps=plan_steps)
