"""Drawing of a mission: starts and targets as states."""

from dataclasses import replace
from functools import partial
from math import ceil

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.propagation import Impact
from sato.reconfiguration import (
    feasibility,
    first_commitment,
    link_feasibility,
    own_motion,
    passive_safety,
    reach,
)
from sato.reconfiguration.allowed_places import check_margin_to_obstacles
from sato.reconfiguration.departure import Departure, count_wanted, depart
from sato.reconfiguration.leg import Leg, states_of
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.places import as_listed_points, draw_joins, draw_start, draw_targets
from sato.reconfiguration.resolve import check_margin, resolve
from sato.scenario.definition import is_auto
from sato.scenario.errors import InputError
from sato.scenario.ranges import check_memory
from sato.shapes import Points

TIME_FACTOR = 1.5  # of automatic steps, over the least
UNKNOWN_STEPS = 50  # over which controls must reach every state, where a leg has automatic ones


def draw(mission: Reconfiguration, rng: np.random.Generator) -> Reconfiguration:
    """Return the mission with all chance drawn and every automatic value resolved."""
    mission = replace(mission, **mission.choices())
    check_memory(mission.agent_count, lambda n: feasibility.memory_demand(mission, n))
    demand, asked = feasibility.target_demand(mission), mission.legs
    if own_motion.is_own_model(mission.model):
        length = UNKNOWN_STEPS if is_auto(mission.legs[0].steps) else mission.legs[0].steps
        own_motion.check_authority(type(mission.model).__name__, mission.discretize(length))
    fewest = [
        replace(leg, steps=_fewest_steps(mission, leg), time_factor=None)
        if is_auto(leg.steps)
        else leg
        for leg in mission.legs
    ]
    mission = replace(mission, legs=tuple(fewest))  # until more steps are found to be needed
    nobody, agents = np.empty((0, mission.axes)), range(mission.agent_count)
    start = draw_start(mission, "swarm.start", mission.start, agents, nobody, 0.0, rng)
    states, known, legs, steps = start, start, [], 0
    departures: dict[int, Departure] = {}  # of legs whose steps are automatic
    factors = [leg.time_factor or TIME_FACTOR for leg in asked]
    for k, leg in enumerate(mission.legs):
        leg = draw_joins(mission, k, leg, known, len(states), mission.step * steps, rng)
        states = np.concatenate([states, *[states_of(join.start) for join in leg.joins]])
        if is_auto(asked[k].steps):
            begin = departures[k] = depart(mission, k, known, states, demand, mission.step * steps)
            leg = replace(leg, steps=_choose_steps(begin, k, leg, demand[k], factors[k]))
        steps += leg.steps
        targets = draw_targets(mission, k, leg, demand[k], mission.step * steps)
        # States of agents that are known to those that join when the next leg begins.
        known = targets if mission.uses_all_targets(leg) else targets[: demand[k]]
        legs.append(with_targets(leg, targets))
    drawn = replace(mission, start=as_listed_points(start), legs=tuple(legs))
    check_memory(mission.agent_count, lambda n: feasibility.memory_demand(drawn, n))
    feasibility.check_programs(drawn.axes, drawn.legs)
    drawn = replace(drawn, plant=mission.draw_plant(len(states), rng))
    own_motion.try_motion(drawn.model, drawn.plant, drawn.initial_states, drawn.step)
    drawn = _resolve(drawn, departures, factors, demand)
    check_margin_to_obstacles(drawn)
    link_feasibility.check_starts(drawn)

    def targets_after(number: int, steps: int) -> Float[Array, "k n"]:
        begin = sum(leg.steps for leg in drawn.legs[:number]) * drawn.step
        return _targets_after(mission, number, asked[number], demand[number], begin, steps)

    reach.check_reach(drawn, None if drawn.chief is None else targets_after)
    first_commitment.check_reach(drawn)
    first_commitment.find_first_commitments(drawn)
    first_commitment.check_room(drawn)
    if drawn.is_passively_safe:
        passive_safety.check_network(drawn)
        passive_safety.check_targets(drawn)
    return drawn


def _resolve(
    mission: Reconfiguration,
    departures: dict[int, Departure],
    factors: list[float],
    demand: tuple[int, ...],
) -> Reconfiguration:
    """Resolve automatic values; find automatic steps again where the margin slows vehicles down."""
    while True:
        try:
            resolved = resolve(mission)
        except Impact as error:
            reason = f"is so large that {error}"
            raise InputError("model.max_control_m_s2", reason) from error
        if resolved.slow_speed in (None, mission.slow_speed):
            return resolved
        legs = list(mission.legs)
        for k, begin in departures.items():
            begin = begin._replace(mission=resolved)
            steps = _choose_steps(begin, k, legs[k], demand[k], factors[k])
            legs[k] = replace(legs[k], steps=max(steps, legs[k].steps))
        if legs == list(mission.legs):
            return resolved
        mission = replace(mission, legs=tuple(legs))


def _fewest_steps(mission: Reconfiguration, leg: Leg) -> int:
    # The last event comes before the deadline.
    events = [loss.at_step for loss in leg.losses] + [join.at_step for join in leg.joins]
    return max(*events, mission.freeze_steps - 1, 0) + 1


def _choose_steps(departure: Departure, number: int, leg: Leg, demand: int, factor: float) -> int:
    mission = departure.mission
    targets_after = partial(_targets_after, mission, number, leg, demand, departure.time)
    fixed = targets_after(1)  # but drift-free velocities depend on the time
    after = targets_after if mission.chief is not None else lambda _: fixed
    least = reach.find_least_steps(f"leg.{number}.steps", departure, after)
    return max(ceil(factor * least - 1e-9), _fewest_steps(mission, leg))


def _targets_after(
    mission: Reconfiguration, number: int, leg: Leg, demand: int, begin: float, steps: int
) -> Float[Array, "k n"]:
    """Return the targets of a leg that begins at a time [s], as they are after some steps."""
    states = draw_targets(mission, number, leg, demand, begin + steps * mission.step)
    return states[: count_wanted(mission, number)]


def is_drawn(mission: Reconfiguration) -> bool:
    """Return True where all chance is drawn and every automatic value is a number."""
    has_tolerances = None not in (mission.position_tolerance, mission.velocity_tolerance)
    return (mission.has_margin and has_tolerances) and all(
        isinstance(leg.shape, Points) and leg.shape.velocities is not None for leg in mission.legs
    )


def draw_leg(mission: Reconfiguration, leg: Leg, demand: int, instant: int) -> Leg:
    """Draw the targets of a leg that is no part of a drawn mission, and has no losses and joins.

    It begins at a control instant, and has as many targets as the demand, or more. Too few targets,
    targets too close for the margin, and automatic steps are refused.
    """
    if is_auto(leg.steps):
        raise InputError("leg.steps", "must be a number for a leg that is set on the way")
    feasibility.check_programs(mission.axes, [leg])
    listed = getattr(leg.shape, "positions", None)
    if mission.assignment == "given":
        demand = 1 if listed is not None else mission.vehicle_count
    count = leg.count or (demand if listed is None else len(listed))
    if count < demand:
        reason = f"{count} is less than the {demand} that agents bid on"
        raise InputError("leg.targets", f"{reason}; {demand} or more would do")
    arrival = (instant + leg.steps) * mission.step
    states = draw_targets(mission, 0, replace(leg, count=count), count, arrival)
    check_margin(mission.margin, "takes", *mission.find_tightest(states))
    return with_targets(leg, states)


def with_targets(leg: Leg, states: Float[Array, "targets n"]) -> Leg:
    """Return a leg to these states, in this order."""
    shape = replace(as_listed_points(states), keep_order=not leg.is_free)
    return replace(leg, shape=shape, count=None)
