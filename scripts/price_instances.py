"""The instances that `price_of_decentralisation.py` asks about, and guesses for them."""

from collections.abc import Iterator
from enum import StrEnum
from functools import cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
import typer

from dynamics import (
    J2,
    DoubleIntegrator,
    LinearizedModel,
    Orbit,
    discretize_zoh,
    invariant_velocity,
)
from problems.centralized import CentralizedProblem, InitialGuess, displace_guess
from problems.convexify import AvoidanceHorizon
from problems.transfer import TransferProblem
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.planning import make_horizon
from sato.reconfiguration.solo_trajectories import solve_solo_transfers

MIN_SPACING = 1.2  # times R: between starts, and between targets
TARGET_NOISE = 0.03  # of the radius, on targets
ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4, true_anomaly=-np.pi / 4)
SPHERE_RADIUS = 150.0  # radius [m]
CIRCLE_RADIUS = 5.0  # radius [m]
MAX_DRAWS = 20_000  # of ends that are too close, before it is said that there is no room


class MotionModel(StrEnum):
    """Where vehicles fly."""

    plane = "plane"
    j2 = "j2"


class PriceCase(NamedTuple):
    """One instance."""

    model: MotionModel
    agents: int
    number: int
    seed: int
    guesses: int
    orders: int = 1
    bargains: int = 0


def draw_missions(case: PriceCase) -> Iterator[Reconfiguration]:
    """Missions of a case, drawn one after another."""
    rng = np.random.default_rng([case.seed, case.agents, case.number])
    while True:
        if case.model is MotionModel.plane:
            start, goal = (
                CIRCLE_RADIUS * side
                for side in draw_opposite_points(case.agents, 2, 1 / CIRCLE_RADIUS, rng)
            )
            still = np.zeros_like(start)
            leg = Leg(np.hstack([goal, still]), 36)
            yield Reconfiguration(
                linear_model=DoubleIntegrator(2),
                initial_states=np.hstack([start, still]),
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
            start, goal = (
                SPHERE_RADIUS * side
                for side in draw_opposite_points(case.agents, 3, 50 / SPHERE_RADIUS, rng)
            )
            leg = Leg(np.hstack([goal, invariant_velocity(ORBIT, goal, 24 * 60.0)]), 24)
            yield Reconfiguration(
                linear_model=LinearizedModel.at_origin(J2(ORBIT)),
                initial_states=np.hstack([start, invariant_velocity(ORBIT, start)]),
                alive=np.ones(case.agents, dtype=bool),
                legs=(leg,),
                step=60.0,
                comm_radius=1e5,
                collision_radius=50.0,
                max_control=0.01,
                max_speed=4.0,
                foresight_steps=24,
            )


def draw_opposite_points(
    count: int, axes: int, radius: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Points on the unit circle or sphere, and nearly opposite ones, none too close."""
    for _ in range(MAX_DRAWS):
        start = rng.normal(size=(count, axes))
        start /= np.linalg.norm(start, axis=1, keepdims=True)
        goal = TARGET_NOISE * rng.normal(size=start.shape) - start
        if all(
            np.linalg.norm(side[i] - side[j]) >= MIN_SPACING * radius
            for side in (start, goal)
            for i, j in combinations(range(count), 2)
        ):
            return start, goal
    raise typer.BadParameter(f"{count} vehicles found no room in {MAX_DRAWS} draws")


def make_instance(case: PriceCase) -> tuple[Reconfiguration, CentralizedProblem, InitialGuess, int]:
    """The first mission in which enough pairs would meet if all flew alone, and how they would."""
    transfer, near = shared_problem(case.model)
    for mission in draw_missions(case):
        free = solve_alone(transfer, mission)
        if free is None:
            continue
        meetings = CentralizedProblem(transfer, near).count_conflicts(*free)
        if 2 * meetings >= case.agents:
            horizon = make_horizon(mission, 0.0, mission.legs[0].steps)
            return mission, CentralizedProblem(transfer, horizon), free, meetings
    raise AssertionError("missions never end")


def solve_alone(transfer: TransferProblem, mission: Reconfiguration) -> InitialGuess | None:
    """How all would fly alone, if all can arrive."""
    flights = [
        f
        for f in solve_solo_transfers(transfer, mission.initial_states, mission.legs[0].targets)[0]
        if f
    ]
    if len(flights) < len(mission.initial_states):
        return None
    return np.stack([f.x for f in flights]), np.stack([f.u for f in flights])


@cache
def shared_problem(kind: MotionModel) -> tuple[TransferProblem, AvoidanceHorizon]:
    """What all missions of a kind share, but for millimetres of the radius."""
    mission = next(draw_missions(PriceCase(kind, 2, 0, 0, 0)))
    steps = mission.legs[0].steps
    transfer = TransferProblem(
        discretize_zoh(mission.linear_model, mission.step, steps),
        mission.max_control,
        mission.max_speed,
    )
    return transfer, make_horizon(mission, 0.0, steps)


def initial_guesses(
    case: PriceCase, free: InitialGuess, radius: float, dt: float
) -> dict[str, InitialGuess]:
    """All alone; all aside to one hand and to the other; all aside at random."""
    rng = np.random.default_rng([case.seed, case.agents, case.number, 1])
    d = free[1].shape[-1]
    along = free[0][:, -1, :d] - free[0][:, 0, :d]
    axis = np.array([0.0, 0.0, 1.0]) if d == 2 else rng.normal(size=3)
    aside = np.cross(np.pad(along, ((0, 0), (0, 3 - d))), axis)[:, :d]
    aside *= radius / np.linalg.norm(aside, axis=1, keepdims=True)
    found = {
        "alone": free,
        "right": displace_guess(free, dt, aside),
        "left": displace_guess(free, dt, -aside),
    }
    for k in range(case.guesses):
        found[f"random {k}"] = displace_guess(free, dt, radius * rng.normal(size=along.shape))
    return found
