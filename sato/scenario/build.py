"""From the tables of a file to the mission that is flown."""

from dataclasses import replace
from math import ceil, inf, isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import ClohessyWiltshire, LinearModel, hold
from sato.reconfiguration.mission import Arrival, Leg, Reconfiguration
from sato.scenario.legs import lost, occupied, wanted
from sato.scenario.refusal import Refusal
from sato.scenario.start import AnyStart, Listed, Place, positions
from sato.scenario.tables import AnyModel, Disturbance, LegTable, Plan, Swarm

TOLERANCE = 1e-6  # of the least spacing of the targets: what counts as there
SIGMAS = 6.0  # of what chance adds to it: an agent is further out once in 10⁷ arrivals


class Space(NamedTuple):
    """What positions become states in."""

    model: LinearModel
    comm_radius: float  # [m]
    collision_radius: float  # [m]
    max_speed: float  # [m/s]


def build(
    swarm: Swarm,
    moves: AnyModel,
    plan: Plan,
    disturbance: Disturbance,
    legs: list[LegTable],
    rng: np.random.Generator,
) -> Reconfiguration:
    """The mission, with everything drawn that is left to chance.

    Raises:
        Refusal: The starts or the targets cannot be as they are asked for.
    """
    limit = moves.max_speed_m_s or inf
    space = Space(moves.model(), swarm.comm_radius_m, swarm.collision_radius_m, limit)
    most = wanted(swarm, legs)
    targets = [_targets(space, k, leg, most[k]) for k, leg in enumerate(legs)]
    nobody = np.empty((0, space.model.axes))
    start = _start(space, "swarm.start", swarm.start, swarm.agents, nobody, rng)
    flown: list[Leg] = []
    for number, leg in enumerate(legs):
        before = targets[number - 1][: most[number - 1]] if number else None
        come, arrivals = _joining(space, number, leg, start, before, rng)
        start = np.concatenate([start, *come])
        losses = tuple(lost(loss) for loss in leg.lose)
        flown.append(Leg(targets[number], leg.steps, losses, arrivals, leg.recount))
    mission = Reconfiguration(
        model=space.model,
        start=start,
        alive=np.arange(len(start)) < swarm.agents,
        legs=tuple(flown),
        step=plan.step_s,
        comm_radius=swarm.comm_radius_m,
        collision_radius=swarm.collision_radius_m,
        max_control=moves.max_control_m_s2,
        max_speed=limit,
        fuel_norm=moves.fuel_norm,
        control_norm=moves.control_norm,
        horizon_steps=plan.horizon_steps,
        replan_steps=plan.replan_steps,
        auction_steps=plan.auction_steps,
        believed=swarm.believed or 0,
        cost=plan.cost,
        tie_break=plan.tie_break,
        bidder_ids=plan.ids,
        disturbance=disturbance.acceleration_m_s2,
        position_noise=disturbance.position_m,
        velocity_noise=disturbance.velocity_m_s,
    )
    return _scaled(mission, plan)


def _scaled(mission: Reconfiguration, plan: Plan) -> Reconfiguration:
    # A single target has no spacing; the least distance that there may be will do.
    alone = not isfinite(mission.spacing)
    s = mission.collision_radius if alone else mission.spacing
    astray, drifting = _missed(mission)
    near = TOLERANCE * s + astray
    automatic = mission.tie_break * s**2 / 2 or None if alone else None
    return replace(
        mission,
        position_tolerance=plan.position_tolerance_m or near,
        velocity_tolerance=plan.velocity_tolerance_m_s
        or (plan.position_tolerance_m or TOLERANCE * s) / mission.step + drifting,
        epsilon=automatic if plan.epsilon == "auto" else plan.epsilon,
    )


def _missed(mission: Reconfiguration) -> tuple[float, float]:
    """How far chance leaves an agent from its target [m], and how fast [m/s].

    An agent that brakes with all it has mends nothing, and two steps is the least in which a
    control sets both place and speed right. What it believed wrongly when it planned before
    that, and the pushes since, remain.
    """
    d = mission.model.axes
    places = np.concatenate([mission.start, *(leg.targets for leg in mission.legs)])[:, :d]
    noise = np.repeat([mission.position_noise, mission.velocity_noise], d)
    if not noise.any() and not mission.disturbance:
        return 0.0, 0.0
    steps = min(leg.steps for leg in mission.legs)
    fast = min(mission.max_speed, 2 * float(np.ptp(places, axis=0).max()) / (steps * mission.step))
    braking = ceil(min(fast / (mission.max_control * mission.step), steps))
    left = hold(mission.model, mission.step, 1 + mission.replan_steps + braking)
    spread = np.diag(noise**2)
    for A, B in zip(left.A, left.B, strict=True):
        spread = A @ spread @ A.T + mission.disturbance**2 * B @ B.T
    worst = [np.linalg.eigvalsh(part).max() for part in (spread[:d, :d], spread[d:, d:])]
    place, speed = SIGMAS * np.sqrt(np.maximum(worst, 0.0))
    return float(place), float(speed)


def _targets(space: Space, number: int, leg: LegTable, most: int) -> Float[Array, "k n"]:
    where = f"leg.{number}.shape"
    try:
        placed = leg.shape.place(leg.targets or most, space.model.axes, space.collision_radius)
    except Refusal as refusal:
        raise refusal.inside(where) from refusal
    states = np.hstack([placed, _drifting(space.model, placed)])
    _check_speed(space, where, "target", states)
    return states


def _joining(
    space: Space,
    number: int,
    leg: LegTable,
    start: Float[Array, "k n"],
    before: Float[Array, "m n"] | None,
    rng: np.random.Generator,
) -> tuple[list[Float[Array, "_ n"]], tuple[Arrival, ...]]:
    come: list[Array] = []
    arrivals: list[Arrival] = []
    d, rows = space.model.axes, len(start)
    for i, join in enumerate(leg.join):
        there = occupied(number, join.at_step, start, before)
        with_them = [c for c, a in zip(come, arrivals, strict=True) if a.at_step == join.at_step]
        taken = np.concatenate([there, *with_them])[:, :d]
        where = f"leg.{number}.join.{i}.start"
        come.append(_start(space, where, join.start, join.agents, taken, rng))
        arrivals.append(Arrival(tuple(range(rows, rows + join.agents)), join.at_step))
        rows += join.agents
    return come, tuple(arrivals)


def _start(
    space: Space,
    where: str,
    start: AnyStart,
    count: int,
    taken: Float[Array, "k d"],
    rng: np.random.Generator,
) -> Float[Array, "count n"]:
    axes = space.model.axes
    try:
        place = Place(axes, space.comm_radius, space.collision_radius, taken)
        placed = positions(start, count, place, rng)
        given = start.velocities(count, axes) if isinstance(start, Listed) else None
    except Refusal as refusal:
        raise refusal.inside(where) from refusal
    states = np.hstack([placed, _drifting(space.model, placed) if given is None else given])
    _check_speed(space, where, "agent", states)
    return states


def _drifting(model: LinearModel, placed: Float[Array, "k d"]) -> Float[Array, "k d"]:
    # With which an agent stays about where it is: at rest, or on an orbit that closes.
    if isinstance(model, ClohessyWiltshire):
        return model.bounded(placed)
    return np.zeros_like(placed)


def _check_speed(space: Space, where: str, who: str, states: Float[Array, "k n"]) -> None:
    speed = np.linalg.norm(states[:, space.model.axes :], axis=1)
    i = int(np.argmax(speed))
    if speed[i] <= space.max_speed * (1 + 1e-12):
        return
    goes = "starts at" if who == "agent" else "has to be taken up at"
    raise Refusal(
        where,
        f"{who} {i} {goes} {speed[i]:.4g} m/s, faster than model.max_speed_m_s = "
        f"{space.max_speed:g}; {speed[i]:.4g} or more would do, or slower ones",
    )
