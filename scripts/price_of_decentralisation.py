"""What the distributed method pays: python scripts/price_of_decentralisation.py --agents 2-10.

Vehicles exchange places through one point, each with its target: across a circle in the plane, by
the limits of the scenario `crossing`, or across a sphere about a chief in orbit, by those of
`orbit3d`, drawn anew until as many pairs as half the vehicles would meet if each flew alone.
For every instance: the fuel of one plan of the swarm (all hear each other, nobody has burnt fuel),
of the best optimum of the coupled programme, and of all alone. The plan is made with one order of
priority, which is by number, and with several. Both fly the same linear model, exactly; a ratio
that is infinite means that SATO gave up a target or a distance.
"""

import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from enum import StrEnum
from functools import cache
from itertools import combinations
from multiprocessing import get_context
from time import process_time
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from dynamics import J2, DoubleIntegrator, Linearised, Orbit, hold, invariant_velocity
from problems.central import Central, Flown, Guess, NoneStands, pushed
from problems.convexify import Horizon
from problems.transfer import Transfer
from sato.network import Network
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.moment import Moment
from sato.reconfiguration.planning import NO_PLANS, look_ahead, plan
from sato.reconfiguration.pricing import Minds
from sato.reconfiguration.routes import alone

WANTED = 1.05  # the median of SATO's fuel over that of the best optimum
APART = 1.2  # times R: between starts, and between targets
NOISE = 0.03  # of the radius, on targets
ORBIT = Orbit.of_elements(6878e3, inclination=np.pi / 4, anomaly=-np.pi / 4)
SPHERE = 150.0  # radius [m]
CIRCLE = 5.0  # radius [m]


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
    orders: int


class Row(NamedTuple):
    """What was found of it."""

    case: Case
    meetings: int  # pairs that would meet if each flew alone
    alone: float  # fuel [m/s]
    central: float  # fuel of the best optimum [m/s]; NaN where none was found
    from_guess: str  # what that was found from
    printed: float  # fuel with one order of priority; infinite where something was given up [m/s]
    sato: float  # fuel with several, likewise
    gave_up: str  # what SATO gave up then, if anything
    seconds: tuple[float, float]  # of SATO with several, and of all the descents

    @property
    def ratio(self) -> float:
        """SATO over the best optimum."""
        return self.sato / self.central


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
    while True:
        start = rng.normal(size=(count, axes))
        start /= np.linalg.norm(start, axis=1, keepdims=True)
        goal = NOISE * rng.normal(size=start.shape) - start
        if all(
            np.linalg.norm(side[i] - side[j]) >= APART * radius
            for side in (start, goal)
            for i, j in combinations(range(count), 2)
        ):
            return start, goal


def instance(case: Case) -> tuple[Reconfiguration, Central, Guess, int]:
    """The first mission in which enough pairs would meet, and how all would fly alone."""
    transfer, near = shared(case.model)
    for mission in missions(case):
        flights = [f for f in alone(transfer, mission.start, mission.legs[0].targets)[0] if f]
        if len(flights) < case.agents:
            continue
        free = np.stack([f.x for f in flights]), np.stack([f.u for f in flights])
        meetings = Central(transfer, near).meetings(*free)
        if 2 * meetings >= case.agents:
            horizon = look_ahead(mission, 0.0, mission.legs[0].steps)
            return mission, Central(transfer, horizon), free, meetings
    raise AssertionError("missions never end")


@cache
def shared(kind: Model) -> tuple[Transfer, Horizon]:
    """What all missions of a kind share, but for millimetres of the radius."""
    mission = next(missions(Case(kind, 2, 0, 0, 0, 1)))
    steps = mission.legs[0].steps
    transfer = Transfer(
        hold(mission.model, mission.step, steps), mission.max_control, mission.max_speed
    )
    return transfer, look_ahead(mission, 0.0, steps)


def sato(mission: Reconfiguration) -> tuple[Guess, str]:
    """One plan of the swarm, by messages among all, and what it gave up."""
    N, d = len(mission.start), mission.model.axes
    network = Network.within(mission.start[:, :d], mission.comm_radius, mission.alive)
    moment = Moment(mission, mission.legs[0], network, mission.start, 0, 0.0)
    minds = replace(Minds.fresh(np.full(N, N)), target=np.arange(N))
    plans, events = plan(moment, minds, np.zeros(N), NO_PLANS)
    flights = [plans.flights[i] for i in range(N)]
    gave_up = ", ".join(sorted({event["kind"] for event in events} - {"replan"}))
    return (np.stack([f.x for f in flights]), np.stack([f.u for f in flights])), gave_up


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


def compare(case: Case) -> Row:
    """One instance."""
    mission, central, free, meetings = instance(case)
    start, goal = mission.start, mission.legs[0].targets
    begun = process_time()
    planned, own, gave_up = flown(central, replace(mission, orders=case.orders))
    planning = process_time() - begun
    begun = process_time()
    _, once, gave_up_once = flown(central, mission)
    begin = {"SATO": planned} | guesses(case, free, mission.collision_radius, mission.step)
    lower = central.fly(start, goal, free[1], "alone").fuel
    try:
        best, tried = central.solve(start, goal, list(begin.values()))
        fuel, origin = best.fuel, _origin(best, tried, list(begin))
    except NoneStands:
        fuel, origin = np.nan, "none"
    took = planning, process_time() - begun
    printed = np.inf if gave_up_once else once.fuel
    planned_fuel = np.inf if gave_up else own.fuel
    return Row(case, meetings, lower, fuel, origin, printed, planned_fuel, gave_up, took)


def flown(central: Central, mission: Reconfiguration) -> tuple[Guess, Flown, str]:
    """A plan of the swarm, the same judged as the programme's answers are, and what it gave up."""
    planned, gave_up = sato(mission)
    own = central.fly(mission.start, mission.legs[0].targets, planned[1], "SATO")
    if not gave_up and not own.stands:
        gave_up = f"does not stand: {own}"
    return planned, own, gave_up


def _origin(best: Flown, tried: tuple[Flown, ...], names: list[str]) -> str:
    at = next(i for i, t in enumerate(tried) if t is best)
    return names[at % len(names)] + (", as it is" if at < len(names) else "")


def _agents(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def main(
    agents: Annotated[str, typer.Option(help="how many, as in 4 or 2-10")] = "2-10",
    instances: Annotated[int, typer.Option(help="of each number of agents")] = 20,
    model: Annotated[list[Model] | None, typer.Option(help="plane, j2; both if left out")] = None,
    workers: Annotated[int, typer.Option(help="processes")] = 2,
    guesses: Annotated[int, typer.Option(help="random ones, beyond four others")] = 3,
    orders: Annotated[int, typer.Option(help="of priority that a plan tries")] = 12,
    seed: int = 0,
) -> None:
    """Compare; exit with 1 if a median is above what is wanted."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # of the workers: IPOPT's solver would take all cores
    cases = [
        Case(kind, count, number, seed, guesses, orders)
        for kind in model or list(Model)
        for count in _agents(agents)
        for number in range(instances)
    ]
    rows: list[Row] = []
    console = Console(stderr=True)
    with (
        ProcessPoolExecutor(workers, get_context("spawn")) as pool,
        Progress(console=console) as bar,
    ):
        task = bar.add_task("instances", total=len(cases))
        for done in as_completed([pool.submit(compare, case) for case in cases]):
            rows.append(done.result())
            bar.advance(task)
    rows.sort(key=lambda row: row.case)
    out = Console(width=max(130, Console().width))
    out.print(every(rows))
    medians = summary(rows)
    out.print(medians[0])
    sys.exit(int(medians[1] > WANTED))


def every(rows: list[Row]) -> Table:
    """A line an instance."""
    table = Table(
        "model", "N", "no.", "meet", "alone [m/s]", "best/alone", "one order/best", "SATO/best",
        "best from", "CPU [s]", "SATO gave up",
    )  # fmt: skip
    for row in rows:
        table.add_row(
            row.case.model,
            str(row.case.agents),
            str(row.case.number),
            str(row.meetings),
            f"{row.alone:.4f}",
            f"{row.central / row.alone:.4f}",
            f"{row.printed / row.central:.4f}",
            f"{row.ratio:.4f}",
            row.from_guess,
            f"{row.seconds[0]:.1f} + {row.seconds[1]:.0f}",
            row.gave_up,
        )
    return table


def summary(rows: list[Row]) -> tuple[Table, float]:
    """A line a number of agents, and the largest median."""
    table = Table(
        "model", "N", "one order/best: median", "worst", "gave up", "SATO/best: median", "worst",
        "gave up", "best/alone: median", "none found",
    )  # fmt: skip
    largest = 0.0
    for kind, count in dict.fromkeys((row.case.model, row.case.agents) for row in rows):
        those = [r for r in rows if (r.case.model, r.case.agents) == (kind, count)]
        ratios = [r.ratio for r in those]
        printed = [r.printed / r.central for r in those]
        median = float(np.median(ratios))
        largest = max(largest, median)
        table.add_row(
            kind,
            str(count),
            f"{np.median(printed):.4f}",
            f"{max(printed):.4f}",
            f"{sum(map(np.isinf, printed))} of {len(those)}",
            f"{median:.4f}",
            f"{max(ratios):.4f}",
            f"{sum(bool(r.gave_up) for r in those)} of {len(those)}",
            f"{np.nanmedian([r.central / r.alone for r in those]):.4f}",
            str(sum(bool(np.isnan(r.central)) for r in those)),
        )
    return table, largest


if __name__ == "__main__":
    typer.run(main)
