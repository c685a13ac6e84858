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
from problems.convexify import (
    AvoidanceHorizon,
    are_balls_separated,
    are_hulls_separated,
    choose_normals,
    convexify,
)
from problems.pair_avoidance import PairMember, PairProblem, RelativeHalfSpaces
from problems.transfer import Trajectory
from sato.network.graph import CommunicationGraph, run_round, schedule_turns
from sato.scp.planner import (
    ACTIVE_TOLERANCE,
    NEARBY_FACTOR,
    VIOLATION_TOLERANCE,
    Planner,
    TrajectoryMessage,
    reaches_target,
)
from sato.scp.priority_orders import (
    ConflictResolution,
    PriorityCost,
    compute_priority_cost,
    compute_priority_costs,
    sum_by_component,
)

Message = TypeVar("Message")

COST_TOLERANCE = 1e-9  # part of the fuel of two: what costs so little more costs the same
MIN_IMPROVEMENT = (
    1e-3  # part of what a network pays: after a sweep that saves less there is no other
)


class Offer(NamedTuple):
    """What an agent tells the one that it bargains with."""

    agent_id: int
    side: PairMember  # with the half-spaces that keep it clear of everybody else
    trajectory: Trajectory
    nominal_points: Float[Array, "pieces 4 d"]  # about which both convexify
    reaches_target: bool
    neighbor_points: Float[Array, "others pieces 4 d"]  # paths of all whom it hears but the partner


class Agreement(NamedTuple):
    """What two have agreed on, for the one who is told."""

    recipient: int
    trajectory: Trajectory


class Negotiator(NamedTuple):
    """One agent whose turn it is: all that it knows."""

    planner: Planner
    partner: int
    offer: Offer | None = None
    nearby_agents: tuple[int, ...] = ()  # whose plans come near its own
    agreement: Agreement | None = None
    solve_count: int = 0

    @property
    def agent_id(self) -> int:
        """Its own number."""
        return self.planner.priority[2]


def negotiate(
    planners: Mapping[int, Planner], network: CommunicationGraph, sweeps: int
) -> ConflictResolution:
    """Let every two who are in each other's way bargain once a sweep.

    Args:
        planners: Every live agent, by number, settled.
        network: Who hears whom.
        sweeps: Most that are made; fewer in a network where the last one brought little.
    """
    now, exchanges, solves = dict(planners), 0, 0
    flooding = int(network.diameter[list(now)].max(initial=0))
    before = {i: PriorityCost(inf, inf, inf) for i in now}
    for _ in range(sweeps):
        paid = sum_by_component(compute_priority_costs(now), network)
        to_come = schedule_pairs(
            now, network, {i for i in now if _should_continue(before[i], paid[i])}
        )
        exchanges += 1 + flooding
        if not to_come:
            break
        for turn in to_come:
            parties = negotiate_pairs(now, network, turn)
            now |= {i: party.planner for i, party in parties.items()}
            exchanges += 3
            solves += sum(party.solve_count for party in parties.values())
        before = paid
    return ConflictResolution(now, exchanges, solves)


def _should_continue(before: PriorityCost, paid: PriorityCost) -> bool:
    # Whether there is anything to pay still, and it has become less.
    less = paid[:2] < before[:2] or before.extra_fuel - paid.extra_fuel > MIN_IMPROVEMENT * abs(
        paid.extra_fuel
    )
    return any(paid) and less


def schedule_pairs(
    planners: Mapping[int, Planner], network: CommunicationGraph, going: Container[int]
) -> list[dict[int, int]]:
    """Whose turn it is and with whom, turn by turn: one pair of every component at a time.

    The batched equivalent of a flood of `{number: near}`, taken in order of the numbers.
    """
    states = [
        Negotiator(planners[i], -1) if i in planners else None for i in range(len(network.alive))
    ]
    who = [i for i in sorted(planners) if i in going]
    looked = _exchange_messages(network, states, _trajectory_message, _find_nearby, who)
    pairs = {(min(i, j), max(i, j)) for i, p in enumerate(looked) if p for j in p.nearby_agents}
    return [
        {a: b for i, j in turn for a, b in ((i, j), (j, i))}
        for turn in schedule_turns(network, pairs)
    ]


def _find_nearby(
    party: Negotiator | None, inbox: list[TrajectoryMessage | None]
) -> Negotiator | None:
    """Whose plans come near its own."""
    if party is None:
        return None
    path, radius = _nominal_points(party.planner), party.planner.horizon.collision_radius
    heard = [plan for plan in inbox if plan]
    near = [
        p.priority[2]
        for p in heard
        if not are_balls_separated(path - p.control_points, NEARBY_FACTOR * radius).all()
    ]
    return party._replace(nearby_agents=tuple(near))


def _nominal_points(agent: Planner) -> Float[Array, "pieces 4 d"]:
    # Who ends elsewhere begins with its way to its goal, pushed aside where it meets somebody.
    if not agent.reaches_target(agent.nominal):
        return agent.horizon.control_points(agent.solo.x, agent.solo.u)
    return agent.control_points


def negotiate_pairs(
    planners: Mapping[int, Planner], network: CommunicationGraph, turn: Mapping[int, int]
) -> dict[int, Negotiator]:
    """One turn, by messages: plans, then offers, then deals."""
    states = [
        Negotiator(planners[i], turn.get(i, -1)) if i in planners else None
        for i in range(len(network.alive))
    ]
    states = _exchange_messages(network, states, _trajectory_message, _make_offer, turn)
    states = _exchange_messages(network, states, lambda party: party.offer, _solve_agreement, turn)
    states = _exchange_messages(
        network, states, lambda party: party.agreement, _accept_agreement, turn
    )
    return {i: state for i in turn if (state := states[i])}


def _exchange_messages(
    network: CommunicationGraph,
    states: list[Negotiator | None],
    tell: Callable[[Negotiator], Message | None],
    act: Callable[[Negotiator | None, list[Message | None]], Negotiator | None],
    who: Iterable[int],
) -> list[Negotiator | None]:
    told = [tell(party) if party else None for party in states]
    acted = run_round(network, states, act, told, who)
    return [acted.get(i, party) for i, party in enumerate(states)]


def _trajectory_message(party: Negotiator) -> TrajectoryMessage:
    return party.planner.message


def _make_offer(
    party: Negotiator | None, inbox: list[TrajectoryMessage | None]
) -> Negotiator | None:
    """Hear all plans, and tell the partner what to keep clear of and where to go."""
    if party is None:
        return None
    agent, T = party.planner, len(party.planner.nominal.u)
    if T == 0 or compute_priority_cost(agent).is_too_close:
        return party  # it has no room to give
    agent = agent.relinearized
    others = [plan.control_points for plan in inbox if plan and plan.priority[2] != party.partner]
    theirs, nominal = (
        np.array(others).reshape(-1, *agent.control_points.shape),
        _nominal_points(agent),
    )
    spaces = convexify(
        agent.horizon,
        T,
        theirs,
        choose_normals(nominal - theirs, agent.horizon.required_separation),
    )
    # Among flights of equal fuel a slope keeps to one, and others could not make use of the rest.
    side = PairMember(
        agent.without_tie_break.transfer, agent.nominal.x[0], agent.target_state, spaces
    )
    arrives = agent.reaches_target(agent.nominal)
    offer = Offer(party.agent_id, side, agent.nominal, nominal, arrives, theirs)
    return party._replace(planner=agent, offer=offer)


def _solve_agreement(party: Negotiator | None, inbox: list[Offer | None]) -> Negotiator | None:
    """Of two who offer, the one with the lower number plans for both."""
    if party is None or party.offer is None or party.agent_id > party.partner:
        return party
    theirs = next((offer for offer in inbox if offer and offer.agent_id == party.partner), None)
    if theirs is None or len(theirs.trajectory.u) != len(party.offer.trajectory.u):
        return party
    flights, solves = solve_pair(party.offer, theirs, party.planner.horizon)
    party = party._replace(solve_count=solves)
    if flights is None:
        return party
    deal = Agreement(party.partner, flights[1])
    return party._replace(planner=_with_agreed(party.planner, flights[0]), agreement=deal)


def _accept_agreement(party: Negotiator | None, inbox: list[Agreement | None]) -> Negotiator | None:
    """Fly what was agreed on."""
    if party is None:
        return None
    mine = next((deal for deal in inbox if deal and deal.recipient == party.agent_id), None)
    return party._replace(planner=_with_agreed(party.planner, mine.trajectory)) if mine else party


def _with_agreed(agent: Planner, flight: Trajectory) -> Planner:
    return agent.with_nominal(flight)._replace(terminal_error=0.0)  # a deal ends at the goal


def solve_pair(
    own: Offer, theirs: Offer, horizon: AvoidanceHorizon
) -> tuple[tuple[Trajectory, Trajectory] | None, int]:
    """Flights of both to their goals, and the programmes that took.

    None where there are none, or they are dearer, or miss a goal, or do not keep clear when the two
    drift on after their steps. What costs the same is taken: it may leave others more room. Few
    half-spaces bind: those on which the two lean, and those that an answer would break, until it
    breaks none.
    """
    T, R = len(own.trajectory.u), horizon.collision_radius
    between = RelativeHalfSpaces.from_normals(
        horizon,
        T,
        choose_normals(
            (own.nominal_points - theirs.nominal_points)[None], horizon.required_separation
        )[0],
    )
    over = _compute_violations(own.side, theirs.side, between, (own.trajectory, theirs.trajectory))
    chosen = [np.abs(rows) < ACTIVE_TOLERANCE * R for rows in over]
    solves = 0
    while True:
        first = own.side._replace(half_spaces=own.side.half_spaces.select(chosen[0]))
        second = theirs.side._replace(half_spaces=theirs.side.half_spaces.select(chosen[1]))
        solves += 1
        try:
            both = PairProblem(first, second, between.select(chosen[2])).solve()
        except Unsolved:
            return None, solves
        over = _compute_violations(own.side, theirs.side, between, both)
        broken = [
            (rows > VIOLATION_TOLERANCE * R) & ~known
            for rows, known in zip(over, chosen, strict=True)
        ]
        if not any(rows.any() for rows in broken):
            break
        chosen = [known | rows for known, rows in zip(chosen, broken, strict=True)]
    before = own.trajectory.fuel + theirs.trajectory.fuel
    cheaper = both[0].fuel + both[1].fuel <= before * (1 + COST_TOLERANCE)
    wanted = cheaper or not (own.reaches_target and theirs.reaches_target)
    keeps = (
        wanted
        and _both_reach_targets(own, theirs, both, R)
        and _both_are_clear(own, theirs, both, horizon)
    )
    return (both if keeps else None), solves


def _both_reach_targets(
    own: Offer, theirs: Offer, both: tuple[Trajectory, Trajectory], radius: float
) -> bool:
    # An answer within the solver's tolerance may miss a goal by more than counts as being there.
    goals = own.side.goal, theirs.side.goal
    return all(
        reaches_target(flight, goal, radius) for flight, goal in zip(both, goals, strict=True)
    )


def _both_are_clear(
    own: Offer, theirs: Offer, both: tuple[Trajectory, Trajectory], horizon: AvoidanceHorizon
) -> bool:
    first, second = (horizon.control_points(flight.x, flight.u) for flight in both)
    gaps = (first - own.neighbor_points, second - theirs.neighbor_points, first - second)
    return all(bool(are_hulls_separated(gap, horizon.collision_radius).all()) for gap in gaps)


def _compute_violations(
    own: PairMember,
    theirs: PairMember,
    between: RelativeHalfSpaces,
    both: tuple[Trajectory, Trajectory],
) -> tuple[Array, Array, Array]:
    return (
        own.half_spaces.violation(both[0].x, both[0].u),
        theirs.half_spaces.violation(both[1].x, both[1].u),
        between.violation(*both),
    )
