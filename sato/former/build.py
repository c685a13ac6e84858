"""From the tables of a file to the mission that is flown."""

from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import LinearModel
from sato.reconfiguration.mission import Join, Leg, Reconfiguration
from sato.former.legs import lost, occupied, wanted
from sato.former.margin import margin
from sato.former.refusal import Refusal, upward
from sato.former.start import AnyStart, Listed, Place, positions
from sato.former.tables import Disturbance, LegTable, Plan, Swarm
from sato.former.tolerance import tolerances
from sato.former.world import World, elsewhere


class Space(NamedTuple):
    """What positions become states in."""

    world: World
    model: LinearModel
    comm_radius: float  # [m]
    collision_radius: float  # [m]
    max_speed: float  # [m/s]
    times: tuple[float, ...]  # at which the swarm starts, is joined, and arrives [s]


def build(
    swarm: Swarm,
    world: World,
    plan: Plan,
    disturbance: Disturbance,
    legs: list[LegTable],
    rng: np.random.Generator,
) -> Reconfiguration:
    """The mission, with everything drawn that is left to chance.

    Raises:
        Refusal: The starts or the targets cannot be as they are asked for.
    """
    limit = world.moves.max_speed_m_s or inf
    clock = _clock(plan, legs)
    space = Space(
        world,
        world.model(),
        swarm.comm_radius_m,
        swarm.collision_radius_m,
        limit,
        (*clock, *_joins(plan, legs, clock)),
    )
    most = wanted(swarm, legs)
    targets = [_targets(space, k, leg, most[k], clock[k + 1]) for k, leg in enumerate(legs)]
    nobody = np.empty((0, space.model.axes))
    start = _start(space, "swarm.start", swarm.start, swarm.agents, nobody, 0.0, rng)
    flown: list[Leg] = []
    for number, leg in enumerate(legs):
        before = targets[number - 1][: most[number - 1]] if number else None
        come, arrivals = _joining(space, number, leg, start, before, clock[number], plan, rng)
        start = np.concatenate([start, *come])
        losses = tuple(lost(loss) for loss in leg.lose)
        flown.append(Leg(targets[number], leg.steps, losses, arrivals, leg.recount))
    mission = Reconfiguration(
        linear_model=space.model,
        initial_states=start,
        alive=np.arange(len(start)) < swarm.agents,
        legs=tuple(flown),
        step=plan.step_s,
        comm_radius=swarm.comm_radius_m,
        collision_radius=swarm.collision_radius_m,
        max_control=world.moves.max_control_m_s2,
        max_speed=limit,
        fuel_norm=world.moves.fuel_norm,
        control_norm=world.moves.control_norm,
        horizon_steps=plan.horizon_steps,
        foresight_steps=plan.foresight_steps,
        orders=plan.orders,
        bargains=plan.bargains,
        replan_steps=plan.replan_steps,
        auction_steps=plan.auction_steps,
        target_count=swarm.believed or 0,
        cost=plan.cost,
        tie_break=plan.tie_break,
        bidder_ids=plan.ids,
        reset=plan.reset,
        freeze_steps=plan.commit_steps,
        nonlinear_model=world.nonlinear(),
        plant=world.truth(space.model, len(start), rng),
        disturbance=disturbance.acceleration_m_s2,
        position_noise=disturbance.position_m,
        velocity_noise=disturbance.velocity_m_s,
        thrust_error=disturbance.thrust,
        pointing_error=disturbance.pointing_rad,
    )
    place, speed, automatic = tolerances(mission, plan)
    return _apart(
        replace(
            mission,
            position_tolerance=place,
            velocity_tolerance=speed,
            epsilon=automatic if plan.epsilon == "auto" else plan.epsilon,
        ),
        plan,
        world,
    )


def _apart(mission: Reconfiguration, plan: Plan, world: World) -> Reconfiguration:
    """The mission with its margin, which targets have to leave room for."""
    asked = plan.margin_m if plan.margin_m is not None else "auto" if world.chief else 0.0
    more = margin(mission) if asked == "auto" else asked
    assert not isinstance(more, str)
    room = mission.target_spacing - mission.collision_radius
    if more > room * (1 + 1e-9):
        found = "auto gives" if asked == "auto" else "takes"
        raise Refusal(
            "plan.margin_m",
            f"{found} {more:.4g} m beyond the collision radius of {mission.collision_radius:g} m, "
            f"and targets stand {mission.target_spacing:.4g} m apart; a shape with "
            f"{mission.collision_radius + more:.4g} m, less noise, or margin_m = {room:.3g} "
            "would do",
        )
    return replace(mission, margin=more)


def _clock(plan: Plan, legs: list[LegTable]) -> tuple[float, ...]:
    """When each leg begins, and the last one ends, as planned [s]."""
    return tuple(plan.step_s * sum(leg.steps for leg in legs[:k]) for k in range(len(legs) + 1))


def _joins(plan: Plan, legs: list[LegTable], clock: tuple[float, ...]) -> list[float]:
    return [
        begin + join.at_step * plan.step_s
        for begin, leg in zip(clock, legs, strict=False)
        for join in leg.join
    ]


def _targets(
    space: Space, number: int, leg: LegTable, most: int, arrival: float
) -> Float[Array, "k n"]:
    where = f"leg.{number}.shape"
    try:
        placed = leg.shape.place(leg.targets or most, space.model.axes, space.collision_radius)
    except Refusal as refusal:
        raise refusal.inside(where) from refusal
    velocity = space.world.resting(placed, arrival, where, space.times)
    states = np.hstack([placed, velocity])
    _check_speed(space, where, "target", states)
    return states


def _joining(
    space: Space,
    number: int,
    leg: LegTable,
    start: Float[Array, "k n"],
    before: Float[Array, "m n"] | None,
    begin: float,
    plan: Plan,
    rng: np.random.Generator,
) -> tuple[list[Float[Array, "_ n"]], tuple[Join, ...]]:
    come: list[Array] = []
    arrivals: list[Join] = []
    d, rows = space.model.axes, len(start)
    for i, join in enumerate(leg.join):
        there = occupied(number, join.at_step, start, before)
        with_them = [c for c, a in zip(come, arrivals, strict=True) if a.at_step == join.at_step]
        taken = np.concatenate([there, *with_them])[:, :d]
        where = f"leg.{number}.join.{i}.start"
        t = begin + join.at_step * plan.step_s
        come.append(_start(space, where, join.start, join.agents, taken, t, rng))
        arrivals.append(Join(tuple(range(rows, rows + join.agents)), join.at_step))
        rows += join.agents
    return come, tuple(arrivals)


def _start(
    space: Space,
    where: str,
    start: AnyStart,
    count: int,
    taken: Float[Array, "k d"],
    t: float,
    rng: np.random.Generator,
) -> Float[Array, "count n"]:
    axes = space.model.axes
    try:
        place = Place(axes, space.comm_radius, space.collision_radius, taken)
        placed = positions(start, count, place, rng)
        given = start.velocities(count, axes) if isinstance(start, Listed) else None
    except Refusal as refusal:
        raise refusal.inside(where) from refusal
    velocity = space.world.resting(placed, t, where, space.times) if given is None else given
    states = np.hstack([placed, velocity])
    _check_speed(space, where, "agent", states)
    return states


def _check_speed(space: Space, where: str, who: str, states: Float[Array, "k n"]) -> None:
    speed = np.linalg.norm(states[:, space.model.axes :], axis=1)
    i = int(np.argmax(speed))
    if speed[i] <= space.max_speed * (1 + 1e-12):
        return
    goes = "starts at" if who == "agent" else "has to be taken up at"
    cure = f"{upward(speed[i])} or more would do, or slower ones"
    chief = space.world.chief
    if chief is not None and abs(states[i, -1]) > space.max_speed / 2:
        # Out of the plane speeds grow as tan θ, and another latitude does more than a limit.
        cure += f"; {elsewhere(chief, space.times)}"
    raise Refusal(
        where,
        f"{who} {i} {goes} {speed[i]:.4g} m/s, faster than model.max_speed_m_s = "
        f"{space.max_speed:g}; {cure}",
    )
