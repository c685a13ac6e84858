"""Conflict resolution: orders of priority, negotiation, and roundabouts.

Where many pass through one point, the agent of highest priority flies straight and the others go
around it: under no order of priority do all go around together, which often costs least. In a
roundabout none flies straight. All begin offset to one side, and each in its turn keeps clear of
all neighbors as they last told, also of those whose turn is still to come, until all are clear.
"""

from collections.abc import Sequence

import numpy as np

from problems.avoidance import Relaxation
from sato.network.graph import CommunicationGraph
from sato.network.load import Load
from sato.network.rounds import run_round, schedule_turns
from sato.scp import priority_orders
from sato.scp.exchange import ConflictResolution, count_solves, count_trajectories
from sato.scp.negotiation import negotiate
from sato.scp.planner import Planner, Planners, TrajectoryMessage, solve_around

OFFSETS = (1.0, -1.0, 2.0, -2.0)  # of the nominals in a roundabout, over R: right and left
MAX_ROUNDS = 8  # in which each agent has a turn; ten through one point take one or two
RELAXATIONS: tuple[Relaxation, ...] = ("none", "separation")


def resolve_conflicts(
    planners: Planners, graph: CommunicationGraph, orders: int, sweeps: int
) -> ConflictResolution:
    """Try orders of priority and then roundabouts, each followed by negotiation.

    The first order is that of `priority`. Each component keeps the cheapest. With 0 sweeps of
    negotiation there are no roundabouts either.
    """
    ordered = priority_orders.try_priority_orders(planners, graph, orders)
    if sweeps == 0:
        return ordered
    negotiated = negotiate(ordered.planners, graph, sweeps)
    kept = negotiated.planners
    flooding = int(graph.diameter[list(kept)].max(initial=0))
    trials, floods = [ordered, negotiated], 1
    load = count_trajectories(kept, graph, graph.diameter)
    able = priority_orders.select_components(planners, graph, can_use_roundabout)
    for offset in OFFSETS:
        totals = priority_orders.component_costs(kept, graph)
        costly = {i: agent for i, agent in able.items() if any(totals[i])}
        trials.append(solve_roundabout(costly, graph, offset))
        if trials[-1].planners:
            trials.append(negotiate(trials[-1].planners, graph, sweeps))
            load = load.plus(count_trajectories(trials[-1].planners, graph, graph.diameter))
            kept = priority_orders.keep_cheaper(kept, trials[-1].planners, graph)
            floods += 1
    for trial in trials:
        load = load.plus(trial.load)
    rounds = sum(trial.round_count for trial in trials) + floods * flooding
    return ConflictResolution(kept, rounds, sum(trial.solve_count for trial in trials), load)


def can_use_roundabout(agent: Planner) -> bool:
    """Return True in the plane, without a previous plan, where `solo` reaches the target."""
    is_planar = agent.control_points.shape[-1] == 2
    return is_planar and agent.nominal is agent.solo and agent.reaches_target(agent.solo)


def solve_roundabout(
    planners: Planners, graph: CommunicationGraph, offset: float
) -> ConflictResolution:
    """Solve in turns, all offset to one side, until all are clear and reach their targets.

    The agents are those of whole components, which can use a roundabout. Components in which
    they are not clear after `MAX_ROUNDS` are left out of the result. The offset of the nominals
    is over R: to the right, or to the left where negative.
    """
    now = {i: priority_orders.offset_right(agent, offset) for i, agent in planners.items()}
    done: dict[int, Planner] = {}
    rounds, load = 0, Load.none(len(graph.alive))
    for _ in range(MAX_ROUNDS):
        if not now:
            break
        for turn in schedule_turns(graph, [(i,) for i in now]):
            messages = {i: agent.message for i, agent in now.items()}
            now |= run_round(graph, {i: now[i] for (i,) in turn}, update_in_turn, messages)
            rounds += 1
        rounds += 1 + int(graph.diameter[list(now)].max())
        turns = np.bincount(graph.component[list(now)], minlength=len(graph.alive))
        taken = turns[graph.component] + 1 + graph.diameter
        load = load.plus(count_trajectories(now, graph, taken))
        clear = priority_orders.select_clear_components(now, graph)
        done |= priority_orders.select_components(
            clear, graph, lambda agent: agent.reaches_target(agent.nominal)
        )
        now = {i: agent for i, agent in now.items() if i not in done}
    return ConflictResolution(done, rounds, count_solves(now | done), load)


def update_in_turn(agent: Planner, inbox: Sequence[TrajectoryMessage]) -> Planner:
    """Plan around all neighbors, on the side on which the nominal passes.

    Where that is infeasible, the terminal state is relaxed and then the separation.
    """
    if len(agent.nominal.u) == 0 or not inbox:
        return agent.with_nominal(agent.nominal)
    agent = agent.relinearized
    free = agent.without_tie_break
    for relaxation in RELAXATIONS:
        agent = agent._replace(solve_count=agent.solve_count + 1)
        result = solve_around(free, inbox, agent.control_points, "same", relaxation)
        if result is not None:
            return agent.with_nominal(result.trajectory)
    return agent.with_nominal(agent.nominal)
