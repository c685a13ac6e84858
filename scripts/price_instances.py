"""The instances that `price_of_decentralisation.py` asks about, and guesses for them."""

from collections.abc import Iterator
from enum import StrEnum
from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
import typer

from dynamics import J2, DoubleIntegrator, Linearised, Orbit, hold, invariant_velocity
from problems.central import Central, Guess, pushed
from problems.convexify import Horizon
from problems.transfer import Transfer
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.planning import look_ahead
from sato.reconfiguration.routes import alone

APART = 1.2  # times R: between starts, and between targets
NOISE = 0.03  # of the radius, on targets
ORBIT = Orbit.of_elements(6878e3, inclination=np.pi / 4, anomaly=-np.pi / 4)
SPHERE = 150.0  # radius [m]
CIRCLE = 5.0  # radius [m]
DRAWS = 20_000  # of ends that are too close, before it is said that there is no room


class Model(StrEnum):
    """Where vehicles fly."""

    plane = "plane"
    j2 = "j2"


class Case(NamedTuple):
    """One instance."""

    model: Model
    agents: int
    number: int
    seed: int
    guesses: int
    orders: int = 1
    bargains: int = 0


def missions(case: Case) -> Iterator[Reconfiguration]:
    """Missions of a case, drawn one after another."""
    rng = np.random.default_rng([case.seed, case.agents, case.number])
    while True:
        if case.model is Model.plane:
            start, goal = (CIRCLE * side for side in across(case.agents, 2, 1 / CIRCLE, rng))
            still = np.zeros_like(start)
            leg = Leg(np.hstack([goal, still]), 36)
            yield Reconfiguration(
                model=DoubleIntegrator(2),
                start=np.hstack([start, still]),
                alive=np.ones(case.agents, dtype=bool),
                legs=(leg,),
                step=1.0,
                comm_radius=100.0,
                collision_radius=1.0,
                max_control=0.1,
                max_speed=0.5,
                foresight_steps=36,
            )
        else:
            start, goal = (SPHERE * side for side in across(case.agents, 3, 50 / SPHERE, rng))
            leg = Leg(np.hstack([goal, invariant_velocity(ORBIT, goal, 24 * 60.0)]), 24)
            yield Reconfiguration(
                model=Linearised.at_origin(J2(ORBIT)),
                start=np.hstack([start, invariant_velocity(ORBIT, start)]),
                alive=np.ones(case.agents, dtype=bool),
                legs=(leg,),
                step=60.0,
                comm_radius=1e5,
                collision_radius=50.0,
                max_control=0.01,
                max_speed=4.0,
                foresight_steps=24,
            )


def across(
    count: int, axes: int, radius: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points on the unit circle or sphere, and nearly opposite ones, none too close."""
    for _ in range(DRAWS):
        start = rng.normal(size=(count, axes))
        start /= np.linalg.norm(start, axis=1, keepdims=True)
        goal = NOISE * rng.normal(size=start.shape) - start
        if all(
            np.linalg.norm(side[i] - side[j]) >= APART * radius
            for side in (start, goal)
            for i, j in combinations(range(count), 2)
        ):
            return start, goal
    raise typer.BadParameter(f"{count} vehicles found no room in {DRAWS} draws")


def instance(case: Case) -> tuple[Reconfiguration, Central, Guess, int]:
    """The first mission in which enough pairs would meet if all flew alone, and how they would."""
    transfer, near = shared(case.model)
    for mission in missions(case):
        free = by_themselves(transfer, mission)
        if free is None:
            continue
        meetings = Central(transfer, near).meetings(*free)
        if 2 * meetings >= case.agents:
            horizon = look_ahead(mission, 0.0, mission.legs[0].steps)
            return mission, Central(transfer, horizon), free, meetings
    raise AssertionError("missions never end")


def by_themselves(transfer: Transfer, mission: Reconfiguration) -> Guess | None:
    """How all would fly alone, if all can arrive."""
    flights = [f for f in alone(transfer, mission.start, mission.legs[0].targets)[0] if f]
    if len(flights) < len(mission.start):
        return None
    return np.stack([f.x for f in flights]), np.stack([f.u for f in flights])


@cache
def shared(kind: Model) -> tuple[Transfer, Horizon]:
    """What all missions of a kind share, but for millimetres of the radius."""
    mission = next(missions(Case(kind, 2, 0, 0, 0)))
    steps = mission.legs[0].steps
    transfer = Transfer(
        hold(mission.model, mission.step, steps), mission.max_control, mission.max_speed
    )
    return transfer, look_ahead(mission, 0.0, steps)


def guesses(case: Case, free: Guess, radius: float, dt: float) -> dict[str, Guess]:
    """All alone; all aside to one hand and to the other; all aside at random."""
    rng = np.random.default_rng([case.seed, case.agents, case.number, 1])
    d = free[1].shape[-1]
    along = free[0][:, -1, :d] - free[0][:, 0, :d]
    axis = np.array([0.0, 0.0, 1.0]) if d == 2 else rng.normal(size=3)
    aside = np.cross(np.pad(along, ((0, 0), (0, 3 - d))), axis)[:, :d]
    aside *= radius / np.linalg.norm(aside, axis=1, keepdims=True)
    found = {"alone": free, "right": pushed(free, dt, aside), "left": pushed(free, dt, -aside)}
    for k in range(case.guesses):
        found[f"random {k}"] = pushed(free, dt, radius * rng.normal(size=along.shape))
    return found
