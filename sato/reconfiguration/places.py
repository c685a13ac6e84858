"""Places of a mission: starts and targets as states."""

from dataclasses import replace
from itertools import accumulate

import numpy as np
import scipy
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.circular_orbit import CircularOrbitModel
from dynamics.tschauner_hempel import TschaunerHempel
from problems.convexify import SEPARATION_TOLERANCE
from problems.limit import Limit
from sato.reconfiguration.allowed_places import check_starts, place_targets
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.models import OrbitalModel
from sato.reconfiguration.start import Random, Start
from sato.scenario.definition import errors_in
from sato.scenario.errors import InputError, round_up
from sato.shapes import Points


def draw_targets(
    mission: Reconfiguration, number: int, leg: Leg, demand: int, arrival: float
) -> Float[Array, "k n"]:
    """Return the targets of a leg as states, which are reached at a time [s].

    Args:
        mission: Mission.
        number: Number of the leg, for errors.
        leg: The leg.
        demand: Least number of targets.
        arrival: Time at which they are reached [s].

    Raises:
        InputError: They cannot be placed, or are too fast.
    """
    where = f"leg.{number}.shape"
    kept = 1 + SEPARATION_TOLERANCE  # times R, by plans
    checked = mission.keeps_targets_by_pair or mission.ellipsoid is not None
    needed = 0.0 if checked else mission.largest_separation * kept
    with errors_in(where):
        drawn = place_targets(mission, leg, demand, needed)
        placed = np.asarray(drawn.positions)
        if checked:
            widest = np.full(len(placed), mission.largest_separation)
            radii = mission.radii[: len(placed)] if mission.keeps_targets_by_pair else widest
            _check_separation(mission, placed[: len(radii)], placed[:0], kept * radii, "target", 0)
    limits = [mission.speed_limit(i) for i in range(len(placed))]
    if mission.assignment != "given":  # any vehicle may have to arrive there
        least = min(mission.speed_limits, key=lambda limit: float(limit.most * limit.shares.min()))
        limits = [least] * len(placed)
    return _with_velocities(mission, placed, drawn.velocities, arrival, where, limits, "target")


def draw_joins(
    mission: Reconfiguration,
    number: int,
    leg: Leg,
    known: Float[Array, "k n"],
    first: int,
    begin: float,
    rng: np.random.Generator,
) -> Leg:
    """Return a leg with the states at which agents join.

    Args:
        mission: Mission.
        number: Number of the leg, for errors.
        leg: The leg.
        known: States of agents that may be there when it begins.
        first: Number of the first agent that joins.
        begin: Time at which the leg begins [s].
        rng: Draws starts.

    Raises:
        InputError: They cannot be placed, are too close to others or too fast.
    """
    drawn: list[tuple[int, Float[Array, "k n"]]] = []  # steps and states
    for i, join in enumerate(leg.joins):
        beside = [states for at_step, states in drawn if at_step == join.at_step]
        there = [known if join.at_step == 0 else known[:0], *beside]
        if join.room == "wait" and isinstance(join.start, Points):
            there = [known[:0]]  # they wait for all others; what is drawn is drawn apart from them
        occupied = np.concatenate(there)[:, : mission.axes]
        where, t = f"leg.{number}.join.{i}.start", begin + join.at_step * mission.step
        agents = range(first, first + join.size)
        states = draw_start(mission, where, join.start, agents, occupied, t, rng)
        drawn.append((join.at_step, states))
        first += join.size
    joins = [
        replace(join, agents=len(states), start=as_listed_points(states))
        for join, (_, states) in zip(leg.joins, drawn, strict=True)
    ]
    return replace(leg, joins=tuple(joins))


def draw_start(
    mission: Reconfiguration,
    where: str,
    start: Start,
    agents: range,
    occupied: Float[Array, "k d"],
    t: float,
    rng: np.random.Generator,
) -> Float[Array, "count n"]:
    """Return the states of agents that start or join.

    Args:
        mission: Mission.
        where: Key of the start, for errors.
        start: Start as it is asked for.
        agents: Numbers of the agents.
        occupied: Positions of others [m].
        t: Time [s].
        rng: Draws starts.

    Raises:
        InputError: They cannot be placed, are too close to others or too fast.
    """
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
            needed = mission.largest_separation if mission.ellipsoid is None else 0.0
            placed = start.place(count, axes, needed)
        # Any may stand where others are already.
        others = np.full(len(occupied), mission.radii.max())
        radii = np.concatenate([mission.radii[agents.start : agents.stop], others])
        _check_separation(mission, placed, occupied, radii, "agent", agents.start)
        check_starts(mission, placed, agents)
    limits = [mission.speed_limit(i) for i in agents]
    return _with_velocities(mission, placed, velocity, t, where, limits)


def _check_separation(
    mission: Reconfiguration,
    placed: Float[Array, "count d"],
    occupied: Float[Array, "k d"],
    radii: Float[Array, " both"],
    noun: str,
    first: int,
) -> None:
    """Refuse starts or targets that are too near to each other, or to places that are occupied.

    Args:
        mission: The ellipsoid that two keep.
        placed: Starts or targets [m].
        occupied: Places of others [m].
        radii: R of the vehicles at both [m].
        noun: "agent" or "target", for the error.
        first: Number of the first one.

    Raises:
        InputError: Two are too near.
    """
    together = mission.scale_separations(np.concatenate([placed, occupied]))
    pairs = scipy.spatial.cKDTree(together).query_pairs(radii.max(), output_type="ndarray")
    pairs = pairs[pairs[:, 0] < len(placed)]  # the others were there before
    distance = np.linalg.norm(together[pairs[:, 0]] - together[pairs[:, 1]], axis=1)
    required = radii[pairs].mean(axis=1)
    is_close = distance < required * (1 - 1e-9)
    if is_close.any():
        pairs, distance, required = pairs[is_close], distance[is_close], required[is_close]
        worst = int(np.argmin(distance / required))
        i, j = pairs[worst]
        other = f"{noun} {first + j}" if j < len(placed) else "an agent that is there already"
        verb = "starts" if noun == "agent" else "is"
        found = f"{noun} {first + i} {verb} {distance[worst]:.8g} m from {other}"
        reason = f"{found}, closer than the collision radius of {required[worst]:.8g} m"
        raise InputError("", f"{reason}; {noun}s farther apart would do")


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
    if mission.chief is not None:
        radius = mission.chief.orbit.elements_at(t)[0]
        from_center = np.linalg.norm(placed + radius * np.eye(placed.shape[1])[0], axis=1)
        depth, body = mission.chief.center.radius - from_center, mission.chief.center.name
        if (depth > 0).any():
            below = f"{depth.max() / 1e3:.4g} km below the surface of {body}"
            cure = "a position from the chief, in meters, would do"
            raise InputError(where, f"{noun} {depth.argmax()} is {below}; {cure}")
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
    model, chief = mission.linear_model, mission.chief
    has_mean_motion = isinstance(mission.model, OrbitalModel) and bool(mission.model.mean_motion)
    if chief is not None and not has_mean_motion:
        return chief.drift_free_velocities(placed, t, where, _velocity_times(mission))
    if isinstance(model, CircularOrbitModel | TschaunerHempel):
        return model.bounded_velocity(placed, t)
    return np.zeros_like(placed)


def _velocity_times(mission: Reconfiguration) -> list[float]:
    """Return all times at which agents start, join or arrive, as planned [s]."""
    begins = [mission.step * k for k in accumulate((leg.steps for leg in mission.legs), initial=0)]
    each = zip(begins, mission.legs, strict=False)
    joins = [begin + join.at_step * mission.step for begin, leg in each for join in leg.joins]
    return begins + joins


def as_listed_points(states: Float[Array, "k n"]) -> Points:
    """Return states as points in their order."""
    d = states.shape[1] // 2
    return Points(states[:, :d], states[:, d:], keep_order=True)
