"""Drawing of a mission: starts and targets as states."""

from dataclasses import replace
from itertools import accumulate
from math import ceil

import numpy as np
import scipy
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.circular_orbit import ClohessyWiltshire
from dynamics.propagation import Impact
from dynamics.trajectory_geometry import min_distance
from problems.limit import Limit
from sato.reconfiguration import feasibility, first_commitment, reach
from sato.reconfiguration.departure import Departure, count_wanted, depart
from sato.reconfiguration.leg import Leg, states_of
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.models import OrbitalModel
from sato.reconfiguration.resolve import check_margin, resolve
from sato.reconfiguration.start import Random, Start
from sato.scenario.definition import errors_in, is_auto
from sato.scenario.errors import InputError, round_up
from sato.scenario.ranges import check_memory
from sato.shapes import Points

TIME_FACTOR = 1.5  # of automatic steps, over the least


def draw(mission: Reconfiguration, rng: np.random.Generator) -> Reconfiguration:
    """Return the mission with all chance drawn and every automatic value resolved.

    Raises:
        InputError: The starts, targets, margins or times cannot be as they are asked for.
    """
    check_memory(mission.agent_count, lambda n: feasibility.memory_demand(mission, n))
    demand, asked = feasibility.target_demand(mission), mission.legs
    mission = _with_placeholders(mission)
    nobody, agents = np.empty((0, mission.axes)), range(mission.agent_count)
    start = _draw_start(mission, "swarm.start", mission.start, agents, nobody, 0.0, rng)
    states, known, legs, steps = start, start, [], 0
    for k, leg in enumerate(mission.legs):
        leg = _draw_joins(mission, k, leg, known, len(states), mission.step * steps, rng)
        joined = [states_of(join.start) for join in leg.joins]
        states = np.concatenate([states, *joined])
        if is_auto(asked[k].steps):
            begin = _depart(mission, k, known, states, demand, mission.step * steps)
            factor = asked[k].time_factor or TIME_FACTOR
            leg = replace(leg, steps=_choose_steps(mission, k, leg, begin, demand[k], factor))
        steps += leg.steps
        targets = _draw_targets(mission, k, leg, demand[k], mission.step * steps)
        # States of agents that are known to those that join when the next leg begins.
        known = targets if mission.uses_all_targets(leg) else targets[: demand[k]]
        legs.append(with_targets(leg, targets))
    drawn = replace(mission, start=_as_points(start), legs=tuple(legs))
    try:
        drawn = resolve(replace(drawn, plant=mission.draw_plant(len(states), rng)))
    except Impact as error:
        reason = f"is so large that {error}"
        raise InputError("model.max_control_m_s2", reason) from error
    reach.check_reach(drawn)
    first_commitment.check_reach(drawn)
    first_commitment.find_first_commitments(drawn)
    return drawn


def _with_placeholders(mission: Reconfiguration) -> Reconfiguration:
    """Return the mission with the fewest steps that it allows, where they are automatic."""
    legs = [
        replace(leg, steps=_fewest_steps(mission, leg), time_factor=None)
        if is_auto(leg.steps)
        else leg
        for leg in mission.legs
    ]
    return replace(mission, legs=tuple(legs))


def _fewest_steps(mission: Reconfiguration, leg: Leg) -> int:
    # The last event comes before the deadline.
    events = [loss.at_step for loss in leg.losses] + [join.at_step for join in leg.joins]
    return max(*events, mission.freeze_steps - 1, 0) + 1


def _depart(
    mission: Reconfiguration,
    number: int,
    known: Float[Array, "k n"],
    states: Float[Array, "agents n"],
    demand: tuple[int, ...],
    begin: float,
) -> Departure:
    """Return those that begin a leg: agents at first, then any that targets may have."""
    new = sum(join.size for join in mission.legs[number].joins)
    first = depart(mission, states)
    if number > 0:
        spare = max(0, len(known) - demand[number - 1], len(known) + new - demand[number])
        first = Departure(np.arange(len(known)), known, spare, 0, begin)
    agents = np.append(first.agents, np.arange(len(states) - new, len(states)))
    state = np.concatenate([first.state, states[len(states) - new :]])
    # Some are lost before others join.
    excess = max(0, len(agents) - demand[number])
    spare, lost = max(first.spare, excess), max(first.lost, excess)
    return first._replace(agents=agents, state=state, spare=spare, lost=lost)


def _choose_steps(
    mission: Reconfiguration,
    number: int,
    leg: Leg,
    departure: Departure,
    demand: int,
    factor: float,
) -> int:
    wanted = count_wanted(mission, number)

    def targets_after(steps: int) -> Float[Array, "k n"]:
        arrival = departure.time + steps * mission.step
        return _draw_targets(mission, number, leg, demand, arrival)[:wanted]

    fixed = targets_after(1)  # but drift-free velocities depend on the time
    after = targets_after if mission.chief is not None else lambda _: fixed
    least = reach.find_least_steps(mission, f"leg.{number}.steps", departure, after)
    return max(ceil(factor * least - 1e-9), _fewest_steps(mission, leg))


def is_drawn(mission: Reconfiguration) -> bool:
    """Return True where all chance is drawn and every automatic value is a number."""
    numbers = mission.margin, mission.position_tolerance, mission.velocity_tolerance
    shapes = [leg.shape for leg in mission.legs]
    return not any(value is None or is_auto(value) for value in numbers) and all(
        isinstance(shape, Points) and shape.velocities is not None for shape in shapes
    )


def draw_leg(mission: Reconfiguration, leg: Leg, demand: int, instant: int) -> Leg:
    """Draw the targets of a leg that is no part of a drawn mission.

    Args:
        mission: A drawn mission.
        leg: The leg, without losses and joins.
        demand: Least number of targets.
        instant: Control instant at which the leg begins.

    Raises:
        InputError: There are too few targets, they are too close for the margin, or the number
            of steps is to be found.
    """
    if is_auto(leg.steps):
        raise InputError("leg.steps", "must be a number for a leg that is set on the way")
    listed = getattr(leg.shape, "positions", None)
    if mission.assignment == "given":
        demand = 1 if listed is not None else mission.vehicle_count
    count = leg.count or (demand if listed is None else len(listed))
    if count < demand:
        reason = f"{count} is less than the {demand} that agents bid on"
        raise InputError("leg.targets", f"{reason}; {demand} or more would do")
    arrival = (instant + leg.steps) * mission.step
    states = _draw_targets(mission, 0, replace(leg, count=count), count, arrival)
    check_margin(mission, mission.margin, "takes", min_distance(states[:, : mission.axes]))
    return with_targets(leg, states)


def with_targets(leg: Leg, states: Float[Array, "targets n"]) -> Leg:
    """Return a leg to these states, in this order."""
    shape = replace(_as_points(states), keep_order=not leg.is_free)
    return replace(leg, shape=shape, count=None)


def _leg_times(mission: Reconfiguration) -> list[float]:
    """Return the times at which each leg begins, and the last one ends, as planned [s]."""
    return [mission.step * k for k in accumulate((leg.steps for leg in mission.legs), initial=0)]


def _velocity_times(mission: Reconfiguration) -> list[float]:
    """Return all times at which agents start, join or arrive, as planned [s]."""
    begins = _leg_times(mission)
    each = zip(begins, mission.legs, strict=False)
    joins = [begin + join.at_step * mission.step for begin, leg in each for join in leg.joins]
    return begins + joins


def _draw_targets(
    mission: Reconfiguration, number: int, leg: Leg, demand: int, arrival: float
) -> Float[Array, "k n"]:
    where = f"leg.{number}.shape"
    with errors_in(where):
        drawn = leg.place(demand, mission.axes, mission.largest_separation)
    placed = np.asarray(drawn.positions)
    limits = [mission.speed_limit(i) for i in range(len(placed))]
    if mission.assignment != "given":  # any vehicle may have to arrive there
        limits = [min(mission.speed_limits, key=lambda one: float(one.most * one.shares.min()))]
        limits *= len(placed)
    return _with_velocities(mission, placed, drawn.velocities, arrival, where, limits, "target")


def _draw_joins(
    mission: Reconfiguration,
    number: int,
    leg: Leg,
    known: Float[Array, "k n"],
    first: int,
    begin: float,
    rng: np.random.Generator,
) -> Leg:
    drawn: list[tuple[int, Float[Array, "k n"]]] = []  # steps and states
    for i, join in enumerate(leg.joins):
        beside = [states for at_step, states in drawn if at_step == join.at_step]
        there = [known if join.at_step == 0 else known[:0], *beside]
        occupied = np.concatenate(there)[:, : mission.axes]
        where, t = f"leg.{number}.join.{i}.start", begin + join.at_step * mission.step
        agents = range(first, first + join.size)
        states = _draw_start(mission, where, join.start, agents, occupied, t, rng)
        drawn.append((join.at_step, states))
        first += join.size
    joins = [
        replace(join, agents=len(states), start=_as_points(states))
        for join, (_, states) in zip(leg.joins, drawn, strict=True)
    ]
    return replace(leg, joins=tuple(joins))


def _draw_start(
    mission: Reconfiguration,
    where: str,
    start: Start,
    agents: range,
    occupied: Float[Array, "k d"],
    t: float,
    rng: np.random.Generator,
) -> Float[Array, "count n"]:
    axes, count, velocity = mission.axes, len(agents), None
    with errors_in(where):
        if isinstance(start, Random):
            placed = start.draw(mission, count, occupied, rng)
        elif isinstance(start, Points):
            if start.positions is not None and len(start.positions) != count:
                reason = f"lists {len(start.positions)} positions for {count} agents"
                raise InputError("positions_m", reason)
            start = replace(start, keep_order=True)
            placed, velocity = start.place(count, axes), start.place_velocities(count, axes)
        else:
            placed = start.place(count, axes, mission.largest_separation)
        # Any may stand where others are already.
        others = np.full(len(occupied), mission.radii.max())
        radii = np.concatenate([mission.radii[agents.start : agents.stop], others])
        _check_separation(placed, occupied, radii)
    limits = [mission.speed_limit(i) for i in agents]
    return _with_velocities(mission, placed, velocity, t, where, limits)


def _check_separation(
    placed: Float[Array, "count d"], occupied: Float[Array, "k d"], radii: Float[Array, " both"]
) -> None:
    together = np.concatenate([placed, occupied])
    pairs = scipy.spatial.cKDTree(together).query_pairs(radii.max(), output_type="ndarray")
    pairs = pairs[pairs[:, 0] < len(placed)]  # the others were there before
    distance = np.linalg.norm(together[pairs[:, 0]] - together[pairs[:, 1]], axis=1)
    required = radii[pairs].mean(axis=1)
    is_close = distance < required * (1 - 1e-9)
    if is_close.any():
        pairs, distance, required = pairs[is_close], distance[is_close], required[is_close]
        worst = int(np.argmin(distance / required))
        i, j = pairs[worst]
        other = f"agent {j}" if j < len(placed) else "an agent that is there already"
        reason = f"agent {i} starts {distance[worst]:.4g} m from {other}"
        raise InputError("", f"{reason}, closer than the collision radius of {required[worst]:g} m")


def _with_velocities(
    mission: Reconfiguration,
    placed: Float[Array, "k d"],
    velocity: Float[Array, "k d"] | None,
    t: float,
    where: str,
    limits: list[Limit],
    noun: str = "agent",
) -> Float[Array, "k n"]:
    """Return states, with velocities that stay about these positions where none are given."""
    if velocity is None:
        velocity = _drift_free_velocities(mission, placed, t, where)
    speed = np.array([one.measure(v) for one, v in zip(limits, velocity, strict=True)])
    most = np.array([one.most for one in limits])
    i = int(np.argmax(speed / most))
    if speed[i] > most[i] * (1 + 1e-12):
        verb = "starts at" if noun == "agent" else "has to be reached at"
        cure = f"{round_up(speed[i])} or more would do, or slower ones"
        if mission.chief is not None and abs(velocity[i, -1]) > most[i] / 2:
            # Out of the plane speeds grow as tan θ, and another latitude does more than a limit.
            cure += f"; {mission.chief.suggest_start(_velocity_times(mission))}"
        fast = f"{noun} {i} {verb} {speed[i]:.4g} m/s"
        limit = f"model.max_speed_m_s = {most[i]:g}"
        raise InputError(where, f"{fast}, faster than {limit}; {cure}")
    return np.hstack([placed, velocity])


def _drift_free_velocities(
    mission: Reconfiguration, placed: Float[Array, "k d"], t: float, where: str
) -> Float[Array, "k d"]:
    model = mission.model
    if isinstance(model, OrbitalModel) and model.mean_motion is not None:
        return ClohessyWiltshire(model.mean_motion).bounded_velocity(placed)
    if mission.chief is None:
        return np.zeros_like(placed)
    return mission.chief.drift_free_velocities(placed, t, where, _velocity_times(mission))


def _as_points(states: Float[Array, "k n"]) -> Points:
    d = states.shape[1] // 2
    return Points(states[:, :d], states[:, d:], keep_order=True)
