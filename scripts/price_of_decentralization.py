"""What the distributed method pays: python scripts/price_of_decentralization.py --agents 2-10.

Vehicles exchange places through one point, each with its target: across a circle in the plane, by
the limits of the scenario `crossing`, or across a sphere about a chief in orbit, by those of
`orbit3d`, drawn anew until as many pairs as half the vehicles would meet if each flew alone.
For every instance: the fuel of one plan of the swarm (all hear each other, nobody has burnt fuel),
of the best optimum of the coupled programme, and of all alone. The plan is made with one order of
priority, which is by number, and with several, bargains and roundabouts. Both fly the same linear
model, exactly; a ratio that is infinite means that SATO gave up a target or a distance. Exits with
1 unless every median is as wanted.
"""

import csv
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from time import process_time
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from price_instances import MotionModel, PriceCase, draw_missions, initial_guesses, make_instance
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from problems.centralized import (
    CentralizedProblem,
    InitialGuess,
    NoFeasibleSolution,
    SimulatedSolution,
)
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.state import AgentMemory
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.planning import NO_PLANS, plan_trajectories

MAX_MEDIAN_RATIO = 1.05  # the median of SATO's fuel over that of the best optimum


class PriceResult(NamedTuple):
    """What was found of it."""

    case: PriceCase
    meetings: int  # pairs that would meet if each flew as SATO has it fly alone
    alone: float  # fuel [m/s]
    central: float  # fuel of the best optimum [m/s]; NaN where none was found
    from_guess: str  # what that was found from
    padding: float  # most that it was made to keep beyond R, in units of R
    printed: float  # fuel with one order of priority; infinite where something was given up [m/s]
    sato: float  # fuel with several, bargains and roundabouts, likewise
    gave_up: str  # what SATO gave up then, if anything
    planning: float  # with several orders, on the processor [s]
    descending: float  # from all guesses, likewise [s]

    @property
    def ratio(self) -> float:
        """SATO over the best optimum; NaN where none was found."""
        return self.sato / self.central

    @property
    def ratio_printed(self) -> float:
        """The same with one order of priority."""
        return self.printed / self.central


def plan_swarm(mission: Reconfiguration) -> tuple[InitialGuess, str]:
    """One plan of the swarm, by messages among all, and what it gave up."""
    N, d = len(mission.initial_states), mission.linear_model.axes
    network = CommunicationGraph.from_positions(
        mission.initial_states[:, :d], mission.comm_radius, mission.alive
    )
    moment = DecisionContext(mission, mission.legs[0], network, mission.initial_states, 0, 0.0)
    minds = replace(AgentMemory.initial(np.full(N, N)), target_index=np.arange(N))
    plans, events = plan_trajectories(moment, minds, np.zeros(N), NO_PLANS)
    flights = [plans.trajectories[i] for i in range(N)]
    gave_up = ", ".join(sorted({event["kind"] for event in events} - {"replan"}))
    return (np.stack([f.x for f in flights]), np.stack([f.u for f in flights])), gave_up


def compare_case(case: PriceCase) -> PriceResult:
    """One instance."""
    mission, central, free, meetings = make_instance(case)
    start, goal = mission.initial_states, mission.legs[0].targets
    tried = replace(mission, orders=case.orders, bargains=case.bargains)
    planned, own, gave_up, planning = plan_and_verify(central, tried)
    _, once, gave_up_once, _ = plan_and_verify(central, mission)
    begin = {"SATO": planned} | initial_guesses(case, free, mission.collision_radius, mission.step)
    lower = central.simulate(start, goal, free[1], "alone").fuel
    fuel, origin, padding = np.nan, "none", np.nan
    begun = process_time()
    try:
        best, tried = central.solve(start, goal, list(begin.values()))
        fuel, origin, padding = best.fuel, _guess_name(best, tried, list(begin)), best.padding
    except NoFeasibleSolution:
        pass
    descending = process_time() - begun
    return PriceResult(
        case,
        meetings,
        lower,
        fuel,
        origin,
        padding,
        np.inf if gave_up_once else once.fuel,
        np.inf if gave_up else own.fuel,
        gave_up,
        planning,
        descending,
    )


def plan_and_verify(
    central: CentralizedProblem, mission: Reconfiguration
) -> tuple[InitialGuess, SimulatedSolution, str, float]:
    """A plan of the swarm, the same judged as answers are, what it gave up, and its time."""
    begun = process_time()
    planned, gave_up = plan_swarm(mission)
    took = process_time() - begun
    own = central.simulate(mission.initial_states, mission.legs[0].targets, planned[1], "SATO")
    if not gave_up and not own.is_feasible:
        gave_up = f"does not stand: {own}"
    return planned, own, gave_up, took


def warm_up(kinds: list[MotionModel]) -> None:
    """Let a process load and compile what it needs, so that it counts for no instance."""
    for kind in kinds:
        compare_case(PriceCase(kind, 2, 0, 0, 0, 2, 1))


def _guess_name(
    best: SimulatedSolution, tried: tuple[SimulatedSolution, ...], names: list[str]
) -> str:
    at = next(i for i, t in enumerate(tried) if t is best)
    return names[at % len(names)] + (", as it is" if at < len(names) else "")


def _parse_range(text: str) -> list[int]:
    first, dash, last = text.partition("-")
    if not (first.isdecimal() and (last.isdecimal() or not dash)):
        raise typer.BadParameter(f"how many vehicles is a number or two, as in 4 or 2-10: {text!r}")
    counts = list(range(int(first), int(last or first) + 1))
    if not counts or counts[0] < 2:
        raise typer.BadParameter(f"vehicles are 2 or more, and the larger number is last: {text!r}")
    return counts


def main(
    agents: Annotated[str, typer.Option(help="how many, as in 4 or 2-10")] = "2-10",
    instances: Annotated[int, typer.Option(help="of each number of agents", min=1)] = 20,
    model: Annotated[
        list[MotionModel] | None, typer.Option(help="plane, j2; both if left out")
    ] = None,
    workers: Annotated[int, typer.Option(help="processes", min=1)] = 2,
    guesses: Annotated[int, typer.Option(help="random ones, beyond four others", min=0)] = 3,
    orders: Annotated[int, typer.Option(help="of priority that a plan tries", min=1)] = 12,
    bargains: Annotated[int, typer.Option(help="sweeps in which pairs then bargain", min=0)] = 8,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    table: Annotated[
        Path | None,
        typer.Option("--csv", help="a file for a line an instance; what it has is not done again"),
    ] = None,
) -> None:
    """Compare; exit with 1 unless every median is as wanted."""
    if bargains and orders == 1:
        raise typer.BadParameter("bargains follow upon orders of 2 or more: --bargains 0 has none")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # of the workers: IPOPT's solver would take all cores
    cases = [
        PriceCase(kind, count, number, seed, guesses, orders, bargains)
        for kind in model or list(MotionModel)
        for count in _parse_range(agents)
        for number in range(instances)
    ]
    for kind, count in dict.fromkeys((case.model, case.agents) for case in cases):
        next(draw_missions(PriceCase(kind, count, 0, seed, guesses)))  # refuses what has no room
    rows = compute_results(cases, workers, table)
    out = Console(width=max(150, Console().width))
    out.print(instance_table(rows))
    lines, medians = summary_table(rows)
    out.print(lines)
    sys.exit(0 if all(median <= MAX_MEDIAN_RATIO for median in medians) else 1)


def compute_results(
    cases: list[PriceCase], workers: int, table: Path | None = None
) -> list[PriceResult]:
    """All instances, in their order, by several processes; what the table has is not done again."""
    found = {row.case: row for row in read_csv(table)} if table and table.exists() else {}
    left = [case for case in cases if case not in found]
    kinds = list(dict.fromkeys(case.model for case in left))
    with (
        ProcessPoolExecutor(workers, get_context("spawn"), warm_up, (kinds,)) as pool,
        Progress(console=Console(stderr=True)) as bar,
    ):
        task = bar.add_task("instances", total=len(cases), completed=len(cases) - len(left))
        for done in as_completed([pool.submit(compare_case, case) for case in left]):
            row = done.result()
            found[row.case] = row
            if table:
                write_csv(table, sorted(found.values(), key=lambda row: row.case))
            bar.advance(task)
    return [found[case] for case in sorted(cases)]


def write_csv(path: Path, rows: list[PriceResult]) -> None:
    """A line an instance, the whole file or none."""
    part = path.with_name(path.name + ".part")
    with part.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow([*PriceCase._fields, *PriceResult._fields[1:]])
        out.writerows([row.case.model.value, *row.case[1:], *row[1:]] for row in rows)
    part.replace(path)


def read_csv(path: Path) -> list[PriceResult]:
    """The lines of such a file."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [_parse_row(line) for line in csv.DictReader(file)]
    except (OSError, KeyError, ValueError) as error:
        raise typer.BadParameter(f"{path} holds no instances of this study: {error!r}") from None


def _parse_row(line: dict[str, str]) -> PriceResult:
    case = PriceCase(
        MotionModel(line["model"]), *(int(line[name]) for name in PriceCase._fields[1:])
    )
    words = ("from_guess", "gave_up")
    values: dict[str, Any] = {
        name: line[name] if name in words else float(line[name]) for name in PriceResult._fields[1:]
    }
    return PriceResult(case=case, **values | {"meetings": int(line["meetings"])})


def instance_table(rows: list[PriceResult]) -> Table:
    """A line an instance."""
    table = Table(
        "model", "N", "no.", "meet", "alone [m/s]", "best/alone", "one order/best", "SATO/best",
        "best from", "padding [R]", "CPU [s]", "SATO gave up",
    )  # fmt: skip
    for row in rows:
        table.add_row(
            row.case.model,
            str(row.case.agents),
            str(row.case.number),
            str(row.count_conflicts),
            f"{row.alone:.4f}",
            f"{row.central / row.alone:.4f}",
            f"{row.ratio_printed:.4f}",
            f"{row.ratio:.4f}",
            row.from_guess,
            f"{row.padding:.0e}",
            f"{row.planning:.2f} + {row.descending:.0f}",
            row.gave_up,
        )
    return table


def summary_table(rows: list[PriceResult]) -> tuple[Table, list[float]]:
    """A line a number of agents, and the median of each; NaN where no optimum was found."""
    table = Table(
        "model", "N", "one order/best: median", "worst", "gave up", "SATO/best: median", "worst",
        "gave up", "best/alone: median", "worst padding [R]", "no optimum",
    )  # fmt: skip
    medians = []
    for kind, count in dict.fromkeys((row.case.model, row.case.agents) for row in rows):
        those = [r for r in rows if (r.case.model, r.case.agents) == (kind, count)]
        found = [r for r in those if not np.isnan(r.central)]
        printed, ratios = [r.ratio_printed for r in found], [r.ratio for r in found]
        medians.append(_median(ratios))
        table.add_row(
            kind,
            str(count),
            f"{_median(printed):.4f}",
            f"{max(printed, default=np.nan):.4f}",
            f"{sum(np.isinf(r.printed) for r in those)} of {len(those)}",
            f"{medians[-1]:.4f}",
            f"{max(ratios, default=np.nan):.4f}",
            f"{sum(bool(r.gave_up) for r in those)} of {len(those)}",
            f"{_median([r.central / r.alone for r in found]):.4f}",
            f"{max((r.padding for r in found), default=np.nan):.0e}",
            f"{len(those) - len(found)} of {len(those)}",
        )
    return table, medians


def _median(of: list[float]) -> float:
    return float(np.median(of)) if of else np.nan


if __name__ == "__main__":
    typer.run(main)
