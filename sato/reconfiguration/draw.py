"""Drawing of a mission: starts and targets as states, margins and tolerances as numbers."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration import feasibility, tolerances
from sato.reconfiguration.mission import Join, Leg, Reconfiguration, join_size
from sato.reconfiguration.orbit import better_start
from sato.reconfiguration.start import Start, Surroundings, draw_positions
from sato.scenario.errors import InputError, errors_in, round_up
from sato.shapes import Points


def draw(mission: Reconfiguration, rng: np.random.Generator) -> Reconfiguration:
    """Return the mission with all chance drawn and every automatic value resolved.

    Raises:
        InputError: The starts, targets, margins or times cannot be as they are asked for.
    """
    demand = feasibility.target_demand(mission)
    times = _leg_times(mission)
    targets = [
        _draw_targets(mission, k, leg, demand[k], times[k + 1])
        for k, leg in enumerate(mission.legs)
    ]
    nobody = np.empty((0, mission.axes))
    start = _draw_start(
        mission, "swarm.start", mission.start, mission.agent_count, nobody, 0.0, rng
    )
    states, legs = start, []
    for number, leg in enumerate(mission.legs):
        before = targets[number - 1][: demand[number - 1]] if number else None
        joins = _draw_joins(mission, number, leg, states, before, times[number], rng)
        states = np.concatenate([states, *(_as_states(join.start) for join in joins)])
        shape = _as_points(targets[number])
        legs.append(replace(leg, shape=shape, count=None, joins=tuple(joins)))
    drawn = replace(mission, start=_as_points(start), legs=tuple(legs))
    plant = mission.world.draw_plant(drawn.linear_model, len(states), rng)
    drawn = tolerances.resolve(replace(drawn, plant=plant))
    feasibility.check_reach(drawn)
    return drawn


def _leg_times(mission: Reconfiguration) -> tuple[float, ...]:
    """Return the times at which each leg begins, and the last one ends, as planned [s]."""
    steps = [leg.steps for leg in mission.legs]
    return tuple(mission.step * sum(steps[:k]) for k in range(len(steps) + 1))


def _velocity_times(mission: Reconfiguration) -> tuple[float, ...]:
    """Return all times at which agents start, join or arrive, as planned [s]."""
    begins = _leg_times(mission)
    joins = [
        begin + join.at_step * mission.step
        for begin, leg in zip(begins, mission.legs, strict=False)
        for join in leg.joins
    ]
    return (*begins, *joins)


def _draw_targets(
    mission: Reconfiguration, number: int, leg: Leg, demand: int, arrival: float
) -> Float[Array, "k n"]:
    where, count = f"leg.{number}.shape", leg.count or demand
    with errors_in(where):
        placed = leg.shape.place(count, mission.axes, mission.collision_radius)
        velocity = leg.shape.place_velocities(count, mission.axes)
    if velocity is None:
        velocity = _drift_free(mission, placed, arrival, where)
    states = np.hstack([placed, velocity])
    _check_speed(mission, where, "target", states)
    return states


def _draw_joins(
    mission: Reconfiguration,
    number: int,
    leg: Leg,
    states: Float[Array, "k n"],
    before: Float[Array, "m n"] | None,
    begin: float,
    rng: np.random.Generator,
) -> list[Join]:
    joins: list[Join] = []
    for i, join in enumerate(leg.joins):
        there = _known_states(number, join.at_step, states, before)
        beside = [_as_states(other.start) for other in joins if other.at_step == join.at_step]
        occupied = np.concatenate([there, *beside])[:, : mission.axes]
        where, t = f"leg.{number}.join.{i}.start", begin + join.at_step * mission.step
        drawn = _draw_start(mission, where, join.start, join_size(join), occupied, t, rng)
        joins.append(replace(join, agents=len(drawn), start=_as_points(drawn)))
    return joins


def _known_states(
    number: int, at_step: int, states: Float[Array, "k d"], before: Float[Array, "m d"] | None
) -> Float[Array, "n d"]:
    """Return states of agents known when others join: at the start, or where the last leg ended."""
    if at_step > 0:
        return np.empty((0, states.shape[1]))
    return states if number == 0 or before is None else before


def _draw_start(
    mission: Reconfiguration,
    where: str,
    start: Start,
    count: int,
    occupied: Float[Array, "k d"],
    t: float,
    rng: np.random.Generator,
) -> Float[Array, "count n"]:
    around = Surroundings(mission.axes, mission.comm_radius, mission.collision_radius, occupied)
    with errors_in(where):
        placed = draw_positions(start, count, around, rng)
        velocity = None
        if isinstance(start, Points):
            kept = replace(start, keep_order=True)
            velocity = kept.place_velocities(count, mission.axes)
    if velocity is None:
        velocity = _drift_free(mission, placed, t, where)
    states = np.hstack([placed, velocity])
    _check_speed(mission, where, "agent", states)
    return states


def _drift_free(
    mission: Reconfiguration, placed: Float[Array, "k d"], t: float, where: str
) -> Float[Array, "k d"]:
    return mission.world.drift_free_velocities(placed, t, where, _velocity_times(mission))


def _check_speed(
    mission: Reconfiguration, where: str, noun: str, states: Float[Array, "k n"]
) -> None:
    speed = np.linalg.norm(states[:, mission.axes :], axis=1)
    i = int(np.argmax(speed))
    if speed[i] <= mission.max_speed * (1 + 1e-12):
        return
    verb = "starts at" if noun == "agent" else "has to be reached at"
    cure = f"{round_up(speed[i])} or more would do, or slower ones"
    if mission.chief is not None and abs(states[i, -1]) > mission.max_speed / 2:
        # Out of the plane speeds grow as tan θ, and another latitude does more than a limit.
        cure += f"; {better_start(mission.chief, _velocity_times(mission))}"
    raise InputError(
        where,
        f"{noun} {i} {verb} {speed[i]:.4g} m/s, faster than model.max_speed_m_s = "
        f"{mission.max_speed:g}; {cure}",
    )


def _as_points(states: Float[Array, "k n"]) -> Points:
    d = states.shape[1] // 2
    return Points(states[:, :d], states[:, d:], keep_order=True)


def _as_states(points: Start) -> Float[Array, "k n"]:
    assert isinstance(points, Points)
    return np.hstack([np.asarray(points.positions), np.asarray(points.velocities)])
