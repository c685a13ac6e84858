"""Instances of `price_of_decentralization.py`, and initial guesses for them."""

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
from problems.centralized import CentralizedProblem
from problems.centralized_nlp import InitialGuess, displace_guess
from problems.convexify import AvoidanceHorizon
from problems.transfer import TransferProblem
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import make_horizon
from sato.reconfiguration.solo_trajectories import solve_solo_transfers
from sato.shapes import Points

MIN_SPACING = 1.2  # times R: between starts, and between targets
TARGET_NOISE = 0.03  # standard deviation of the targets, relative to the radius
ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4, true_anomaly=-np.pi / 4)
SPHERE_RADIUS = 150.0  # radius [m]
CIRCLE_RADIUS = 5.0  # radius [m]
MAX_DRAWS = 20_000  # draws with too little spacing, after which there is taken to be no room


class MotionModel(StrEnum):
    """Model of the motion."""

    plane = "plane"
    j2 = "j2"


class PriceCase(NamedTuple):
    """Instance and settings."""

    model: MotionModel
    agents: int
    number: int
    seed: int
    guesses: int
    orders: int = 1
    bargains: int = 0


def draw_missions(case: PriceCase) -> Iterator[Reconfiguration]:
    """Draw missions of a case without end."""
    rng = np.random.default_rng([case.seed, case.agents, case.number])
    while True:
        if case.model is MotionModel.plane:
            start, target = (
                CIRCLE_RADIUS * side
                for side in draw_opposite_points(case.agents, 2, 1 / CIRCLE_RADIUS, rng)
            )
            mission = Reconfiguration(
                model=DoubleIntegrator(2),
                start=Points(start, keep_order=True),
                legs=(Leg(Points(target, keep_order=True), 36),),
                step=1.0,
                comm_radius=100.0,
                collision_radius=1.0,
                max_control=0.1,
                max_speed=0.5,
                foresight_steps=36,
            )
        else:
            start, target = (
                SPHERE_RADIUS * side
                for side in draw_opposite_points(case.agents, 3, 50 / SPHERE_RADIUS, rng)
            )
            arrival = invariant_velocity(ORBIT, target, 24 * 60.0)
            mission = Reconfiguration(
                model=LinearizedModel(J2(ORBIT)),
                start=Points(start, invariant_velocity(ORBIT, start), keep_order=True),
                legs=(Leg(Points(target, arrival, keep_order=True), 24),),
                step=60.0,
                comm_radius=1e5,
                collision_radius=50.0,
                max_control=0.01,
                max_speed=4.0,
                foresight_steps=24,
            )
        yield mission.draw(rng)


def draw_opposite_points(
    count: int, axes: int, radius: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw points on the unit circle or sphere, and nearly opposite ones, none too close."""
    for _ in range(MAX_DRAWS):
        start = rng.normal(size=(count, axes))
        start /= np.linalg.norm(start, axis=1, keepdims=True)
        target = TARGET_NOISE * rng.normal(size=start.shape) - start
        if all(
            np.linalg.norm(side[i] - side[j]) >= MIN_SPACING * radius
            for side in (start, target)
            for i, j in combinations(range(count), 2)
        ):
            return start, target
    raise typer.BadParameter(f"{count} vehicles found no room in {MAX_DRAWS} draws")


def make_instance(case: PriceCase) -> tuple[Reconfiguration, CentralizedProblem, InitialGuess, int]:
    """Return the first mission with enough conflicts if all fly alone, and these trajectories."""
    transfer, horizon = shared_problem(case.model)
    for mission in draw_missions(case):
        free = solve_alone(transfer, mission)
        if free is None:
            continue
        meetings = CentralizedProblem(transfer, horizon).count_conflicts(*free)
        if 2 * meetings >= case.agents:
            horizon = make_horizon(mission, 0.0, mission.legs[0].steps)
            return mission, CentralizedProblem(transfer, horizon), free, meetings
    raise AssertionError("unreachable: draw_missions does not end")


def solve_alone(transfer: TransferProblem, mission: Reconfiguration) -> InitialGuess | None:
    """Return the trajectories of all if each flies alone, or None where one cannot arrive."""
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
    """Return transfer and horizon, which missions of a model share up to rounding of the radius."""
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
    """Return guesses: all alone, all displaced to the right or left, and at random."""
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
