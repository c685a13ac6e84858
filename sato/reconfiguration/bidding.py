"""Who goes where: prices, claims, the auction and the clock [Morgan2016, Method 3, lines 3-13]."""

from dataclasses import dataclass, replace
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics import DoubleIntegrator, Steps, hold
from problems.auction_cost import distance, energy, price, price_within_speed
from problems.transfer import Transfer
from sato.network import Network
from sato.reconfiguration.mission import Leg, Reconfiguration, least_distance
from sato.vsdaa import Auction, vsdaa

HELD = 0.02  # of an agent's range of costs by which the target that it holds is cheaper
COARSE = 0.01  # ε over the extent of the shape, where there is no tie-break to tell it


@dataclass(frozen=True, eq=False)
class Minds:
    """What every agent remembers of this leg, a row each."""

    target: Int[Array, " agents"]  # held; −1 none
    believed: Int[Array, " agents"]  # m
    bidders: Int[Array, " agents"]  # heard of in the last auction; 0 before the first
    clock: Int[Array, " agents"]  # steps since the start or the last reset
    claimed: Int[Array, "agents agents"]  # the target that another was last known to hold; −1 none
    heard: Int[Array, "agents agents"]  # when that was said, in steps; −1 never

    @classmethod
    def fresh(cls, believed: Int[Array, " agents"]) -> "Minds":
        """At the start of a leg: nothing but m."""
        N = len(believed)
        nothing, never = np.full(N, -1), np.full((N, N), -1)
        zero = np.zeros(N, dtype=int)
        return cls(nothing, believed, zero, zero, never, never)


class Decision(NamedTuple):
    """What came out of one or two auctions."""

    minds: Minds
    reset: Bool[Array, " agents"]
    solves: int


def decide(
    mission: Reconfiguration,
    leg: Leg,
    minds: Minds,
    network: Network,
    state: Float[Array, "agents n"],
    planned: Float[Array, " agents"],
    now: int,
) -> Decision:
    """Let every component bid, and set its clock back where the number of bids changed.

    A component whose clock goes back bids again, with the time that it now has.

    Args:
        mission: What is flown.
        leg: The leg under way.
        minds: What the agents remember.
        network: Who hears whom.
        state: What each agent knows of its own state.
        planned: Fuel left in the plan to the target that each holds; infinite without one.
        now: Steps since the start of the leg.
    """
    minds = share(minds, network)
    result = _bid(mission, leg, minds, network, state, planned, now)
    counted, solves = result.auction.bidders, result.solves
    changed = (minds.bidders > 0) & (counted != minds.bidders)
    due = network.alive & (minds.clock > 0) & (changed | result.unreached)
    reset = network.largest(due.astype(int)).astype(bool) & network.alive
    if reset.any():
        minds = replace(minds, clock=np.where(reset, 0, minds.clock))
        planned = np.where(reset, np.inf, planned)
        result = _bid(mission, leg, minds, network, state, planned, now)
        solves += result.solves
    return Decision(_remember(minds, result.auction, network, now), reset, solves)


def share(minds: Minds, network: Network) -> Minds:
    """Agree within every component on the claims heard last and the latest clock.

    The batched equivalent of flooding (`network.flood`): of two claims of one agent the
    newer counts, of two clocks the one that has longer to go.
    """
    claimed, heard = minds.claimed.copy(), minds.heard.copy()
    for c in range(network.component.max(initial=-1) + 1):
        members = np.flatnonzero(network.component == c)
        newest = heard[members].argmax(axis=0)
        claimed[members] = claimed[members[newest], np.arange(len(newest))]
        heard[members] = heard[members].max(axis=0)
    clock = -network.largest(-minds.clock)
    return replace(minds, claimed=claimed, heard=heard, clock=clock)


class _Bids(NamedTuple):
    auction: Auction
    unreached: Bool[Array, " agents"]  # who won a target out of its reach
    solves: int


def _bid(
    mission: Reconfiguration,
    leg: Leg,
    minds: Minds,
    network: Network,
    state: Array,
    planned: Array,
    now: int,
) -> _Bids:
    # A price that is only a lower bound is settled when it wins; the auction is then run
    # again. At the end all winners' prices are exact and no other is above the truth, so
    # the promise of N ε holds for the exact prices.
    N, M = len(state), len(leg.targets)
    fuel, reachable = np.zeros((N, M)), np.ones((N, M), dtype=bool)
    exact, tie = np.ones((N, M), dtype=bool), np.zeros((N, M))
    ahead = {}
    for clock in np.unique(minds.clock[network.alive]):
        those = np.flatnonzero(network.alive & (minds.clock == clock))
        steps = steps_left(mission, leg, int(clock), now)
        ahead[int(clock)] = steps
        fuel[those], reachable[those], exact[those] = _price(mission, leg, steps, state[those])
        tie[those] = _tie_break(mission, leg, steps, state[those])
    _keep_planned(fuel, reachable, exact, minds, planned)
    scale = leg.steps * mission.step / 2
    solves = 0
    while True:
        main = scale * fuel if mission.cost == "fuel" else fuel
        main = np.where(reachable, main, 0.0) + mission.tie_break * tie
        cost = bid_costs(main, reachable, minds, network)
        auction = vsdaa(
            cost,
            network,
            minds.believed,
            _epsilon(mission, leg),
            ids=mission.bidder_ids,
        )
        winners = np.flatnonzero(network.alive)
        won = auction.target[winners]
        doubtful = [(i, j) for i, j in zip(winners, won, strict=True) if not exact[i, j]]
        if not doubtful:
            unreached = np.zeros(N, dtype=bool)
            unreached[winners] = ~reachable[winners, won]
            return _Bids(auction, unreached, solves)
        for i, j in doubtful:
            steps = ahead[int(minds.clock[i])]
            transfer = Transfer(steps, mission.max_control, mission.max_speed)
            flight = price_within_speed(transfer, state[i], leg.targets[j])
            fuel[i, j] = 0.0 if flight is None else flight.fuel
            reachable[i, j], exact[i, j] = flight is not None, True
            solves += 1


def _keep_planned(
    fuel: Array, reachable: Array, exact: Array, minds: Minds, planned: Array
) -> None:
    # A plan that was found stays good: where it is tight, rounding must not call it out of reach.
    for i in np.flatnonzero(np.isfinite(planned)):
        j = minds.target[i]
        if not reachable[i, j]:
            fuel[i, j], reachable[i, j], exact[i, j] = planned[i], True, True


def steps_left(mission: Reconfiguration, leg: Leg, clock: int, now: int) -> Steps:
    """The steps that remain on a clock."""
    return hold(mission.model, mission.step, leg.steps - clock, now * mission.step)


def _price(
    mission: Reconfiguration, leg: Leg, steps: Steps, state: Array
) -> tuple[Array, Array, Array]:
    if len(steps) == 0:
        here = _arrived(mission, state, leg.targets)
        return np.zeros(here.shape), here, np.ones(here.shape, dtype=bool)
    prices = price(steps, state, leg.targets, mission.max_control, mission.max_speed)
    if mission.cost == "distance":
        straight = distance(steps, state, leg.targets)
        return straight, prices.reachable, np.ones_like(prices.exact)
    return prices.fuel, prices.reachable, prices.exact


def _arrived(mission: Reconfiguration, state: Array, targets: Array) -> Array:
    d = mission.model.axes
    miss = np.abs(state[:, None] - targets)
    near = miss[..., :d].max(axis=2) <= mission.position_tolerance
    return np.asarray(near & (miss[..., d:].max(axis=2) <= mission.velocity_tolerance))


def _tie_break(mission: Reconfiguration, leg: Leg, steps: Steps, state: Array) -> Array:
    """d², or where distance means nothing the least control energy on the same scale [m²]."""
    if mission.tie_break == 0:
        return np.zeros((len(state), len(leg.targets)))
    if isinstance(mission.model, DoubleIntegrator):
        return distance(steps, state, leg.targets) ** 2
    if len(steps) < 2:
        return np.zeros((len(state), len(leg.targets)))
    # From rest to rest over d a double integrator spends 12 d²/τ³.
    duration = leg.steps * mission.step
    return duration**3 / 12 * energy(steps, state, leg.targets)


def bid_costs(
    cost: Float[Array, "agents targets"],
    reachable: Bool[Array, "agents targets"],
    minds: Minds,
    network: Network,
    least_wall: float = 1.0,
) -> Float[Array, "agents targets"]:
    """What each agent bids by: its cost, and three rules that it can keep by itself.

    A target out of reach costs more than every other that is not, by what tells the
    others apart: rounds grow as prices over ε, so a wall is no higher than it must be.
    A target claimed by an agent that is out of hearing is left alone while others are
    free: otherwise who loses sight of the holder turns back, is told off, and forgets.
    A target that it holds already is a little cheaper.

    Args:
        cost: What each target costs each agent; where out of reach, only the tie-break.
        reachable: Which can be reached.
        minds: What the agents remember.
        network: Who hears whom.
        least_wall: By how much, at the least, what is out of reach or claimed costs more.
    """
    bid = cost.copy()
    for i in np.flatnonzero(network.alive):
        within = reachable[i]
        mine = cost[i][within]
        span = float(np.ptp(mine)) if len(mine) else 0.0
        wall = max(span, least_wall)
        bid[i][~within] += (mine.max() if len(mine) else 0.0) + wall
        absent = (minds.heard[i] >= 0) & (network.component != network.component[i])
        taken = np.unique(minds.claimed[i][absent])
        bid[i, taken[taken >= 0]] += wall
        if minds.target[i] >= 0:
            bid[i, minds.target[i]] -= HELD * span
    return bid


def _epsilon(mission: Reconfiguration, leg: Leg) -> float:
    # From the mission alone, so that all agents know the same.
    if mission.epsilon is not None:
        return mission.epsilon
    places = leg.targets[:, : mission.model.axes]
    if mission.tie_break == 0:
        extent = float(np.linalg.norm(np.ptp(places, axis=0)))
        return COARSE * (extent if extent > 0 else 1.0)
    spacing = least_distance(places)
    return 0.5 * mission.tie_break * (spacing if isfinite(spacing) else 1.0) ** 2


def _remember(minds: Minds, auction: Auction, network: Network, now: int) -> Minds:
    alive = network.alive
    together = (network.component[:, None] == network.component) & alive[:, None] & alive
    return replace(
        minds,
        target=auction.target,
        believed=np.where(alive, auction.believed, minds.believed),
        bidders=np.where(alive, auction.bidders, minds.bidders),
        claimed=np.where(together, auction.target, minds.claimed),
        heard=np.where(together, now, minds.heard),
    )
