"""Roundabouts: all agents pass on the same side, and take turns to keep clear of all neighbors.

Where many pass through one point, the agent of highest priority flies straight and the others go
around it: under no order of priority do all go around together, which often costs least. Here
none flies straight. All begin offset to one side, and each in its turn keeps clear of all
neighbors as they last told, also of those whose turn is still to come, until all are clear.
"""

from collections.abc import Mapping, Sequence

from problems.avoidance import Relaxation
from sato.network.graph import CommunicationGraph
from sato.network.rounds import run_round, schedule_turns
from sato.scp.planner import AvoidedAgents, Planner, TrajectoryMessage, solve_around
from sato.scp.priority_orders import (
    ConflictResolution,
    count_solves,
    offset_right,
    select_clear_components,
    select_components,
)

MAX_ROUNDS = 8  # in which each agent has a turn; ten through one point take one or two
RELAXATIONS: tuple[Relaxation, ...] = ("none", "separation")


def can_use_roundabout(agent: Planner) -> bool:
    """Return True in the plane, without a previous plan, where `solo` reaches the target."""
    return (
        agent.control_points.shape[-1] == 2
        and agent.nominal is agent.solo
        and agent.reaches_target(agent.solo)
    )


def solve_roundabout(
    planners: Mapping[int, Planner], graph: CommunicationGraph, offset: float
) -> ConflictResolution:
    """Solve in turns, all offset to one side, until all are clear and reach their targets.

    Components in which that is not so after `MAX_ROUNDS` are left out of the result.

    Args:
        planners: Agents of whole components, by number, that can use a roundabout.
        graph: Communication graph.
        offset: Offset of the nominals over R: to the right, or to the left where negative.
    """
    now = {i: offset_right(agent, offset) for i, agent in planners.items()}
    done: dict[int, Planner] = {}
    rounds = 0
    for _ in range(MAX_ROUNDS):
        if not now:
            break
        for turn in schedule_turns(graph, [(i,) for i in now]):
            messages = {i: agent.message for i, agent in now.items()}
            now |= run_round(graph, {i: now[i] for (i,) in turn}, update_in_turn, messages)
            rounds += 1
        rounds += 1 + int(graph.diameter[list(now)].max())
        clear = select_clear_components(now, graph)
        done |= select_components(clear, graph, lambda agent: agent.reaches_target(agent.nominal))
        now = {i: agent for i, agent in now.items() if i not in done}
    return ConflictResolution(done, rounds, count_solves(now | done))


def update_in_turn(agent: Planner, inbox: Sequence[TrajectoryMessage]) -> Planner:
    """Plan around all neighbors, on the side on which the nominal passes.

    Where that is infeasible, the terminal state is relaxed and then the separation.
    """
    if len(agent.nominal.u) == 0 or not inbox:
        return agent.with_nominal(agent.nominal)
    agent = agent.relinearized
    others = AvoidedAgents.from_messages(agent, inbox)
    for relaxation in RELAXATIONS:
        agent = agent._replace(solve_count=agent.solve_count + 1)
        result = solve_around(
            agent.without_tie_break, others, agent.control_points, "same", relaxation
        )
        if result is not None:
            return agent.with_nominal(result.trajectory)
    return agent.with_nominal(agent.nominal)
