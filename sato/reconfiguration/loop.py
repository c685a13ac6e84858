"""Loop of a reconfiguration: bid, plan, fly, repeat [Morgan2016, Method 3]."""

from collections.abc import Generator, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.transfer import compute_fuel
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.assignment import assign_targets
from sato.reconfiguration.disturbances import disturb_control, draw_losses, measure
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import NO_PLANS, Plans, plan_trajectories
from sato.reconfiguration.state import (
    AgentMemory,
    DecisionContext,
    Event,
    ReconfigurationFrame,
    to_indices,
)

MAX_LEG_FACTOR = 20  # times its steps after which a leg is given up


class ReconfigurationState(NamedTuple):
    """True states of the agents, and all that they remember."""

    x: Float[Array, "agents n"]
    alive: Bool[Array, " agents"]
    fuel_used: Float[Array, " agents"]  # [m/s]
    memory: AgentMemory
    plans: Plans
    step_index: int  # steps since the first leg began


def simulate(mission: Reconfiguration, rng: np.random.Generator) -> Iterator[ReconfigurationFrame]:
    """Simulate every leg of a drawn mission; yield a frame at every control instant.

    Args:
        mission: A drawn mission.
        rng: Draws losses, disturbances and noise.
    """
    # An agent that joins later knows of itself alone, and learns m from those that it meets.
    m = np.where(mission.alive, mission.target_count or int(mission.alive.sum()), 1)
    state = ReconfigurationState(
        mission.initial_states, mission.alive, np.zeros(len(m)), AgentMemory.initial(m), NO_PLANS, 0
    )
    events: list[Event] = []
    for number, leg in enumerate(mission.legs):
        m = state.memory.target_count
        if leg.recount:
            m = np.where(state.memory.bidder_count > 0, state.memory.bidder_count, m)
        state = state._replace(memory=AgentMemory.initial(m), plans=NO_PLANS)
        events.append({"kind": "leg_start", "leg": number, "agents": to_indices(state.alive)})
        state, events = yield from _simulate_leg(mission, number, state, events, rng)
    none = np.full((len(mission.initial_states), mission.axes), np.nan)
    graph = _make_graph(mission, state)
    yield _make_frame(mission, number, state, graph, none, none, None, events)


def _simulate_leg(
    mission: Reconfiguration,
    number: int,
    state: ReconfigurationState,
    events: list[Event],
    rng: np.random.Generator,
) -> Generator[ReconfigurationFrame, None, tuple[ReconfigurationState, list[Event]]]:
    leg = mission.legs[number]
    for k in range(MAX_LEG_FACTOR * leg.steps + 1):
        state, changes = _apply_losses_and_joins(mission, number, state, k, rng)
        events += changes
        if k > 0 and (state.memory.clock[state.alive] >= leg.steps).all():
            break
        if k == MAX_LEG_FACTOR * leg.steps:
            what = f"the leg is given up after {MAX_LEG_FACTOR} times its steps"
            events.append({"kind": "infeasible", "agents": to_indices(state.alive), "what": what})
            break
        graph = _make_graph(mission, state)
        measured = measure(mission, state.x, rng)
        joined = [i for event in changes if event["kind"] == "join" for i in event["agents"]]
        for deciding, bids in _schedule_decisions(mission, number, state, graph, joined, k):
            time = state.step_index * mission.step
            context = DecisionContext(mission, leg, deciding, measured, k, time)
            state, decided = _decide(context, state, bids)
            events += decided
        control = state.plans.controls_at(k, state.alive, mission.axes)
        applied = disturb_control(mission, control, rng)
        seen = measured if mission.position_noise or mission.velocity_noise else None
        yield _make_frame(mission, number, state, graph, control, applied, seen, events)
        state, events = _propagate(mission, leg.steps, state, control, applied)
    events.append(_make_leg_end(mission, number, state))
    return state, events


def _schedule_decisions(
    mission: Reconfiguration,
    number: int,
    state: ReconfigurationState,
    graph: CommunicationGraph,
    joined: list[int],
    k: int,
) -> list[tuple[CommunicationGraph, bool]]:
    """Return the components that plan at a step, and whether they bid first.

    An agent that joins calls for an auction in its component at once; a loss is silence, and
    is noticed when the next auction is due. A component that is about to arrive keeps its
    plans: with so few steps left, a small correction takes much control.
    """
    decisions: list[tuple[CommunicationGraph, bool]] = []
    if joined:
        beside = np.isin(graph.component, graph.component[joined])
        decisions, graph = [(graph.subgraph(beside), True)], graph.subgraph(~beside)
    left = mission.legs[number].steps - state.memory.clock
    is_frozen = (left < mission.freeze_steps) & state.plans.reaches_target(state.memory, k, left)
    graph = graph.subgraph(graph.component_max((~is_frozen).astype(int)).astype(bool))
    if k % mission.replan_steps == 0 and graph.alive.any():
        decisions.append((graph, k % mission.auction_steps == 0))
    return decisions


def _decide(
    context: DecisionContext, state: ReconfigurationState, bids: bool
) -> tuple[ReconfigurationState, list[Event]]:
    events: list[Event] = []
    solve_count, memory = 0, state.memory
    if bids:
        decision = assign_targets(context, memory, state.plans.remaining_fuel(context, memory))
        moved = state.alive & (decision.memory.target_index != memory.target_index)
        memory, solve_count = decision.memory, decision.solve_count
        if decision.was_reset.any():
            events.append({"kind": "reset", "agents": to_indices(decision.was_reset)})
        if moved.any():
            targets = memory.target_index[moved].tolist()
            events.append({"kind": "assignment", "agents": to_indices(moved), "target": targets})
    plans, planned = plan_trajectories(context, memory, state.fuel_used, state.plans, solve_count)
    return state._replace(memory=memory, plans=plans), events + planned


def _make_graph(mission: Reconfiguration, state: ReconfigurationState) -> CommunicationGraph:
    position = state.x[:, : mission.axes]
    return CommunicationGraph.from_positions(position, mission.comm_radius, state.alive)


def _propagate(
    mission: Reconfiguration,
    steps: int,
    state: ReconfigurationState,
    control: Array,
    applied: Array,
) -> tuple[ReconfigurationState, list[Event]]:
    alive, time, clock = state.alive, state.step_index * mission.step, state.memory.clock
    flown = mission.flown_plant.propagate(state.x, np.nan_to_num(applied), time, mission.step)[1]
    burned = compute_fuel(np.nan_to_num(control)[:, None], mission.step, mission.fuel_norm)
    later = np.where(alive, np.minimum(clock + 1, steps), 0)
    arrived = alive & (later == steps) & (clock < steps)
    events: list[Event] = []
    if arrived.any():
        events.append({"kind": "arrival", "agents": to_indices(arrived)})
    state = state._replace(
        x=np.where(alive[:, None], flown, state.x),
        fuel_used=state.fuel_used + burned,
        memory=replace(state.memory, clock=later),
        step_index=state.step_index + 1,
    )
    return state, events


def _apply_losses_and_joins(
    mission: Reconfiguration,
    number: int,
    state: ReconfigurationState,
    k: int,
    rng: np.random.Generator,
) -> tuple[ReconfigurationState, list[Event]]:
    alive, memory = state.alive.copy(), state.memory
    events: list[Event] = []
    for agents, at_step in mission.joining(number):
        if at_step == k:
            alive[agents] = True
            events.append({"kind": "join", "agents": agents})
    for loss in mission.legs[number].losses:
        if loss.at_step == k:
            lost = draw_losses(loss, state.x[:, : mission.axes], alive, rng)
            alive[lost] = False
            memory = replace(memory, target_index=np.where(alive, memory.target_index, -1))
            events.append({"kind": "loss", "agents": sorted(lost)})
    return state._replace(alive=alive, memory=memory), events


def _make_leg_end(mission: Reconfiguration, number: int, state: ReconfigurationState) -> Event:
    return {
        "kind": "leg_end",
        "leg": number,
        "agents": to_indices(state.alive),
        "target": state.memory.target_index.tolist(),
        "believed": state.memory.target_count.tolist(),
        "component": _make_graph(mission, state).component.tolist(),
    }


def _make_frame(
    mission: Reconfiguration,
    number: int,
    state: ReconfigurationState,
    graph: CommunicationGraph,
    control: Array,
    applied: Array,
    measured: Array | None,
    events: list[Event],
) -> ReconfigurationFrame:
    d = mission.axes
    return ReconfigurationFrame(
        time=state.step_index * mission.step,
        position=state.x[:, :d],
        velocity=state.x[:, d:],
        alive=state.alive,
        component=graph.component,
        control=control,
        applied_control=applied,
        leg_index=number,
        target_index=np.where(state.alive, state.memory.target_index, -1),
        target_count=state.memory.target_count,
        measured_position=None if measured is None else measured[:, :d],
        measured_velocity=None if measured is None else measured[:, d:],
        events=tuple(events),
    )
