"""Roundabouts: all keep to the same hand, and take turns to keep clear of everybody they hear.

Where many pass through one place, whoever goes first goes straight and the others go about it: no
order of priority has all go round together, which often costs least. Here nobody goes straight. All
begin bent to one hand, and each in its turn keeps clear of all whom it hears, as they have told,
those whose turn is still to come as well, until all are clear. Bargains follow.
"""

from collections.abc import Mapping

from sato.network.graph import CommunicationGraph, run_round, schedule_turns
from sato.scp.negotiation import negotiate
from sato.scp.planner import AvoidedAgents, Planner, TrajectoryMessage, solve_around
from sato.scp.priority_orders import (
    ConflictResolution,
    compute_priority_costs,
    keep_cheaper,
    offset_right,
    select_clear_components,
    select_components,
    sum_by_component,
    try_priority_orders,
)

OFFSETS = (1.0, -1.0, 2.0, -2.0)  # of nominals, over R: to the right, and to the left
MAX_ROUNDS = 8  # of turns; ten through one point take one or two


def resolve_conflicts(
    planners: Mapping[int, Planner], network: CommunicationGraph, orders: int, sweeps: int
) -> ConflictResolution:
    """Orders of priority, and then roundabouts, each with bargains; components keep the cheapest.

    Args:
        planners: Every live agent, by number; the first order is that of their ranks.
        network: Who hears whom.
        orders: Most that are tried.
        sweeps: Most in which pairs bargain; without any there are no roundabouts.
    """
    settled = try_priority_orders(planners, network, orders)
    if sweeps == 0:
        return settled
    dealt = negotiate(settled.planners, network, sweeps)
    kept, paid = dealt.planners, compute_priority_costs(dealt.planners)
    flooding = int(network.diameter[list(kept)].max(initial=0))
    exchanges = settled.round_count + dealt.round_count + flooding
    solves = settled.solve_count + dealt.solve_count
    able = select_components(planners, network, can_use_roundabout)
    for bend in OFFSETS:
        dear = [
            i for i, total in sum_by_component(paid, network).items() if i in able and any(total)
        ]
        begun = solve_roundabout({i: able[i] for i in dear}, network, bend)
        exchanges, solves = exchanges + begun.round_count, solves + begun.solve_count
        if begun.planners:
            other = negotiate(begun.planners, network, sweeps)
            kept, paid = keep_cheaper(
                kept, paid, other.planners, compute_priority_costs(other.planners), network
            )
            exchanges, solves = exchanges + other.round_count + flooding, solves + other.solve_count
    return ConflictResolution(kept, exchanges, solves)


def can_use_roundabout(agent: Planner) -> bool:
    """Whether it flies in the plane, without a plan of before, and to its goal if alone."""
    return (
        agent.control_points.shape[-1] == 2
        and agent.nominal is agent.solo
        and agent.reaches_target(agent.solo)
    )


def solve_roundabout(
    planners: Mapping[int, Planner], network: CommunicationGraph, bend: float
) -> ConflictResolution:
    """The agents of those components that come to be clear, with all at their goals in the end.

    A component in which that is not so after `MOST_ROUNDS` is left out.

    Args:
        planners: Agents of whole components, by number, each with `can_go_round`.
        network: Who hears whom.
        bend: Of nominals, over R: to the right, or to the left where negative.
    """
    now = {i: offset_right(agent, bend) for i, agent in planners.items()}
    done: dict[int, Planner] = {}
    exchanges = 0
    for _ in range(MAX_ROUNDS):
        if not now:
            break
        for turn in schedule_turns(network, [(i,) for i in now]):
            states = [now.get(i) for i in range(len(network.alive))]
            told = [agent and agent.message for agent in states]
            acted = run_round(network, states, _update_in_turn, told, [i for (i,) in turn])
            now |= {i: agent for i, agent in acted.items() if agent}
            exchanges += 1
        exchanges += 1 + int(network.diameter[list(now)].max())
        clear = select_clear_components(now, network)
        done |= select_components(clear, network, lambda agent: agent.reaches_target(agent.nominal))
        now = {i: agent for i, agent in now.items() if i not in done}
    return ConflictResolution(
        done, exchanges, sum(agent.solve_count for agent in (now | done).values())
    )


def _update_in_turn(agent: Planner | None, inbox: list[TrajectoryMessage | None]) -> Planner | None:
    return agent and update_in_turn(agent, tuple(plan for plan in inbox if plan))


def update_in_turn(agent: Planner, heard: tuple[TrajectoryMessage, ...]) -> Planner:
    """One turn of one agent: keep clear of all whom it hears, on the side on which it passes.

    Where there is no such flight, it ends as near its goal as it can, and comes too close by as
    little as it can only where even that does not help.
    """
    if len(agent.nominal.u) == 0 or not heard:
        return agent.with_nominal(agent.nominal)
    agent = agent.relinearized
    others = AvoidedAgents.from_messages(agent, heard)
    for gives in ("none", "separation"):
        agent = agent._replace(solve_count=agent.solve_count + 1)
        passage = solve_around(agent.without_tie_break, others, agent.control_points, "same", gives)
        if passage is not None:
            return agent.with_nominal(passage.trajectory)
    return agent.with_nominal(agent.nominal)
