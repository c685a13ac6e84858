"""Price of decentralization: python scripts/price_of_decentralization.py --agents 2-10.

Vehicles exchange places through one point, each with its target: across a circle in the plane,
with the limits of the scenario `crossing`, or across a sphere about a chief in orbit, with those of
`orbit3d`. Instances are drawn until at least as many pairs as half the vehicles would conflict if
each flew alone. For every instance the fuel of three is compared: one plan of the swarm (all hear
each other), the best optimum of the coupled program, and all alone. The plan is made with one order
of priority, which is by number, and with several, bargains and roundabouts. All use the same linear
model; an infinite ratio means that SATO gave up a target or a distance. The exit code is 1 where a
median exceeds 1.05.
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
    NoFeasibleSolution,
    SimulatedSolution,
)
from problems.centralized_nlp import InitialGuess
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import plan_trajectories
from sato.reconfiguration.state import AgentMemory, DecisionContext

MAX_MEDIAN_RATIO = 1.05  # largest median of SATO's fuel over that of the best optimum
COLUMNS = (
    "model, N", "best / alone", "from SATO", "one order / best", "gave up", "SATO / best", "worst",
    "gave up", "most padding [R]", "no optimum",
)  # fmt: skip


class PriceResult(NamedTuple):
    """Result of an instance."""

    case: PriceCase
    meetings: int  # pairs that would conflict if each flew alone
    alone: float  # fuel [m/s]
    central: float  # fuel of the best optimum [m/s]; NaN where none was found
    from_guess: str  # initial guess of that optimum
    padding: float  # largest distance beyond R that it had to keep, in units of R
    printed: float  # fuel with one order of priority; infinite where something was given up [m/s]
    sato: float  # fuel with several orders, bargains and roundabouts, likewise
    gave_up: str  # constraints that SATO gave up then, if any
    planning: float  # processor time with several orders [s]
    descending: float  # processor time of the optima from all guesses [s]

    @property
    def ratio(self) -> float:
        """Fuel of SATO over the best optimum; NaN where none was found."""
        return self.sato / self.central

    @property
    def ratio_printed(self) -> float:
        """Ratio with one order of priority."""
        return self.printed / self.central


def plan_swarm(mission: Reconfiguration) -> tuple[InitialGuess, str]:
    """Plan once for the swarm, with messages among all; also return what was given up."""
    N, d = len(mission.initial_states), mission.linear_model.axes
    network = CommunicationGraph.from_positions(
        mission.initial_states[:, :d], mission.comm_radius, mission.alive
    )
    memory = replace(AgentMemory.initial(np.full(N, N)), target_index=np.arange(N))
    leg, x = mission.legs[0], mission.initial_states
    context = DecisionContext(mission, leg, network, x, memory, 0, 0.0)
    plans, events = plan_trajectories(context, np.zeros(N), {})
    flights = [plans[i].trajectory for i in range(N)]
    gave_up = ", ".join(sorted({event["kind"] for event in events} - {"replan"}))
    return (np.stack([f.x for f in flights]), np.stack([f.u for f in flights])), gave_up


def compare_case(case: PriceCase) -> PriceResult:
    """Compare plan and optima of an instance."""
    mission, central, free, meetings = make_instance(case)
    start, target = mission.initial_states, mission.legs[0].targets
    with_orders = replace(mission, orders=case.orders, bargains=case.bargains)
    planned, own, gave_up, planning = plan_and_verify(central, with_orders)
    _, once, gave_up_once, _ = plan_and_verify(central, mission)
    begin = {"SATO": planned} | initial_guesses(case, free, mission.collision_radius, mission.step)
    lower = central.simulate(start, target, free[1], "alone").cost
    fuel, origin, padding = np.nan, "none", np.nan
    begun = process_time()
    try:
        best, tried = central.solve(start, target, list(begin.values()))
        fuel, origin, padding = best.cost, _guess_name(best, tried, list(begin)), best.padding
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
        np.inf if gave_up_once else once.cost,
        np.inf if gave_up else own.cost,
        gave_up,
        planning,
        descending,
    )


def plan_and_verify(
    central: CentralizedProblem, mission: Reconfiguration
) -> tuple[InitialGuess, SimulatedSolution, str, float]:
    """Return a plan of the swarm, its verified simulation, what it gave up, and its time."""
    begun = process_time()
    planned, gave_up = plan_swarm(mission)
    took = process_time() - begun
    own = central.simulate(mission.initial_states, mission.legs[0].targets, planned[1], "SATO")
    if not gave_up and not own.is_feasible:
        gave_up = f"does not stand: {own}"
    return planned, own, gave_up, took


def warm_up(kinds: list[MotionModel]) -> None:
    """Import and compile in a process, so that no time of an instance includes it."""
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
        raise typer.BadParameter(f"--agents takes a number or two, as in 4 or 2-10, got {text!r}")
    counts = list(range(int(first), int(last or first) + 1))
    if not counts or counts[0] < 2:
        raise typer.BadParameter(
            f"--agents takes 2 or more, and the larger number is last, got {text!r}"
        )
    return counts


def main(
    agents: Annotated[str, typer.Option(help="number of vehicles, as in 4 or 2-10")] = "2-10",
    instances: Annotated[
        int, typer.Option(help="instances for each number of vehicles", min=1)
    ] = 20,
    model: Annotated[
        list[MotionModel] | None, typer.Option(help="plane, j2; both if left out")
    ] = None,
    workers: Annotated[int, typer.Option(help="processes", min=1)] = 2,
    guesses: Annotated[
        int, typer.Option(help="random initial guesses, besides four others", min=0)
    ] = 3,
    orders: Annotated[int, typer.Option(help="orders of priority that a plan tries", min=1)] = 12,
    bargains: Annotated[int, typer.Option(help="sweeps of bargains between pairs", min=0)] = 8,
    seed: Annotated[int, typer.Option(min=0)] = 0,
    table: Annotated[
        Path | None,
        typer.Option("--csv", help="table of instances; those that it has are not solved again"),
    ] = None,
) -> None:
    """Compare; exit with 1 where a median is too large."""
    if bargains and orders == 1:
        raise typer.BadParameter("bargains need --orders of 2 or more; --bargains 0 has none")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[name] = "1"  # for the workers: IPOPT's linear solver would use all cores
    cases = [
        PriceCase(kind, count, number, seed, guesses, orders, bargains)
        for kind in model or list(MotionModel)
        for count in _parse_range(agents)
        for number in range(instances)
    ]
    for kind, count in dict.fromkeys((case.model, case.agents) for case in cases):
        next(
            draw_missions(PriceCase(kind, count, 0, seed, guesses))
        )  # refuses a number of vehicles without room
    rows = compute_results(cases, workers, table)
    out = Console(width=max(150, Console().width))
    out.print(instance_table(rows))
    lines, medians = summary_table(rows)
    out.print(lines)
    sys.exit(0 if all(median <= MAX_MEDIAN_RATIO for median in medians) else 1)


def compute_results(
    cases: list[PriceCase], workers: int, table: Path | None = None
) -> list[PriceResult]:
    """Solve all instances that the table does not have, in several processes; keep their order."""
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
    """Write a row for each instance, the whole file or none."""
    part = path.with_name(path.name + ".part")
    with part.open("w", newline="") as file:
        out = csv.writer(file)
        out.writerow([*PriceCase._fields, *PriceResult._fields[1:]])
        out.writerows([row.case.model.value, *row.case[1:], *row[1:]] for row in rows)
    part.replace(path)


def read_csv(path: Path) -> list[PriceResult]:
    """Read the rows of a table of instances."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [_parse_row(line) for line in csv.DictReader(file)]
    except (OSError, KeyError, ValueError) as error:
        raise typer.BadParameter(f"{path} is not a table of instances: {error!r}") from None


def _parse_row(line: dict[str, str]) -> PriceResult:
    case = PriceCase(
        MotionModel(line["model"]), *(int(line[name]) for name in PriceCase._fields[1:])
    )
    texts = ("from_guess", "gave_up")
    values: dict[str, Any] = {
        name: line[name] if name in texts else float(line[name]) for name in PriceResult._fields[1:]
    }
    return PriceResult(case=case, **values | {"meetings": int(line["meetings"])})


def instance_table(rows: list[PriceResult]) -> Table:
    """Make a row for each instance."""
    table = Table(
        "model", "N", "no.", "meet", "alone [m/s]", "best/alone", "one order/best", "SATO/best",
        "best from", "padding [R]", "CPU [s]", "SATO gave up",
    )  # fmt: skip
    for row in rows:
        table.add_row(
            row.case.model,
            str(row.case.agents),
            str(row.case.number),
            str(row.meetings),
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
    """Make a row for each number of vehicles; also return the median ratio of each."""
    table, medians = Table(*COLUMNS), []
    for name, group in group_by_size(rows).items():
        table.add_row(name, *summary_cells(group))
        medians.append(_median([row.ratio for row in group if not np.isnan(row.central)]))
    return table, medians


def group_by_size(rows: list[PriceResult]) -> dict[str, list[PriceResult]]:
    """Group rows by model and number of vehicles, in the order in which they come."""
    groups: dict[str, list[PriceResult]] = {}
    for row in rows:
        groups.setdefault(f"{row.case.model} {row.case.agents}", []).append(row)
    return groups


def summary_cells(rows: list[PriceResult]) -> list[str]:
    """Format the cells of one number of vehicles."""
    found = [row for row in rows if not np.isnan(row.central)]
    printed, ratios = [row.ratio_printed for row in found], [row.ratio for row in found]
    return [
        f"{_median([row.central / row.alone for row in found]):.3f}",
        str(sum(row.from_guess.startswith("SATO") for row in found)),
        format_ratio(_median(printed), 4),
        f"{sum(np.isinf(row.printed) for row in rows)} of {len(rows)}",
        format_ratio(_median(ratios), 4),
        format_ratio(max(ratios, default=np.nan), 4),
        f"{sum(np.isinf(row.sato) for row in rows)} of {len(rows)}",
        f"{max((row.padding for row in found), default=np.nan):.0e}",
        f"{len(rows) - len(found)} of {len(rows)}",
    ]


def format_ratio(ratio: float, digits: int = 3) -> str:
    """Format a ratio, or "gave up" where it is infinite and "none" where there is no optimum."""
    return "gave up" if np.isinf(ratio) else "none" if np.isnan(ratio) else f"{ratio:.{digits}f}"


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else np.nan


if __name__ == "__main__":
    typer.run(main)
