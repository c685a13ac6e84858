"""Commitment in orbit, where nothing rests: to whole plans, and to the free motion after them.

Each agent offers its plan, and what it has committed to: both to the last arrival of all that hear
each other, and two orbits of free motion after that, if targets keep their distance so long. An
agent that has not committed to anything drifts. Where something comes over both, it offers to evade
instead (`orbital_evasion`). Agents agree on offers as those that can stop do (`commitment`).

A commitment may come too close to another's, of an agent that was out of hearing
then, or by disturbances. Such an agent has nothing safe to keep, and commits to its plan. A mission
in which that is so at the start, and plans are not clear of each other either, is refused.
"""

from collections.abc import Sequence
from math import ceil
from typing import NoReturn

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.drifts import Drifts
from problems.obstacle_paths import ObstaclePaths, are_pieces_clear
from sato.network.encoding import CHOICE, CLEARANCE, REAL
from sato.network.graph import CommunicationGraph
from sato.network.load import Load
from sato.reconfiguration import commitment
from sato.reconfiguration.free_motion import drift_freely, free_motion, simulate
from sato.reconfiguration.offers import Offers
from sato.reconfiguration.orbital_evasion import (
    Detours,
    Flights,
    list_detours,
    make_room,
    offer_detour,
)
from sato.reconfiguration.passive_safety import OfferedDrifts, make_horizon
from sato.reconfiguration.plan import Plan, Plans
from sato.reconfiguration.planning import divide_horizon
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.stopping import Commitment, Commitments, committed_controls, pad_controls
from sato.reconfiguration.surroundings import Surroundings, count_escape_steps
from sato.scenario.errors import InputError

HOLDING_ROUNDS = 1  # in which agents compare what they have committed to


def make_orbital_offers(
    context: DecisionContext, plans: Plans, committed: Commitments, heard_clock: int
) -> tuple[Offers, dict[int, Detours]]:
    """Offer the plans of agents of one component, and what they have committed to.

    An agent without a commitment drifts. `heard_clock` is the clock with the most time left in
    their component, as it was announced.
    """
    mission, agents = context.mission, np.array(list(plans))
    held, clock, steps = _divide_time(context, plans, committed, heard_clock)
    x, u = fly_plans(context, plans, steps)
    held_u = pad_controls(held, steps)
    held_x = simulate(mission, context.state[agents], held_u, context.time, mission.step)
    x, u = np.stack([x, held_x], axis=1), np.stack([u, held_u], axis=1)
    horizon = divide_horizon(mission, context.time, steps, context.leg)
    end = x[..., -1, :].copy()
    for a, plan in enumerate(plans.values()):
        if len(plan.trajectory.u) == steps and plan.target_index is not None:
            end[a, 0] = context.leg.targets[plan.target_index]
    begun = context.step_index if mission.assignment == "given" else clock
    arrival = context.instant + context.leg.steps - begun
    free = free_motion(mission, context.leg, arrival)
    flights, drifts = Flights(mission, horizon, context.time, *free), None
    if mission.is_passively_safe:
        drifting = make_horizon(mission, context.time, steps)
        drifts = OfferedDrifts(drifting, drifting.follow(x, u))
    offers = Offers(
        agents=agents,
        plan_steps=(steps, 0),
        steps=np.full(len(agents), steps),
        horizon=horizon,
        u=u,
        paths=flights.follow(x, u, end),
        is_allowed=np.ones((len(agents), 2), dtype=bool),
        clearance=mission.own_clearances(horizon.clearance, agents),
        drifts=drifts,
    )
    if not mission.has_surroundings:
        return offers, {}
    return _avoid_obstacles(context, flights, offers)


def _divide_time(
    context: DecisionContext, plans: Plans, committed: Commitments, heard_clock: int
) -> tuple[list[Float[Array, "_ m"]], int, int]:
    """Return committed controls, the clock of a component, and the steps of its offers.

    All of a component divide time alike. Given a target, an agent alone knows of its reset.
    """
    mission = context.mission
    held = [committed_controls(mission, i, committed, context.instant) for i in plans]
    planned = [plan.trajectory.u for plan in plans.values()]
    clock = min(heard_clock, *context.memory.clock[list(plans)].tolist())
    first = 0 if mission.assignment == "given" else clock
    lengths = map(len, planned + held)
    return held, clock, max(mission.horizon_steps, context.leg.steps - first, *lengths)


def _avoid_obstacles(
    context: DecisionContext, flights: Flights, offers: Offers
) -> tuple[Offers, dict[int, Detours]]:
    """Allow the plans that are clear of all that an agent knows for longer than what it flies.

    Where neither is clear, list detours. Drifts from these are not compared with others, so
    there are none where agents are to be passively safe.
    """
    mission, around, can_evade = context.mission, context.surroundings, offers.drifts is None
    allowed, detours = offers.is_allowed.copy(), dict[int, Detours]()
    everything = around and drift_on(context, around, flights)
    for row, i in enumerate(offers.agents.tolist()):
        known = around and around.known_to(mission, i, everything, flights.horizon.clearance)
        if known is None:
            continue
        ahead = known.paths.shape[1]
        each = offers.paths[row, :, :ahead]
        clear = [np.asarray(are_pieces_clear(path, known).all(axis=0)) for path in each]
        first = [ahead if own.all() else int(own.argmin()) for own in clear]
        allowed[row, 0], best = first[0] >= first[1], int(first[1] > first[0])
        if can_evade and first[best] < ahead:
            flown = offers.u[row, best], offers.paths[row, best]
            detours[row] = list_detours(flights, i, context.state[i], *flown, known)
    offers = offers._replace(is_allowed=allowed)
    return (make_room(offers) if can_evade else offers), detours


def drift_on(
    context: DecisionContext, around: Surroundings, flights: Flights
) -> ObstaclePaths | None:
    """Return the motion of all that does not decide over a horizon, and a while after it.

    Anything that comes near later than it takes to get out of its way is for later decisions.
    """
    horizon, count, h = flights.horizon, flights.pieces, flights.duration
    flown, mission, d = around.fly(context.mission, horizon), context.mission, context.mission.axes
    if flown is None:
        return None
    T = horizon.steps
    count = min(count, ceil(count_escape_steps(mission, 0.0) * mission.step / h))
    later = np.repeat(flown.paths[:, -1:, -1:], 4, axis=2)
    time = (np.arange(count)[:, None] + np.linspace(0.0, 1.0, 4)) * h
    after = later + time[..., None] * flown.velocity[:, None, None]
    lost = around.is_lost
    if lost.any():
        rest = np.zeros((int(lost.sum()), T, d))
        end = simulate(mission, around.state[lost], rest, context.time, mission.step)[:, -1]
        after[lost] = drift_freely(mission, end, count, context.time + T * mission.step, h)
    return flown._replace(paths=np.concatenate([flown.paths, after], axis=1))


def fly_plans(
    context: DecisionContext, plans: Plans, steps: int
) -> tuple[Float[Array, "agents _ n"], Float[Array, "agents T m"]]:
    """Return the states and controls of plans, and of free motion after them, over some steps."""
    mission, each = context.mission, [plan.trajectory for plan in plans.values()]
    u = pad_controls([own.u for own in each], steps)
    x = np.empty((len(each), steps + 1, 2 * mission.axes))
    for own, states in zip(each, x, strict=True):
        T = len(own.u)
        after = context.time + T * mission.step
        states[: T + 1] = own.x
        states[T:] = simulate(mission, own.x[-1], np.zeros_like(u[0, T:]), after, mission.step)
    return x, u


def give_up_unclear(offers: Offers, is_unclear: Bool[Array, " agents"]) -> Offers:
    """Let agents whose committed trajectories are not clear of others offer their plans alone."""
    drifts = offers.drifts and offers.drifts.drifts
    parts = [part.copy() for part in (offers.u, offers.paths, *(drifts or ()))]
    for part in parts:
        part[is_unclear, -1] = part[is_unclear, 0]
    u, paths, *own = parts
    if offers.drifts is not None:
        offers = offers._replace(drifts=offers.drifts._replace(drifts=Drifts(*own)))
    return offers._replace(u=u, paths=paths)


def commit_in_orbit(
    context: DecisionContext,
    plans: Plans,
    committed: Commitments,
    previous: Plans,
    clocks: Int[Array, " agents"],
) -> commitment.CommitmentChoice:
    """Commit the agents that have planned to trajectories that they have checked.

    The clocks are those before they decided, and `previous` the plans before these.
    """
    done: Commitments = {}
    flown = dict(plans)
    graph = context.graph.relayed if context.mission.is_passively_safe else context.graph
    kept, evading = list[int](), list[int]()
    heard, load = -context.graph.component_max(-clocks), Load.none(len(clocks))
    agents = np.array(list(plans), dtype=int)
    for component in np.unique(context.graph.component[agents]):
        members = agents[context.graph.component[agents] == component].tolist()
        own, around = {i: plans[i] for i in members}, context.surroundings
        is_empty = around is None or not around.is_known[members].any()
        if is_empty and (len(members) == 1 or are_plans_clear(context, own)):
            done |= {i: Commitment(context.instant, plan.trajectory.u) for i, plan in own.items()}
            steps = _divide_time(context, own, committed, int(heard[members[0]]))[-1]
            load = load.plus(_count_holding(graph, members, steps, context.mission.axes))
            rounds, once = graph.diameter + 1, np.isin(np.arange(len(clocks)), members).astype(int)
            load = load.plus(Load.of(graph, members, rounds, (once, CHOICE * once)))
            continue
        offers, detours = make_orbital_offers(context, own, committed, int(heard[members[0]]))
        for row, each in detours.items():
            near = graph.adjacency[offers.agents[row], offers.agents]
            clearance = (offers.clearance[row] + offers.clearance[near]) / 2
            offers = offer_detour(offers, row, each, offers.paths[near, -1], clearance)
        choice, more = choose_in_orbit(offers, graph, commitment.rank_of(offers, own))
        keeps, load = choice == offers.last, load.plus(more)
        if context.instant == 0:
            check_start(offers, choice, graph)
        u = offers.u[np.arange(len(members)), choice]
        done |= {i: Commitment(context.instant, u[a]) for a, i in enumerate(members)}
        kept += offers.agents[keeps].tolist()
        evading += offers.agents[(choice > 0) & ~keeps].tolist()
    flown |= {i: keep_previous(plans[i], previous.get(i)) for i in kept}
    flown |= {i: commitment.leave(context, plans[i]) for i in evading}
    left = {i for i in kept if commitment.leaves_plan(plans[i])}.union(evading)
    if context.mission.is_passively_safe:  # others pass on each message
        load = load.relayed(context.graph.diameter)
    return commitment.CommitmentChoice(done, flown, sorted(left), load)


def are_plans_clear(context: DecisionContext, plans: Plans) -> bool:
    """Tell whether the plans of a component were found clear, as they arrive as asked.

    Then the targets' own motion is what is left to check, which `free_motion` has done.
    """
    left = context.leg.steps - context.step_index
    return all(
        plan.is_clear and plan.target_index is not None and len(plan.trajectory.u) == left
        for plan in plans.values()
    )


def choose_in_orbit(
    offers: Offers, graph: CommunicationGraph, rank: Int[Array, " agents"]
) -> tuple[Int[Array, " agents"], Load]:
    """Let all agents agree on offers, and return their choices.

    The last offer is what an agent has committed to.

    The batched equivalent of `agent_stages.Holding` and `Choosing`.
    """
    i, j, _ = pairs = commitment.list_pairs(offers, graph)
    held = np.full(len(offers.agents), offers.last)
    met = ~commitment.are_clear(offers, held, pairs)
    is_unclear = np.isin(np.arange(len(held)), np.concatenate([i[met], j[met]]))
    choice, load = commitment.choose_offers(give_up_unclear(offers, is_unclear), graph, rank)
    choice[is_unclear & (choice == offers.last)] = 0
    own = offers.agents, int(offers.steps[0]), offers.paths[:1, 0].shape[-1]
    return choice, load.plus(_count_holding(graph, *own))


def _count_holding(
    graph: CommunicationGraph, agents: Sequence[int] | Int[Array, " some"], steps: int, axes: int
) -> Load:
    """Count the load of what agents have committed to, of so many steps, told once."""
    rounds = np.full(len(graph.alive), HOLDING_ROUNDS)
    once = np.isin(np.arange(len(rounds)), agents).astype(int)
    size = CLEARANCE + REAL * axes * (2 + steps)
    return Load.of(graph, agents, rounds, (once, size * once))


def check_start(offers: Offers, choice: Int[Array, " agents"], graph: CommunicationGraph) -> None:
    """Refuse a mission whose first commitments are not clear of each other."""
    i, j, radius = pairs = commitment.list_pairs(offers, graph)
    met = np.flatnonzero(~commitment.are_clear(offers, choice, pairs))
    if not len(met):
        return
    agent, other = (int(offers.agents[rows[met[0]]]) for rows in (i, j))
    if offers.drifts is None:
        refuse_start(agent, other, float(radius[met[0]]))
    raise InputError(
        "plan.passive_safety_m",
        f"agents {agent} and {other} find no plans from every step of which they drift "
        f"{offers.drifts.horizon.distance:g} m apart; a smaller distance, a shorter "
        "passive_safety_min, other starts or more leg.steps would do",
    )


def refuse_start(agent: int, other: int, radius: float) -> NoReturn:
    """Refuse starts from which two agents can neither drift nor fly to their targets."""
    raise InputError(
        "swarm.start",
        f"agents {agent} and {other} can neither drift nor fly to their targets {radius:.4g} m "
        "apart; starts farther apart or without drift, more leg.steps or fewer vehicles would do",
    )


def keep_previous(plan: Plan, previous: Plan | None) -> Plan:
    """Return the plan of an agent that keeps what it had; others have kept it from a new one."""
    kept = plan._replace(target_index=None) if previous is None else previous
    return kept._replace(failure_count=plan.failure_count + 1)
