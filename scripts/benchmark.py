"""Time and memory of whole reconfigurations by their parts, from 30 to 3,000 vehicles.

Each size flies the scenario `random` in a process of its own: vehicles at random places take up a
lattice, in a box that grows with their number. Beside it stands the loop that a user would write:
one CVXPY model of a transfer, compiled once, for each agent and decision, and SciPy's assignment,
with the prices of all pairs or with distances. It is timed on a sample of the same programs, on one
thread, and extrapolated. With `--cold` commands of the README are run twice instead, the first time
with an empty cache of compiled code.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from time import perf_counter, process_time
from typing import Annotated, Any

import cvxpy as cp
import numpy as np
import typer
from benchmark_transfer import CvxpyStatement
from rich.console import Console
from rich.table import Table
from scipy.optimize import linear_sum_assignment
from threadpoolctl import threadpool_limits
from written_tables import write_table

import sato
from dynamics import discretize_zoh
from problems.transfer import TransferProblem
from sato import runs
from sato.reconfiguration import assignment, draw, loop, planning, reach

STEPS = {30: 40, 123: 40, 300: 40, 1000: 60, 3000: 120}  # in which all can arrive
PARTS = "feasibility", "prices", "auction", "trajectories", "check", "whole"
COMPARED = 123  # vehicles of the swarm for which the plain loop is timed
COMMANDS = "crossing", "formation", "connectivity", "orbit", "uiuc", "formation100"
SAMPLE = 20  # programs of the plain loop that are solved


class Stopwatch:
    """Processor time of functions, by the name of a part."""

    def __init__(self) -> None:
        self.seconds = dict.fromkeys(PARTS, 0.0)

    def watch(self, owner: Any, name: str, part: str) -> None:
        """Add the time of a function of a module or class to a part."""
        setattr(owner, name, self.add_time(getattr(owner, name), part))

    def add_time(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        """Return a function that adds its time to a part."""

        def timed(*args: Any, **options: Any) -> Any:
            begin = process_time()
            try:
                return function(*args, **options)
            finally:
                self.seconds[part] += process_time() - begin

        return timed


def fly(agents: int) -> dict[str, float]:
    """Fly the mission of so many vehicles in this process, and return times and memory."""
    sato.run("random", overrides=["agents=5"])  # compiles
    clock = Stopwatch()
    clock.watch(reach, "check_reach", "feasibility")
    clock.watch(draw.first_commitment, "check_reach", "feasibility")
    clock.watch(assignment, "compute_costs", "prices")
    clock.watch(assignment, "forecast_opening", "auction")
    assignment.METHODS["auction"] = clock.add_time(assignment.METHODS["auction"], "auction")
    clock.watch(planning, "plan_trajectories", "trajectories")
    clock.watch(loop, "commit", "trajectories")
    clock.watch(runs.Run, "check", "check")
    clock.watch(sato, "run", "whole")
    flown = sato.run("random", overrides=[f"agents={agents}", f"leg.steps={STEPS[agents]}"])
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    reached = float(flown.summary["reached"] and flown.summary["success"])
    return clock.seconds | {"memory": memory, "reached": reached}


def time_plain_loop(agents: int) -> tuple[float, float]:
    """Return the time of the plain loop for a whole leg, with prices of all pairs and without."""
    rng = np.random.default_rng(0)
    mission = sato.read("random", [f"agents={agents}", f"leg.steps={STEPS[agents]}"]).draw(rng)
    steps, targets = mission.legs[0].steps, mission.legs[0].targets
    seconds = {}
    for left in (steps, steps // 2, 1):  # programs get shorter with the steps that are left
        model = discretize_zoh(mission.linear_model, mission.step, left)
        transfer = TransferProblem(model, mission.max_control, mission.max_speed)
        stated = CvxpyStatement(transfer, np.zeros(0, dtype=int))
        pairs = rng.integers(0, agents, (SAMPLE + 1, 2))
        for sample, (i, j) in enumerate(pairs):
            if sample == 1:  # the first call compiles
                begin = perf_counter()
            stated.start.value, stated.goal.value = mission.initial_states[i], targets[j]
            stated.problem.solve(solver=cp.CLARABEL)
        seconds[left] = (perf_counter() - begin) / SAMPLE
    begin = perf_counter()
    linear_sum_assignment(np.linalg.norm(mission.initial_states[:, None] - targets, axis=2))
    assigning = perf_counter() - begin
    each = np.interp(
        np.arange(1, steps + 1), sorted(seconds), [seconds[k] for k in sorted(seconds)]
    )
    loop_seconds = agents * float(each.sum()) + steps * assigning
    return loop_seconds + agents**2 * seconds[steps], loop_seconds


def time_commands(console: Console) -> Table:
    """Return the processor time of a first and of a second call of commands."""
    table = Table("`sato run …`", "first call [s]", "second call [s]", "difference [s]")
    for name in COMMANDS:
        with tempfile.TemporaryDirectory() as cache:
            seconds = []
            for call in ("first", "second"):
                console.print(f"sato run {name}, {call} call …")
                before = os.times()
                command = [sys.executable, "-m", "sato", "run", name, "--out", f"{cache}/{call}"]
                environment = os.environ | {"NUMBA_CACHE_DIR": cache}
                subprocess.run(command, env=environment, capture_output=True, check=False)
                after = os.times()
                spent = (after.children_user, after.children_system)
                seconds.append(sum(spent) - before.children_user - before.children_system)
        table.add_row(f"`{name}`", *(f"{s:.1f}" for s in (*seconds, seconds[0] - seconds[1])))
    return table


def main(
    sizes: Annotated[list[int] | None, typer.Argument(help="Numbers of vehicles.")] = None,
    one: Annotated[int, typer.Option(hidden=True)] = 0,
    plain: Annotated[bool, typer.Option(help="Time the plain loop too.")] = True,
    cold: Annotated[bool, typer.Option("--cold", help="Time commands instead.")] = False,
    write: Annotated[bool, typer.Option("--write", help="Replace the table of the page.")] = False,
    note: Annotated[str, typer.Option(help="Circumstances, such as other work.")] = "",
) -> None:
    """Print the table."""
    if one:
        with threadpool_limits(1):
            print(json.dumps(fly(one)))
        return
    console, rows = Console(width=120), {}
    if cold:
        table = time_commands(console)
        console.print(table)
        if write:
            write_table(table, "scripts/benchmark.py --cold", note=note)
        return
    table = Table(
        "vehicles", "steps", *(f"{part} [s]" for part in PARTS), "memory [GiB]", "reached"
    )
    for agents in sizes or list(STEPS):
        console.print(f"{agents} vehicles, {STEPS[agents]} steps …")
        command = [sys.executable, __file__, "--one", str(agents)]
        found = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        rows[agents] = row = json.loads(found.stdout.splitlines()[-1])
        numbers = (f"{row[part]:.3g}" for part in (*PARTS, "memory"))
        table.add_row(str(agents), str(STEPS[agents]), *numbers, "yes" if row["reached"] else "NO")
    if len(rows) > 1:
        few, many = 300 if 300 in rows else min(rows), max(rows)
        ratios = (rows[many][part] / rows[few][part] for part in (*PARTS, "memory"))
        powers = (f"{np.log(ratio) / np.log(many / few):.2f}" for ratio in ratios)
        table.add_row(f"power, from {few}", "", *powers, "")
    console.print(table)
    if write:
        write_table(table, "scripts/benchmark.py", note=note)
    if plain:
        own = rows.get(COMPARED) or fly(COMPARED)
        with threadpool_limits(1):
            priced, unpriced = time_plain_loop(COMPARED)
        less = own["whole"] - own["prices"]
        for name, long, short in (("with", priced, own["whole"]), ("without", unpriced, less)):
            console.print(
                f"plain loop {name} prices: {long:.0f} s, {long / short:.0f} times as long"
            )
    if not all(row["reached"] for row in rows.values()):
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
