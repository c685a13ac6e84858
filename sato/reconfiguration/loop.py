"""The loop: bid, plan, fly, repeat [Morgan2016, Method 3]."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.transfer import compute_fuel
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.assignment import assign_targets
from sato.reconfiguration.auction_costs import AgentMemory
from sato.reconfiguration.disturbances import apply_thruster_errors, has_thruster_errors
from sato.reconfiguration.frame import ReconfigurationFrame
from sato.reconfiguration.mission import Leg, Loss, Reconfiguration
from sato.reconfiguration.moment import DecisionContext
from sato.reconfiguration.planning import NO_PLANS, Plans, plan_trajectories

MAX_LEG_FACTOR = 20  # times its steps after which a leg is given up

Event = dict[str, Any]


class ReconfigurationState(NamedTuple):
    """Everything there is at an instant."""

    x: Float[Array, "agents n"]  # true states
    alive: Bool[Array, " agents"]
    fuel_used: Float[Array, " agents"]  # fuel [m/s]
    memory: AgentMemory
    plans: Plans
    step_index: int  # steps since the first leg began


def fly(mission: Reconfiguration, rng: np.random.Generator) -> Iterator[ReconfigurationFrame]:
    """Fly every leg; yield a frame a control instant.

    Args:
        mission: What to fly.
        rng: Draws losses, disturbances and noise.
    """
    believed = mission.target_count or int(mission.alive.sum())
    # Who joins later knows of no more than its own need, and learns m from who it meets.
    m = np.where(mission.alive, believed, 1)
    swarm = ReconfigurationState(
        mission.initial_states, mission.alive, np.zeros(len(m)), AgentMemory.initial(m), NO_PLANS, 0
    )
    events: list[Event] = []
    for number, leg in enumerate(mission.legs):
        m = swarm.memory.target_count
        if leg.recount:
            m = np.where(swarm.memory.bidder_count > 0, swarm.memory.bidder_count, m)
        swarm = swarm._replace(memory=AgentMemory.initial(m), plans=NO_PLANS)
        events.append({"kind": "leg_start", "leg": number, "agents": _to_indices(swarm.alive)})
        swarm, events = yield from _fly_leg(mission, number, swarm, events, rng)
    nothing = np.full((len(mission.initial_states), mission.linear_model.axes), np.nan)
    yield _make_frame(
        mission, number, swarm, _make_graph(mission, swarm), nothing, nothing, None, events
    )


def _fly_leg(
    mission: Reconfiguration,
    number: int,
    swarm: ReconfigurationState,
    events: list[Event],
    rng: np.random.Generator,
) -> Any:
    leg = mission.legs[number]
    for k in range(MAX_LEG_FACTOR * leg.steps + 1):
        swarm, changes = _apply_losses_and_joins(mission, number, swarm, k, rng)
        events += changes
        if k > 0 and (swarm.memory.clock[swarm.alive] >= leg.steps).all():
            break
        if k == MAX_LEG_FACTOR * leg.steps:
            what = f"the leg is given up after {MAX_LEG_FACTOR} times its steps"
            events.append({"kind": "infeasible", "agents": _to_indices(swarm.alive), "what": what})
            break
        network = _make_graph(mission, swarm)
        measured = _measure(mission, swarm, rng)
        joined = [i for event in changes if event["kind"] == "join" for i in event["agents"]]
        for part, bids in _schedule_decisions(mission, leg, swarm, network, joined, k):
            moment = DecisionContext(
                mission, leg, part, measured, k, swarm.step_index * mission.step
            )
            swarm, told = _update_plans(moment, swarm, bids)
            events += told
        control = swarm.plans.controls_at(k, swarm.alive, mission.linear_model.axes)
        applied = _disturb_control(mission, control, rng)
        seen = measured if mission.position_noise or mission.velocity_noise else None
        yield _make_frame(mission, number, swarm, network, control, applied, seen, events)
        swarm, events = _propagate(mission, leg, swarm, control, applied)
    events.append(_make_leg_end(mission, number, swarm))
    return swarm, events


def _schedule_decisions(
    mission: Reconfiguration,
    leg: Leg,
    swarm: ReconfigurationState,
    network: CommunicationGraph,
    joined: list[int],
    k: int,
) -> list[tuple[CommunicationGraph, bool]]:
    """The networks that plan at a step, and whether they bid first.

    Who joins calls for an auction in its network at once; a loss is silence, and is
    noticed when the next auction is due. A network that is about to arrive keeps to its
    plans: with so few steps left, a small correction takes much thrust.
    """
    called: list[tuple[CommunicationGraph, bool]] = []
    if joined:
        those = np.isin(network.component, network.component[joined])
        called, network = [(network.subgraph(those), True)], network.subgraph(~those)
    left = leg.steps - swarm.memory.clock
    unsure = (left >= mission.freeze_steps) | ~swarm.plans.reaches_target(swarm.memory, k, left)
    network = network.subgraph(network.component_max(unsure.astype(int)).astype(bool))
    if k % mission.replan_steps == 0 and network.alive.any():
        called.append((network, k % mission.auction_steps == 0))
    return called


def _update_plans(
    moment: DecisionContext, swarm: ReconfigurationState, bids: bool
) -> tuple[ReconfigurationState, list[Event]]:
    events: list[Event] = []
    solves = 0
    if bids:
        decision = assign_targets(
            moment, swarm.memory, swarm.plans.remaining_fuel(moment, swarm.memory)
        )
        moved = swarm.alive & (decision.memory.target_index != swarm.memory.target_index)
        if decision.was_reset.any():
            events.append({"kind": "reset", "agents": _to_indices(decision.was_reset)})
        if moved.any():
            targets = decision.memory.target_index[moved].tolist()
            events.append({"kind": "assignment", "agents": _to_indices(moved), "target": targets})
        swarm, solves = swarm._replace(memory=decision.memory), decision.solve_count
    plans, told = plan_trajectories(moment, swarm.memory, swarm.fuel_used, swarm.plans, solves)
    return swarm._replace(plans=plans), events + told


def _make_graph(mission: Reconfiguration, swarm: ReconfigurationState) -> CommunicationGraph:
    position = swarm.x[:, : mission.linear_model.axes]
    return CommunicationGraph.from_positions(position, mission.comm_radius, swarm.alive)


def _measure(
    mission: Reconfiguration, swarm: ReconfigurationState, rng: np.random.Generator
) -> Float[Array, "agents n"]:
    noise = np.repeat([mission.position_noise, mission.velocity_noise], mission.linear_model.axes)
    if not noise.any():
        return swarm.x
    return np.asarray(swarm.x + noise * rng.standard_normal(swarm.x.shape))


def _disturb_control(
    mission: Reconfiguration, control: Float[Array, "agents d"], rng: np.random.Generator
) -> Float[Array, "agents d"]:
    wind = mission.disturbance * rng.standard_normal(control.shape)
    if has_thruster_errors(mission):
        agents, d = control.shape
        control = apply_thruster_errors(mission, control, rng.standard_normal((agents, 1 + d)))
    return control + wind if mission.disturbance else control


def _propagate(
    mission: Reconfiguration, leg: Leg, swarm: ReconfigurationState, control: Array, applied: Array
) -> tuple[ReconfigurationState, list[Event]]:
    alive, time = swarm.alive, swarm.step_index * mission.step
    flown = mission.flown_plant.propagate(swarm.x, np.nan_to_num(applied), time, mission.step)[1]
    burnt = compute_fuel(np.nan_to_num(control)[:, None], mission.step, mission.fuel_norm)
    clock = np.where(alive, np.minimum(swarm.memory.clock + 1, leg.steps), 0)
    arrived = alive & (clock == leg.steps) & (swarm.memory.clock < leg.steps)
    events: list[Event] = []
    if arrived.any():
        events.append({"kind": "arrival", "agents": _to_indices(arrived)})
    swarm = swarm._replace(
        x=np.where(alive[:, None], flown, swarm.x),
        fuel_used=swarm.fuel_used + burnt,
        memory=replace(swarm.memory, clock=clock),
        step_index=swarm.step_index + 1,
    )
    return swarm, events


def _apply_losses_and_joins(
    mission: Reconfiguration,
    number: int,
    swarm: ReconfigurationState,
    k: int,
    rng: np.random.Generator,
) -> tuple[ReconfigurationState, list[Event]]:
    """Losses and arrivals that fall on this step."""
    alive, minds = swarm.alive.copy(), swarm.memory
    events: list[Event] = []
    for agents, at_step in mission.joining(number):
        if at_step == k:
            alive[agents] = True
            events.append({"kind": "join", "agents": agents})
    for loss in mission.legs[number].losses:
        if loss.at_step == k:
            lost = _select_lost(loss, swarm.x[:, : mission.linear_model.axes], alive, rng)
            alive[lost] = False
            minds = replace(minds, target_index=np.where(alive, minds.target_index, -1))
            events.append({"kind": "loss", "agents": sorted(lost)})
    return swarm._replace(alive=alive, memory=minds), events


def _select_lost(loss: Loss, position: Array, alive: Array, rng: np.random.Generator) -> list[int]:
    live = np.flatnonzero(alive)
    if loss.kind == "agents":
        return [i for i in loss.agents if alive[i]]
    count = round((loss.share or 0.0) * len(live))
    if loss.kind == "random":
        return [int(i) for i in rng.choice(live, count, replace=False)]
    away = np.linalg.norm(position[live] - position[live].mean(axis=0), axis=1)
    return [int(i) for i in live[np.argsort(away, kind="stable")[:count]]]


def _make_leg_end(mission: Reconfiguration, number: int, swarm: ReconfigurationState) -> Event:
    return {
        "kind": "leg_end",
        "leg": number,
        "agents": _to_indices(swarm.alive),
        "target": swarm.memory.target_index.tolist(),
        "believed": swarm.memory.target_count.tolist(),
        "component": _make_graph(mission, swarm).component.tolist(),
    }


def _make_frame(
    mission: Reconfiguration,
    number: int,
    swarm: ReconfigurationState,
    network: CommunicationGraph,
    control: Array,
    applied: Array,
    measured: Array | None,
    events: list[Event],
) -> ReconfigurationFrame:
    d = mission.linear_model.axes
    return ReconfigurationFrame(
        time=swarm.step_index * mission.step,
        position=swarm.x[:, :d],
        velocity=swarm.x[:, d:],
        alive=swarm.alive,
        component=network.component,
        control=control,
        applied_control=applied,
        leg_index=number,
        target_index=np.where(swarm.alive, swarm.memory.target_index, -1),
        target_count=swarm.memory.target_count,
        measured_position=None if measured is None else measured[:, :d],
        measured_velocity=None if measured is None else measured[:, d:],
        events=tuple(events),
    )


def _to_indices(which: Bool[Array, " agents"]) -> list[int]:
    return [int(i) for i in np.flatnonzero(which)]
