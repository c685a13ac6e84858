"""Price of decentralization: a plan of SATO against the best optimum of the coupled program.

Vehicles exchange places through one point, each with its target: across a circle in the plane,
with the limits of the scenario `crossing`, or across a sphere about a chief in orbit, with those of
`orbit3d`. Instances are drawn until at least as many pairs as half the vehicles would conflict if
each flew alone. All use the same linear model.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import combinations
from time import process_time
from typing import Any

import numpy as np
from numpy import ndarray as Array

from dynamics import (
    J2,
    DoubleIntegrator,
    LinearizedModel,
    Orbit,
    discretize_zoh,
    invariant_velocity,
)
from problems.centralized import CentralizedProblem, NoFeasibleSolution, SimulatedSolution
from problems.centralized_nlp import InitialGuess
from problems.convexify import AvoidanceHorizon
from problems.transfer import TransferProblem
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import make_horizon, plan_trajectories
from sato.reconfiguration.solo_trajectories import solve_solo_transfers
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.shapes import Points

MIN_SPACING = 1.2  # times R: between starts, and between targets
TARGET_NOISE = 0.03  # standard deviation of the targets, relative to the radius
ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4, true_anomaly=-np.pi / 4)
SPHERE_RADIUS = 150.0  # [m]
CIRCLE_RADIUS = 5.0  # [m]
MAX_DRAWS = 20_000  # draws with too little spacing, after which there is taken to be no room
MAX_RATIO = 1.05  # of SATO's fuel to that of the best optimum


def compare(
    _: np.random.Generator,
    model: str,
    agents: int,
    number: int,
    guesses: int,
    orders: int,
    bargains: int,
) -> dict[str, Any]:
    """Compare the fuel [m/s] of one plan, of the best optimum, and of all alone.

    Args:
        model: "plane" or "j2".
        agents: Number of vehicles.
        number: Number of the instance, which decides it.
        guesses: Number of random initial guesses, besides four others.
        orders: Orders of priority that a plan tries; column `printed` has one, by number.
        bargains: Sweeps of negotiation.

    Returns:
        Columns; `printed` and `sato` are infinite where a target or a distance was given up,
        `padding` is the largest distance that the optimum had to keep beyond R, in units of R.
    """
    mission, central, free, meetings = make_instance(model, agents, number)
    start, target = mission.initial_states, mission.legs[0].targets
    begun = process_time()
    planned, sato, gave_up = _plan(central, replace(mission, orders=orders, bargains=bargains))
    planning = process_time() - begun
    _, printed, _ = _plan(central, mission)
    rng = np.random.default_rng([0, agents, number, 1])
    begin = {"SATO": planned} | _initial_guesses(rng, mission, free, guesses)
    alone = central.simulate(start, target, free[1], "alone").cost
    row = {"meetings": meetings, "alone": alone, "central": None, "from_guess": "none"}
    begun = process_time()
    try:
        best, tried = central.solve(start, target, list(begin.values()))
        row |= {"central": best.cost, "from_guess": _guess_name(best, tried, list(begin))}
        row |= {"padding": best.padding, "ratio_printed": printed / best.cost}
        row |= {"ratio": sato / best.cost, "good": sato / best.cost <= MAX_RATIO}
    except NoFeasibleSolution:
        pass
    row |= {"found": row["central"] is not None, "printed": printed, "sato": sato}
    row |= {"gave_up": gave_up, "has_given_up": bool(gave_up)}
    return row | {"planning": planning, "descending": process_time() - begun}


def _plan(central: CentralizedProblem, mission: Reconfiguration) -> tuple[InitialGuess, float, str]:
    """Plan once for the swarm, with messages among all; return plan, fuel and what it gave up."""
    N, d = len(mission.initial_states), mission.linear_model.axes
    leg, x = mission.legs[0], mission.initial_states
    network = CommunicationGraph.from_positions(x[:, :d], mission.comm_radius, mission.alive)
    memory = replace(AgentMemory.initial(np.full(N, N)), target_index=np.arange(N))
    context = DecisionContext(mission, leg, network, x, memory, 0, 0.0)
    plans, events, _ = plan_trajectories(context, np.zeros(N), {})
    flights = [plans[i].trajectory for i in range(N)]
    planned = np.stack([f.x for f in flights]), np.stack([f.u for f in flights])
    gave_up = ", ".join(sorted({event["kind"] for event in events} - {"replan"}))
    own = central.simulate(x, leg.targets, planned[1], "SATO")
    if not gave_up and not own.is_feasible:
        gave_up = f"does not stand: {own}"
    return planned, np.inf if gave_up else own.cost, gave_up


def _guess_name(
    best: SimulatedSolution, tried: tuple[SimulatedSolution, ...], names: list[str]
) -> str:
    at = next(i for i, t in enumerate(tried) if t is best)
    return names[at % len(names)] + (", as it is" if at < len(names) else "")


def draw_missions(model: str, agents: int, number: int) -> Iterator[Reconfiguration]:
    """Draw missions without end."""
    rng = np.random.default_rng([0, agents, number])
    while True:
        if model == "plane":
            start, target = draw_opposite_points(agents, 2, 1 / CIRCLE_RADIUS, rng)
            mission = Reconfiguration(
                model=DoubleIntegrator(2),
                start=Points(CIRCLE_RADIUS * start, keep_order=True),
                legs=(Leg(Points(CIRCLE_RADIUS * target, keep_order=True), 36),),
                step=1.0,
                comm_radius=100.0,
                collision_radius=1.0,
                max_control=0.1,
                max_speed=0.5,
                foresight_steps=36,
            )
        else:
            sides = draw_opposite_points(agents, 3, 50 / SPHERE_RADIUS, rng)
            start, target = (SPHERE_RADIUS * side for side in sides)
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
) -> tuple[Array, Array]:
    """Draw points on the unit circle or sphere, and nearly opposite ones, none too close.

    Raises:
        ValueError: They do not fit.
    """
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
    raise ValueError(f"{count} vehicles found no room in {MAX_DRAWS} draws")


def make_instance(
    model: str, agents: int, number: int
) -> tuple[Reconfiguration, CentralizedProblem, InitialGuess, int]:
    """Return the first mission with enough conflicts if all fly alone, and these trajectories."""
    transfer, horizon = _shared_problem(model)
    for mission in draw_missions(model, agents, number):
        ends = mission.initial_states, mission.legs[0].targets
        flights = [flight for flight in solve_solo_transfers(transfer, *ends)[0] if flight]
        if len(flights) < agents:
            continue
        free = np.stack([f.x for f in flights]), np.stack([f.u for f in flights])
        meetings = _count_conflicts(CentralizedProblem(transfer, horizon), *free)
        if 2 * meetings >= agents:
            horizon = make_horizon(mission, 0.0, mission.legs[0].steps)
            return mission, CentralizedProblem(transfer, horizon), free, meetings
    raise AssertionError("unreachable: draw_missions does not end")


def _count_conflicts(problem: CentralizedProblem, x: Array, u: Array) -> int:
    """Count the pairs of agents that come too close if all fly alone."""
    pairs = map(list, combinations(range(len(x)), 2))
    flights = (problem.simulate(x[pair, 0], x[pair, -1], u[pair], "") for pair in pairs)
    return sum(flight.min_separation < 1 for flight in flights)


@cache
def _shared_problem(model: str) -> tuple[TransferProblem, AvoidanceHorizon]:
    """Return transfer and horizon, which missions of a model share up to rounding of the radius."""
    mission = next(draw_missions(model, 2, 0))
    steps = mission.legs[0].steps
    discrete = discretize_zoh(mission.linear_model, mission.step, steps)
    transfer = TransferProblem(discrete, mission.max_control, mission.max_speed)
    return transfer, make_horizon(mission, 0.0, steps)


def _initial_guesses(
    rng: np.random.Generator, mission: Reconfiguration, free: InitialGuess, count: int
) -> dict[str, InitialGuess]:
    """Return guesses: all alone, all displaced to the right or left, and at random."""
    d, radius = free[1].shape[-1], mission.collision_radius
    along = free[0][:, -1, :d] - free[0][:, 0, :d]
    axis = np.array([0.0, 0.0, 1.0]) if d == 2 else rng.normal(size=3)
    aside = np.cross(np.pad(along, ((0, 0), (0, 3 - d))), axis)[:, :d]
    aside *= radius / np.linalg.norm(aside, axis=1, keepdims=True)
    ways = {"right": aside, "left": -aside}
    ways |= {f"random {k}": radius * rng.normal(size=along.shape) for k in range(count)}
    displaced = {name: displace_guess(free, mission.step, way) for name, way in ways.items()}
    return {"alone": free} | displaced


def displace_guess(guess: InitialGuess, dt: float, by: Array) -> InitialGuess:
    """Displace every trajectory of a guess sideways: most half-way [m], not at the ends."""
    x, u = guess
    T = u.shape[1]
    phase = np.pi * np.arange(T + 1)[:, None] / T
    position = np.sin(phase) * by[:, None]
    speed = np.pi / (T * dt) * np.cos(phase) * by[:, None]
    return x + np.concatenate([position, speed], axis=-1), u
