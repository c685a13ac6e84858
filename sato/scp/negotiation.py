"""Negotiation: two agents in conflict plan together.

Priorities put the whole way around on one of the two, however little the other would have to
move. Once all trajectories are final, pairs of nearby agents take turns: the two solve one
program for both, for the least fuel of both together, clear of all others, whose trajectories
stay as they last told. So no two agents come closer than half-spaces allow, and the total fuel
never rises, except to take an agent to its target that would have ended elsewhere.
"""

from collections.abc import Container, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems import convexify
from problems.avoidance import AvoidanceProblem, AvoidanceResult
from problems.conic import Unsolved
from problems.pair_avoidance import PairProblem, RelativeHalfSpaces
from problems.path_separation import are_balls_separated, are_hulls_separated
from problems.transfer import Trajectory
from sato.network.graph import CommunicationGraph
from sato.network.load import Load
from sato.network.rounds import run_round, schedule_turns
from sato.scp.exchange import ConflictResolution, count_trajectories
from sato.scp.planner import (
    ACTIVE_TOLERANCE,
    NEARBY_FACTOR,
    VIOLATION_TOLERANCE,
    Planner,
    Planners,
    TrajectoryMessage,
    pair_clearances,
    reaches_target,
    required_separations,
)
from sato.scp.priority_orders import PriorityCost, component_costs, compute_priority_cost

COST_TOLERANCE = 1e-9  # part of the cost of two: a smaller difference counts as none
MIN_IMPROVEMENT = 1e-3  # part of a component's cost: a sweep that saves less is its last


class Offer(NamedTuple):
    """Message of an agent to the one that it negotiates with."""

    agent_id: int
    problem: AvoidanceProblem  # with the half-spaces that keep it clear of all others
    trajectory: Trajectory
    nominal_points: Float[Array, "pieces 4 d"]  # about which both convexify
    reaches_target: bool
    neighbor_points: Float[Array, "others pieces 4 d"]  # of all neighbors but the partner
    neighbor_clearances: Float[Array, " others"]  # from each of them [m]
    clearance: float  # that two of the agent's kind would keep [m]


class Agreement(NamedTuple):
    """Message of the agent that solved for both to the other."""

    recipient: int
    trajectory: Trajectory


class Negotiator(NamedTuple):
    """Memory of an agent whose turn it is."""

    planner: Planner
    partner: int
    offer: Offer | None = None
    agreement: Agreement | None = None
    solve_count: int = 0

    @property
    def agent_id(self) -> int:
        """Number of the agent."""
        return self.planner.priority[2]


def negotiate(planners: Planners, graph: CommunicationGraph, sweeps: int) -> ConflictResolution:
    """Let every two nearby agents negotiate once a sweep, by final trajectories of all.

    There are fewer sweeps in a component where the last one saved little.
    """
    now, rounds, solves, load = dict(planners), 0, 0, Load.none(len(graph.alive))
    flooding = int(graph.diameter[list(now)].max(initial=0))
    continuing, costs = set(now), component_costs(now, graph)
    for _ in range(sweeps):
        looking = {i for i in continuing if any(costs[i])}
        turns = schedule_pairs(now, graph, looking)
        load = load.plus(_count_load({i: now[i] for i in sorted(looking)}, graph, turns))
        rounds += 1 + flooding
        if not turns:
            break
        for turn in turns:
            negotiators = negotiate_pairs(now, graph, turn)
            now |= {i: negotiator.planner for i, negotiator in negotiators.items()}
            rounds += 3
            solves += sum(negotiator.solve_count for negotiator in negotiators.values())
        before, costs = costs, component_costs(now, graph)
        continuing = {i for i in now if _has_improved(before[i], costs[i])}
    return ConflictResolution(now, rounds, solves, load)


def _count_load(
    planners: Planners, graph: CommunicationGraph, turns: Iterable[Mapping[int, int]]
) -> Load:
    """Count the load of a sweep: a flood of pairs, their turns, and a flood of costs."""
    pairs = np.zeros(len(graph.alive), dtype=np.int64)
    for turn in turns:
        pairs[graph.component[[i for i, partner in turn.items() if i < partner]]] += 1
    rounds = 1 + 2 * graph.diameter + 3 * pairs[graph.component]
    return count_trajectories(planners, graph, rounds)


def _has_improved(before: PriorityCost, cost: PriorityCost) -> bool:
    saved = before.extra_cost - cost.extra_cost
    return cost[:2] < before[:2] or saved > MIN_IMPROVEMENT * abs(cost.extra_cost)


def schedule_pairs(
    planners: Planners, graph: CommunicationGraph, continuing: Container[int]
) -> list[dict[int, int]]:
    """Schedule the partners of each turn: one pair of every component at a time.

    The batched equivalent of a flood of `{number: nearby agents}`, taken in ascending order.
    """
    messages = {i: agent.message for i, agent in planners.items()}
    looking = {i: agent for i, agent in planners.items() if i in continuing}
    nearby = run_round(graph, looking, find_nearby, messages)
    pairs = {(min(i, j), max(i, j)) for i, others in nearby.items() for j in others}
    turns = schedule_turns(graph, pairs)
    return [{a: b for i, j in turn for a, b in ((i, j), (j, i))} for turn in turns]


def find_nearby(agent: Planner, inbox: list[TrajectoryMessage]) -> list[int]:
    """Find the neighbors whose trajectories come near the agent's own."""
    path, clear = _nominal_points(agent), pair_clearances(inbox, agent.horizon.clearance)
    return [
        message.priority[2]
        for message, near in zip(inbox, NEARBY_FACTOR * clear, strict=True)
        if not are_balls_separated(path - message.control_points, near).all()
    ]


def _nominal_points(agent: Planner) -> Float[Array, "pieces 4 d"]:
    # An agent that ends off its target begins with its solo trajectory, pushed aside by
    # `choose_normals` where it meets another.
    if not agent.reaches_target(agent.nominal):
        return agent.horizon.control_points(agent.solo.x, agent.solo.u)
    return agent.control_points


def negotiate_pairs(
    planners: Planners, graph: CommunicationGraph, turn: Mapping[int, int]
) -> dict[int, Negotiator]:
    """Run one turn of partners by messages: trajectories, then offers, then agreements."""
    states = {i: Negotiator(planners[i], partner) for i, partner in turn.items()}
    trajectories = {i: agent.message for i, agent in planners.items()}
    states = run_round(graph, states, _make_offer, trajectories)
    offers = {i: state.offer for i, state in states.items() if state.offer}
    states = run_round(graph, states, _solve_agreement, offers)
    agreements = {i: state.agreement for i, state in states.items() if state.agreement}
    return run_round(graph, states, _accept_agreement, agreements)


def _make_offer(negotiator: Negotiator, inbox: list[TrajectoryMessage]) -> Negotiator:
    agent = negotiator.planner
    if len(agent.nominal.u) == 0 or compute_priority_cost(agent).is_too_close:
        return negotiator  # it has no room to give
    agent = agent.relinearized
    points, horizon, (x, u, _) = _nominal_points(agent), agent.horizon, agent.nominal
    others = [m for m in inbox if m.priority[2] != negotiator.partner]
    neighbor_points = np.array([m.control_points for m in others]).reshape(-1, *points.shape)
    clear = pair_clearances(others, horizon.clearance)
    required = required_separations(clear)
    normals = convexify.choose_normals(points - neighbor_points, required)
    half_spaces = convexify.convexify(horizon, len(u), neighbor_points, normals, required)
    # Among trajectories of equal fuel a tie-break keeps to one that may leave others less room.
    transfer = agent.without_tie_break.transfer
    problem = AvoidanceProblem(transfer, x[0], agent.target_state, half_spaces, agent.solver)
    is_there = agent.reaches_target(agent.nominal)
    there = agent.nominal, points, is_there, neighbor_points, clear, horizon.clearance
    offer = Offer(negotiator.agent_id, problem, *there)
    return negotiator._replace(planner=agent, offer=offer)


def _solve_agreement(negotiator: Negotiator, inbox: list[Offer]) -> Negotiator:
    # Of two that offer, the one with the lower number solves for both.
    own, agent = negotiator.offer, negotiator.planner
    other = next((offer for offer in inbox if offer.agent_id == negotiator.partner), None)
    if own is None or other is None or own.agent_id > other.agent_id:
        return negotiator
    if len(other.trajectory.u) != len(own.trajectory.u):
        return negotiator
    both, solves = solve_pair(own, other, agent.horizon)
    negotiator = negotiator._replace(solve_count=solves)
    if both is None:
        return negotiator
    agreed = agent.with_result(AvoidanceResult(both[0], 0.0, 0.0))
    return negotiator._replace(planner=agreed, agreement=Agreement(other.agent_id, both[1]))


def _accept_agreement(negotiator: Negotiator, inbox: list[Agreement]) -> Negotiator:
    for agreement in inbox:
        if agreement.recipient == negotiator.agent_id:
            result = AvoidanceResult(agreement.trajectory, 0.0, 0.0)
            return negotiator._replace(planner=negotiator.planner.with_result(result))
    return negotiator


def solve_pair(
    own: Offer, other: Offer, horizon: convexify.AvoidanceHorizon
) -> tuple[tuple[Trajectory, Trajectory] | None, int]:
    """Solve for the trajectories of two agents to their targets, and count the programs.

    None where the program is infeasible, or the trajectories cost more, miss a target, or do not
    keep clear when the two drift on after their last step. Equal costs are accepted: they may
    leave others more room. Few half-spaces are active: begin with those active at the nominals,
    and add those that the solution violates, until there are none.
    """
    T, R = len(own.trajectory.u), (own.clearance + other.clearance) / 2
    relative = (own.nominal_points - other.nominal_points)[None]
    required = required_separations(np.array([R]))
    normals = convexify.choose_normals(relative, required)[0]
    between = RelativeHalfSpaces.from_normals(horizon, T, normals, float(required[0]))
    problem = PairProblem(own.problem, other.problem, between)
    violation = problem.violation((own.trajectory, other.trajectory))
    active = np.abs(violation) < ACTIVE_TOLERANCE * R
    solves = 0
    while True:
        solves += 1
        try:
            both = problem.select(active).solve()
        except Unsolved:
            return None, solves
        violated = (problem.violation(both) > VIOLATION_TOLERANCE * R) & ~active
        if not violated.any():
            break
        active |= violated
    cost, cost_of_other = own.problem.transfer.cost, other.problem.transfer.cost
    before = cost(own.trajectory) + cost_of_other(other.trajectory)
    is_cheaper = cost(both[0]) + cost_of_other(both[1]) <= before * (1 + COST_TOLERANCE)
    first, second = (horizon.control_points(trajectory.x, trajectory.u) for trajectory in both)
    gaps = (
        (first - own.neighbor_points, own.neighbor_clearances),
        (second - other.neighbor_points, other.neighbor_clearances),
        (first - second, R),
    )
    is_accepted = (
        (is_cheaper or not (own.reaches_target and other.reaches_target))
        # A solution within the solver's tolerance may miss a target by more than counts as none.
        and reaches_target(both[0], own.problem.goal, own.clearance)
        and reaches_target(both[1], other.problem.goal, other.clearance)
        and all(are_hulls_separated(*gap).all() for gap in gaps)
    )
    return (both if is_accepted else None), solves
