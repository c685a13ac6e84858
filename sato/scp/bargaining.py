"""Bargains: two agents that are in each other's way plan together, and both give way.

Priorities put the whole way round on one of the two, however little the other would have to
move. Once all are settled, the pairs of a network that are near each other take turns: the two
solve one programme for both, for the least fuel of both together, clear of all others, who fly
on as they told. So nobody comes closer to anybody than half-spaces allow, and the fuel of all
never rises, unless it takes somebody to its goal who would have ended elsewhere.
"""

from collections.abc import Callable, Container, Iterable, Mapping
from math import inf
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import Unsolved
from problems.convexify import Horizon, apart, balls_apart, half_spaces, normals
from problems.pair import Between, Pair, Side
from problems.transfer import Flight
from sato.network import Network, play, turns
from sato.scp.agent import BROKEN, LEANING, NEAR, Plan, Planner, ends_at
from sato.scp.orders import Settled, Toll, toll, tolled, totals

Message = TypeVar("Message")

DEARER = 1e-9  # part of the fuel of two: what costs so little more costs the same
WORTH = 1e-3  # part of what a network pays: after a sweep that saves less there is no other


class Offer(NamedTuple):
    """What an agent tells the one that it bargains with."""

    number: int
    side: Side  # with the half-spaces that keep it clear of everybody else
    flight: Flight
    nominal: Float[Array, "pieces 4 d"]  # about which both convexify
    arrives: bool
    others: Float[Array, "others pieces 4 d"]  # paths of all whom it hears but the partner


class Deal(NamedTuple):
    """What two have agreed on, for the one who is told."""

    to: int
    flight: Flight


class Party(NamedTuple):
    """One agent whose turn it is: all that it knows."""

    planner: Planner
    partner: int
    offer: Offer | None = None
    near: tuple[int, ...] = ()  # whose plans come near its own
    deal: Deal | None = None
    solves: int = 0

    @property
    def number(self) -> int:
        """Its own number."""
        return self.planner.rank[2]


def bargain(planners: Mapping[int, Planner], network: Network, sweeps: int) -> Settled:
    """Let every two who are in each other's way bargain once a sweep.

    Args:
        planners: Every live agent, by number, settled.
        network: Who hears whom.
        sweeps: Most that are made; fewer in a network where the last one brought little.
    """
    now, exchanges, solves = dict(planners), 0, 0
    flooding = int(network.diameter[list(now)].max(initial=0))
    before = {i: Toll(inf, inf, inf) for i in now}
    for _ in range(sweeps):
        paid = totals(tolled(now), network)
        to_come = calendar(now, network, {i for i in now if _saved(before[i], paid[i])})
        exchanges += 1 + flooding
        if not to_come:
            break
        for turn in to_come:
            parties = meet(now, network, turn)
            now |= {i: party.planner for i, party in parties.items()}
            exchanges += 3
            solves += sum(party.solves for party in parties.values())
        before = paid
    return Settled(now, exchanges, solves)


def _saved(before: Toll, paid: Toll) -> bool:
    # Whether there is anything to pay still, and it has become less.
    less = paid[:2] < before[:2] or before.fuel - paid.fuel > WORTH * abs(paid.fuel)
    return any(paid) and less


def calendar(
    planners: Mapping[int, Planner], network: Network, going: Container[int]
) -> list[dict[int, int]]:
    """Whose turn it is and with whom, turn by turn: one pair of every component at a time.

    The batched equivalent of a flood of `{number: near}`, taken in order of the numbers.
    """
    states = [Party(planners[i], -1) if i in planners else None for i in range(len(network.alive))]
    who = [i for i in sorted(planners) if i in going]
    looked = _exchange(network, states, _tell_plan, _look_round, who)
    pairs = {(min(i, j), max(i, j)) for i, p in enumerate(looked) if p for j in p.near}
    return [{a: b for i, j in turn for a, b in ((i, j), (j, i))} for turn in turns(network, pairs)]


def _look_round(party: Party | None, inbox: list[Plan | None]) -> Party | None:
    """Whose plans come near its own."""
    if party is None:
        return None
    path, radius = _nominal(party.planner), party.planner.horizon.radius
    heard = [plan for plan in inbox if plan]
    near = [p.rank[2] for p in heard if not balls_apart(path - p.path, NEAR * radius).all()]
    return party._replace(near=tuple(near))


def _nominal(agent: Planner) -> Float[Array, "pieces 4 d"]:
    # Who ends elsewhere begins with its way to its goal, pushed aside where it meets somebody.
    if not agent.arrives(agent.flight):
        return agent.horizon.path(agent.free.x, agent.free.u)
    return agent.path


def meet(
    planners: Mapping[int, Planner], network: Network, turn: Mapping[int, int]
) -> dict[int, Party]:
    """One turn, by messages: plans, then offers, then deals."""
    states = [
        Party(planners[i], turn.get(i, -1)) if i in planners else None
        for i in range(len(network.alive))
    ]
    states = _exchange(network, states, _tell_plan, _make_offer, turn)
    states = _exchange(network, states, lambda party: party.offer, _settle, turn)
    states = _exchange(network, states, lambda party: party.deal, _take, turn)
    return {i: state for i in turn if (state := states[i])}


def _exchange(
    network: Network,
    states: list[Party | None],
    tell: Callable[[Party], Message | None],
    act: Callable[[Party | None, list[Message | None]], Party | None],
    who: Iterable[int],
) -> list[Party | None]:
    told = [tell(party) if party else None for party in states]
    acted = play(network, states, act, told, who)
    return [acted.get(i, party) for i, party in enumerate(states)]


def _tell_plan(party: Party) -> Plan:
    return party.planner.plan


def _make_offer(party: Party | None, inbox: list[Plan | None]) -> Party | None:
    """Hear all plans, and tell the partner what to keep clear of and where to go."""
    if party is None:
        return None
    agent, T = party.planner, len(party.planner.flight.u)
    if T == 0 or toll(agent).close:
        return party  # it has no room to give
    agent = agent.relinearised
    others = [plan.path for plan in inbox if plan and plan.rank[2] != party.partner]
    theirs, nominal = np.array(others).reshape(-1, *agent.path.shape), _nominal(agent)
    spaces = half_spaces(agent.horizon, T, theirs, normals(nominal - theirs, agent.horizon.keep))
    # Among flights of equal fuel a slope keeps to one, and others could not make use of the rest.
    side = Side(agent.level.transfer, agent.flight.x[0], agent.goal, spaces)
    arrives = agent.arrives(agent.flight)
    offer = Offer(party.number, side, agent.flight, nominal, arrives, theirs)
    return party._replace(planner=agent, offer=offer)


def _settle(party: Party | None, inbox: list[Offer | None]) -> Party | None:
    """Of two who offer, the one with the lower number plans for both."""
    if party is None or party.offer is None or party.number > party.partner:
        return party
    theirs = next((offer for offer in inbox if offer and offer.number == party.partner), None)
    if theirs is None or len(theirs.flight.u) != len(party.offer.flight.u):
        return party
    flights, solves = agree(party.offer, theirs, party.planner.horizon)
    party = party._replace(solves=solves)
    if flights is None:
        return party
    deal = Deal(party.partner, flights[1])
    return party._replace(planner=_flying(party.planner, flights[0]), deal=deal)


def _take(party: Party | None, inbox: list[Deal | None]) -> Party | None:
    """Fly what was agreed on."""
    if party is None:
        return None
    mine = next((deal for deal in inbox if deal and deal.to == party.number), None)
    return party._replace(planner=_flying(party.planner, mine.flight)) if mine else party


def _flying(agent: Planner, flight: Flight) -> Planner:
    return agent.flying(flight)._replace(late=0.0)  # a deal ends at the goal


def agree(own: Offer, theirs: Offer, horizon: Horizon) -> tuple[tuple[Flight, Flight] | None, int]:
    """Flights of both to their goals, and the programmes that took.

    None where there are none, or they are dearer, or miss a goal, or do not keep clear when the two
    drift on after their steps. What costs the same is taken: it may leave others more room. Few
    half-spaces bind: those on which the two lean, and those that an answer would break, until it
    breaks none.
    """
    T, R = len(own.flight.u), horizon.radius
    between = Between.of(horizon, T, normals((own.nominal - theirs.nominal)[None], horizon.keep)[0])
    over = _missing(own.side, theirs.side, between, (own.flight, theirs.flight))
    chosen = [np.abs(rows) < LEANING * R for rows in over]
    solves = 0
    while True:
        first = own.side._replace(spaces=own.side.spaces.only(chosen[0]))
        second = theirs.side._replace(spaces=theirs.side.spaces.only(chosen[1]))
        solves += 1
        try:
            both = Pair(first, second, between.only(chosen[2])).solve()
        except Unsolved:
            return None, solves
        over = _missing(own.side, theirs.side, between, both)
        broken = [(rows > BROKEN * R) & ~known for rows, known in zip(over, chosen, strict=True)]
        if not any(rows.any() for rows in broken):
            break
        chosen = [known | rows for known, rows in zip(chosen, broken, strict=True)]
    before = own.flight.fuel + theirs.flight.fuel
    cheaper = both[0].fuel + both[1].fuel <= before * (1 + DEARER)
    wanted = cheaper or not (own.arrives and theirs.arrives)
    keeps = wanted and _arrive(own, theirs, both, R) and _clear(own, theirs, both, horizon)
    return (both if keeps else None), solves


def _arrive(own: Offer, theirs: Offer, both: tuple[Flight, Flight], radius: float) -> bool:
    # An answer within the solver's tolerance may miss a goal by more than counts as being there.
    goals = own.side.goal, theirs.side.goal
    return all(ends_at(flight, goal, radius) for flight, goal in zip(both, goals, strict=True))


def _clear(own: Offer, theirs: Offer, both: tuple[Flight, Flight], horizon: Horizon) -> bool:
    first, second = (horizon.path(flight.x, flight.u) for flight in both)
    gaps = (first - own.others, second - theirs.others, first - second)
    return all(bool(apart(gap, horizon.radius).all()) for gap in gaps)


def _missing(
    own: Side, theirs: Side, between: Between, both: tuple[Flight, Flight]
) -> tuple[Array, Array, Array]:
    return (
        own.spaces.missing(both[0].x, both[0].u),
        theirs.spaces.missing(both[1].x, both[1].u),
        between.missing(*both),
    )
