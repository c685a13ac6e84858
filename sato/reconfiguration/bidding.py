"""Who goes where: claims, the auction and the clock [Morgan2016, Method 3, lines 3-13]."""

from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.path import least_distance
from sato.network import Network
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.moment import Moment
from sato.reconfiguration.pricing import Minds, Offers, bid_costs, offers, settled
from sato.vsdaa import Auction, vsdaa

COARSE = 0.01  # ε over the extent of the shape, where there is no tie-break to tell it


class Decision(NamedTuple):
    """What came out of one or more auctions."""

    minds: Minds
    reset: Bool[Array, " agents"]  # whose clock went back
    solves: int


def decide(moment: Moment, minds: Minds, planned: Float[Array, " agents"]) -> Decision:
    """Let every network bid, and set its clock back where the number of bids changed.

    A clock also goes back where somebody won a target out of its reach; a mission may have
    it that this is the only reason. A network whose clock goes back bids again, with the
    time that it now has.

    Args:
        moment: What there is to decide with.
        minds: What the agents remember.
        planned: Fuel left in the plan to the target that each holds; infinite without one.
    """
    network, before = moment.network, minds.clock
    minds = share(minds, network)
    reset = np.asarray(network.alive & (minds.clock != before))
    sale = _sell(moment, minds, np.where(reset, np.inf, planned))
    solves = sale.solves
    changed = (minds.bidders > 0) & (sale.auction.bidders != minds.bidders)
    calls = sale.unreached | changed if moment.mission.reset == "change" else sale.unreached
    due = network.alive & (minds.clock > 0) & calls
    due = network.largest(due.astype(int)).astype(bool) & network.alive
    if due.any():
        reset = reset | due
        minds = replace(minds, clock=np.where(due, 0, minds.clock))
        sale = _sell(moment, minds, np.where(reset, np.inf, planned))
        solves += sale.solves
    if sale.unreached.any():
        firm = network.largest(sale.unreached.astype(int)).astype(bool)
        sale = _sell(moment, minds, np.where(reset, np.inf, planned), firm)
        solves += sale.solves
    return Decision(_remember(minds, sale.auction, moment), reset, solves)


def share(minds: Minds, network: Network) -> Minds:
    """Agree within every network on the claims heard last and the clock with longest to go.

    The batched equivalent of flooding (`network.flood`): of two claims of one agent the
    newer counts.
    """
    claimed, heard = minds.claimed.copy(), minds.heard.copy()
    for c in range(network.component.max(initial=-1) + 1):
        members = np.flatnonzero(network.component == c)
        newest = heard[members].argmax(axis=0)
        claimed[members] = claimed[members[newest], np.arange(len(newest))]
        heard[members] = heard[members].max(axis=0)
    clock = -network.largest(-minds.clock)
    return replace(minds, claimed=claimed, heard=heard, clock=clock)


class _Sale(NamedTuple):
    auction: Auction
    unreached: Bool[Array, " agents"]  # who won a target out of its reach
    solves: int


def _sell(
    moment: Moment,
    minds: Minds,
    planned: Float[Array, " agents"],
    firm: Bool[Array, " agents"] | None = None,
) -> _Sale:
    # A price that is only a lower bound is settled when it wins, and the auction is run
    # again. At the end all winners' prices are exact and no other is above the truth, so
    # the promise of N ε holds for the exact prices. That somebody's price was settled is
    # flooded like everything else that a network agrees on.
    offered, solves = offers(moment, minds, planned), 0
    epsilon = increment(moment.mission, moment.leg)
    live = np.flatnonzero(moment.network.alive)
    while True:
        cost = bid_costs(offered, minds, moment.network, firm)
        ids = moment.mission.bidder_ids
        auction = vsdaa(cost, moment.network, minds.believed, epsilon, ids=ids)
        won = auction.target[live]
        doubtful = np.flatnonzero(~offered.exact[live, won])
        if not len(doubtful):
            return _Sale(auction, _unreached(offered, auction, moment.network), solves)
        pairs = [(int(live[k]), int(won[k])) for k in doubtful]
        offered, solves = settled(moment, minds, offered, pairs), solves + len(pairs)


def _unreached(offered: Offers, auction: Auction, network: Network) -> Bool[Array, " agents"]:
    unreached = np.zeros(len(network.alive), dtype=bool)
    live = np.flatnonzero(network.alive)
    unreached[live] = ~offered.reachable[live, auction.target[live]]
    return unreached


def increment(mission: Reconfiguration, leg: Leg) -> float:
    """ε, from the mission alone, so that all agents know the same [m]."""
    if mission.epsilon is not None:
        return mission.epsilon
    places = leg.targets[:, : mission.model.axes]
    if mission.tie_break == 0:
        extent = float(np.linalg.norm(np.ptp(places, axis=0)))
        return COARSE * (extent if extent > 0 else 1.0)
    spacing = least_distance(places)
    return 0.5 * mission.tie_break * (spacing if isfinite(spacing) else 1.0) ** 2


def _remember(minds: Minds, auction: Auction, moment: Moment) -> Minds:
    network, alive = moment.network, moment.network.alive
    together = (network.component[:, None] == network.component) & alive[:, None] & alive
    return replace(
        minds,
        target=np.where(alive, auction.target, minds.target),
        believed=np.where(alive, auction.believed, minds.believed),
        bidders=np.where(alive, auction.bidders, minds.bidders),
        claimed=np.where(together, auction.target, minds.claimed),
        heard=np.where(together, moment.step, minds.heard),
    )
