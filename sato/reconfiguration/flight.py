"""The loop: bid, plan, fly, repeat [Morgan2016, Method 3]."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.transfer import fuel_spent
from sato.network import Network
from sato.reconfiguration.actuators import inexact, push
from sato.reconfiguration.bidding import decide
from sato.reconfiguration.frame import Frame
from sato.reconfiguration.mission import Leg, Loss, Reconfiguration
from sato.reconfiguration.moment import Moment
from sato.reconfiguration.planning import NO_PLANS, Plans, plan
from sato.reconfiguration.pricing import Minds

PATIENCE = 20  # times its steps after which a leg is given up

Event = dict[str, Any]


class Swarm(NamedTuple):
    """Everything there is at an instant."""

    x: Float[Array, "agents n"]  # true states
    alive: Bool[Array, " agents"]
    spent: Float[Array, " agents"]  # fuel [m/s]
    minds: Minds
    plans: Plans
    now: int  # steps since the first leg began


def fly(mission: Reconfiguration, rng: np.random.Generator) -> Iterator[Frame]:
    """Fly every leg; yield a frame a control instant.

    Args:
        mission: What to fly.
        rng: Draws losses, disturbances and noise.
    """
    believed = mission.believed or int(mission.alive.sum())
    # Who joins later knows of no more than its own need, and learns m from who it meets.
    m = np.where(mission.alive, believed, 1)
    swarm = Swarm(mission.start, mission.alive, np.zeros(len(m)), Minds.fresh(m), NO_PLANS, 0)
    events: list[Event] = []
    for number, leg in enumerate(mission.legs):
        m = swarm.minds.believed
        if leg.recount:
            m = np.where(swarm.minds.bidders > 0, swarm.minds.bidders, m)
        swarm = swarm._replace(minds=Minds.fresh(m), plans=NO_PLANS)
        events.append({"kind": "leg_start", "leg": number, "agents": _numbers(swarm.alive)})
        swarm, events = yield from _fly_leg(mission, number, swarm, events, rng)
    nothing = np.full((len(mission.start), mission.model.axes), np.nan)
    yield _frame(mission, number, swarm, _network(mission, swarm), nothing, nothing, None, events)


def _fly_leg(
    mission: Reconfiguration,
    number: int,
    swarm: Swarm,
    events: list[Event],
    rng: np.random.Generator,
) -> Any:
    leg = mission.legs[number]
    for k in range(PATIENCE * leg.steps + 1):
        swarm, changes = _come_and_go(mission, leg, swarm, k, rng)
        events += changes
        if k > 0 and (swarm.minds.clock[swarm.alive] >= leg.steps).all():
            break
        if k == PATIENCE * leg.steps:
            what = f"the leg is given up after {PATIENCE} times its steps"
            events.append({"kind": "infeasible", "agents": _numbers(swarm.alive), "what": what})
            break
        network = _network(mission, swarm)
        measured = _measure(mission, swarm, rng)
        joined = [i for event in changes if event["kind"] == "join" for i in event["agents"]]
        for part, bids in _who_decides(mission, leg, swarm, network, joined, k):
            moment = Moment(mission, leg, part, measured, k, swarm.now * mission.step)
            swarm, told = _replan(moment, swarm, bids)
            events += told
        control = swarm.plans.control(k, swarm.alive, mission.model.axes)
        applied = _apply(mission, control, rng)
        seen = measured if mission.position_noise or mission.velocity_noise else None
        yield _frame(mission, number, swarm, network, control, applied, seen, events)
        swarm, events = _advance(mission, leg, swarm, control, applied)
    events.append(_end(mission, number, swarm))
    return swarm, events


def _who_decides(
    mission: Reconfiguration, leg: Leg, swarm: Swarm, network: Network, joined: list[int], k: int
) -> list[tuple[Network, bool]]:
    """The networks that plan at a step, and whether they bid first.

    Who joins calls for an auction in its network at once; a loss is silence, and is
    noticed when the next auction is due. A network that is about to arrive keeps to its
    plans: with so few steps left, a small correction takes much thrust.
    """
    called: list[tuple[Network, bool]] = []
    if joined:
        those = np.isin(network.component, network.component[joined])
        called, network = [(network.among(those), True)], network.among(~those)
    left = leg.steps - swarm.minds.clock
    unsure = (left >= mission.commit_steps) | ~swarm.plans.lead_there(swarm.minds, k, left)
    network = network.among(network.largest(unsure.astype(int)).astype(bool))
    if k % mission.replan_steps == 0 and network.alive.any():
        called.append((network, k % mission.auction_steps == 0))
    return called


def _replan(moment: Moment, swarm: Swarm, bids: bool) -> tuple[Swarm, list[Event]]:
    events: list[Event] = []
    solves = 0
    if bids:
        decision = decide(moment, swarm.minds, swarm.plans.fuel_left(moment, swarm.minds))
        moved = swarm.alive & (decision.minds.target != swarm.minds.target)
        if decision.reset.any():
            events.append({"kind": "reset", "agents": _numbers(decision.reset)})
        if moved.any():
            targets = decision.minds.target[moved].tolist()
            events.append({"kind": "assignment", "agents": _numbers(moved), "target": targets})
        swarm, solves = swarm._replace(minds=decision.minds), decision.solves
    plans, told = plan(moment, swarm.minds, swarm.spent, swarm.plans, solves)
    return swarm._replace(plans=plans), events + told


def _network(mission: Reconfiguration, swarm: Swarm) -> Network:
    position = swarm.x[:, : mission.model.axes]
    return Network.within(position, mission.comm_radius, swarm.alive)


def _measure(
    mission: Reconfiguration, swarm: Swarm, rng: np.random.Generator
) -> Float[Array, "agents n"]:
    noise = np.repeat([mission.position_noise, mission.velocity_noise], mission.model.axes)
    if not noise.any():
        return swarm.x
    return np.asarray(swarm.x + noise * rng.standard_normal(swarm.x.shape))


def _apply(
    mission: Reconfiguration, control: Float[Array, "agents d"], rng: np.random.Generator
) -> Float[Array, "agents d"]:
    wind = mission.disturbance * rng.standard_normal(control.shape)
    if inexact(mission):
        agents, d = control.shape
        control = push(mission, control, rng.standard_normal((agents, 1 + d)))
    return control + wind if mission.disturbance else control


def _advance(
    mission: Reconfiguration, leg: Leg, swarm: Swarm, control: Array, applied: Array
) -> tuple[Swarm, list[Event]]:
    alive, time = swarm.alive, swarm.now * mission.step
    flown = mission.truth.fly(swarm.x, np.nan_to_num(applied), time, mission.step)[1]
    burnt = fuel_spent(np.nan_to_num(control)[:, None], mission.step, mission.fuel_norm)
    clock = np.where(alive, np.minimum(swarm.minds.clock + 1, leg.steps), 0)
    arrived = alive & (clock == leg.steps) & (swarm.minds.clock < leg.steps)
    events: list[Event] = []
    if arrived.any():
        events.append({"kind": "arrival", "agents": _numbers(arrived)})
    swarm = swarm._replace(
        x=np.where(alive[:, None], flown, swarm.x),
        spent=swarm.spent + burnt,
        minds=replace(swarm.minds, clock=clock),
        now=swarm.now + 1,
    )
    return swarm, events


def _come_and_go(
    mission: Reconfiguration, leg: Leg, swarm: Swarm, k: int, rng: np.random.Generator
) -> tuple[Swarm, list[Event]]:
    """Losses and arrivals that fall on this step."""
    alive, minds = swarm.alive.copy(), swarm.minds
    events: list[Event] = []
    for arrival in leg.arrivals:
        if arrival.at_step == k:
            alive[list(arrival.agents)] = True
            events.append({"kind": "join", "agents": list(arrival.agents)})
    for loss in leg.losses:
        if loss.at_step == k:
            lost = _lost(loss, swarm.x[:, : mission.model.axes], alive, rng)
            alive[lost] = False
            minds = replace(minds, target=np.where(alive, minds.target, -1))
            events.append({"kind": "loss", "agents": sorted(lost)})
    return swarm._replace(alive=alive, minds=minds), events


def _lost(loss: Loss, position: Array, alive: Array, rng: np.random.Generator) -> list[int]:
    live = np.flatnonzero(alive)
    if loss.kind == "agents":
        return [i for i in loss.agents if alive[i]]
    count = round(loss.share * len(live))
    if loss.kind == "random":
        return [int(i) for i in rng.choice(live, count, replace=False)]
    away = np.linalg.norm(position[live] - position[live].mean(axis=0), axis=1)
    return [int(i) for i in live[np.argsort(away, kind="stable")[:count]]]


def _end(mission: Reconfiguration, number: int, swarm: Swarm) -> Event:
    return {
        "kind": "leg_end",
        "leg": number,
        "agents": _numbers(swarm.alive),
        "target": swarm.minds.target.tolist(),
        "believed": swarm.minds.believed.tolist(),
        "component": _network(mission, swarm).component.tolist(),
    }


def _frame(
    mission: Reconfiguration,
    number: int,
    swarm: Swarm,
    network: Network,
    control: Array,
    applied: Array,
    measured: Array | None,
    events: list[Event],
) -> Frame:
    d = mission.model.axes
    return Frame(
        time=swarm.now * mission.step,
        position=swarm.x[:, :d],
        velocity=swarm.x[:, d:],
        alive=swarm.alive,
        component=network.component,
        control=control,
        applied_control=applied,
        leg=number,
        target=np.where(swarm.alive, swarm.minds.target, -1),
        believed=swarm.minds.believed,
        measured=measured,
        events=tuple(events),
    )


def _numbers(which: Bool[Array, " agents"]) -> list[int]:
    return [int(i) for i in np.flatnonzero(which)]
