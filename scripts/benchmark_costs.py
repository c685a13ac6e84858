"""Speed and accuracy of the auction's costs, compared with HiGHS and Clarabel in one run.

HiGHS gives the reference. Clarabel is given every advantage: the states eliminated, one object
built once, only the right-hand side updated, presolve off; it works through the pairs one by
one, where all costs at once use all cores. Both take turns, so that whatever else the machine
does slows both; ratios are medians over the turns.
"""

import os
import subprocess
import sys
import tempfile
import time
from math import inf
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from scipy.sparse import csc_array, eye_array, vstack
from threadpoolctl import threadpool_limits
from written_tables import write_table

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems.auction_cost import TransferCosts, compute_displacements, compute_transfer_costs
from problems.conic import ConicProgram, Infeasible, solve
from problems.minimum_fuel import reachability_matrix
from problems.solvers import solve_highs
from problems.solvers.clarabel import ClarabelSession
from problems.transfer import TransferProblem

MAX_ERROR = 1e-6
TOLERANCE = 1e-7  # of Clarabel, which is asked for a tenth of it
MEAN_MOTION = np.sqrt(3.986004418e14 / 6878e3**3)  # circular orbit of 6878 km [rad/s]


class CostCase(NamedTuple):
    """Row of the table."""

    name: str
    steps: DiscreteModel
    start: np.ndarray
    targets: np.ndarray
    max_control: float
    min_speedup: float  # to reach
    turns: int

    def compute_costs(self) -> TransferCosts:
        """Compute the costs of all pairs."""
        transfer = TransferProblem(self.steps, self.max_control)
        return compute_transfer_costs(transfer, self.start, self.targets)


class CondensedForm:
    """min Σ|u| s.t. C u = b, |u| ≤ U, by u⁺ and u⁻ in units of U."""

    def __init__(self, case: CostCase) -> None:
        C = reachability_matrix(case.steps).reshape(case.start.shape[1], -1)
        self.cost_scale = np.abs(C).max(axis=1) * case.max_control
        C = C * case.max_control / self.cost_scale[:, None]
        N = 2 * C.shape[1]
        self.A = csc_array(vstack([np.hstack([C, -C]), eye_array(N), -eye_array(N)]))
        self.q = np.full(N, case.steps.dt * case.max_control)
        self.limits = np.concatenate([np.ones(N), np.zeros(N)])
        self.zero = len(C)
        self.b = compute_displacements(case.steps, case.start, case.targets)

    def problem(self, i: int, j: int) -> ConicProgram:
        """Return the conic program of a pair."""
        b = np.concatenate([self.b[i, j] / self.cost_scale, self.limits])
        return ConicProgram(self.q, self.A, b, self.zero, len(self.limits))


def draw_plane(agents: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw states at rest in a box and targets at rest in a disc."""
    rest = np.zeros((agents, 2))
    start, targets = rng.uniform(0, 29, (agents, 2)), rng.uniform(9, 20, (agents, 2))
    return np.hstack([start, rest]), np.hstack([targets, rest])


def draw_orbit(agents: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw states in a cloud and targets on a closed relative orbit, 1 km about the chief."""
    model, turn = ClohessyWiltshire(MEAN_MOTION), 2 * np.pi * np.arange(agents) / agents
    cloud = rng.uniform(-1500, 1500, (agents, 3))
    circle = [np.sin(turn) / 2, np.cos(turn), np.sqrt(3) / 2 * np.sin(turn)]
    along = [np.cos(turn) / 2, -np.sin(turn), np.sqrt(3) / 2 * np.cos(turn)]
    targets = 1000 * np.vstack([circle, MEAN_MOTION * np.array(along)]).T
    return np.hstack([cloud, model.bounded_velocity(cloud)]), targets


def make_cases(rng: np.random.Generator) -> list[CostCase]:
    """Build the rows."""
    long = discretize_zoh(DoubleIntegrator(2), 1.0, 80)
    sky = discretize_zoh(ClohessyWiltshire(MEAN_MOTION), 60.0, 24)
    still, cloud = draw_plane(123, rng), draw_orbit(48, rng)
    return [
        CostCase("123 × 123, double integrator", long, *still, 0.3, 100, 10),
        CostCase("48 × 48, Clohessy–Wiltshire", sky, *cloud, 0.01, 10, 10),
    ]


class CostBenchmark(NamedTuple):
    """Times and errors of one case."""

    seconds: float
    clarabel: float
    ratio: float
    error: float
    verified: str


def measure(case: CostCase, pairs: int, rng: np.random.Generator) -> CostBenchmark:
    """Time all solvers in turns, then compare their costs with the reference."""
    form = CondensedForm(case)
    session, costs = ClarabelSession(form.problem(0, 0), TOLERANCE), case.compute_costs()
    shape = costs.cost.shape
    ours, theirs = [], []
    each = max(1, pairs // case.turns)
    for _ in range(case.turns):
        began = time.perf_counter()
        case.compute_costs()
        ours.append(time.perf_counter() - began)
        problems = [form.problem(*rng.integers(shape)) for _ in range(each)]
        began = time.perf_counter()
        for problem in problems:
            session.solve(problem.b)
        theirs.append((time.perf_counter() - began) / each * costs.cost.size)
    checked = rng.integers(shape, size=(5 * pairs, 2))
    reference = [solve_with_highs(form.problem(*pair)) for pair in checked]
    error = largest_error(costs, checked, np.array(reference))
    within = int(np.isfinite(reference).sum())
    ratio = float(np.median(np.array(theirs) / np.array(ours)))
    description = f"HiGHS, {len(checked)} pairs, {within} in reach"
    return CostBenchmark(
        float(np.median(ours)), float(np.median(theirs)), ratio, error, description
    )


def solve_with_highs(problem: ConicProgram) -> float:
    """Return the reference cost, by HiGHS; infinite if infeasible."""
    try:
        return float(problem.q @ solve(problem, solve_highs).x)
    except Infeasible:
        return inf


def largest_error(costs: TransferCosts, pairs: np.ndarray, reference: np.ndarray) -> float:
    """Return the largest relative error; infinite where only one finds a pair reachable."""
    i, j = pairs.T
    fuel = np.where(costs.is_reachable[i, j], costs.cost[i, j], inf)
    if (np.isfinite(fuel) != np.isfinite(reference)).any():
        return inf
    fuel, reference = fuel[np.isfinite(reference)], reference[np.isfinite(reference)]
    return float((np.abs(fuel - reference) / np.maximum(reference, 1e-9)).max(initial=0.0))


COLD_START_CODE = """
import time, numpy as np
from dynamics import ClohessyWiltshire, discretize_zoh
from problems.auction_cost import compute_transfer_costs
from problems.transfer import TransferProblem
steps, x = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 24), np.zeros((48, 6))
began = time.process_time()
compute_transfer_costs(TransferProblem(steps, 0.01), x, x + 1.0)
print(time.process_time() - began)
"""


def time_first_call() -> tuple[float, float]:
    """Time the first costs in orbit of a process, without and with compiled code [s]."""
    with tempfile.TemporaryDirectory() as cache:
        env = os.environ | {"NUMBA_CACHE_DIR": cache}
        run = [sys.executable, "-c", COLD_START_CODE]
        cold, cached = (
            float(subprocess.run(run, env=env, check=True, capture_output=True, text=True).stdout)
            for _ in range(2)
        )
    return cold, cached


def main(
    pairs: Annotated[
        int, typer.Option(help="Pairs that Clarabel is timed on; 5 × are checked.")
    ] = 100,
    seed: int = 0,
    cold: Annotated[bool, typer.Option(help="Also time the first call of a process.")] = True,
    write: Annotated[bool, typer.Option("--write", help="Replace the table of the page.")] = False,
) -> None:
    """Print the table; exit 1 where a target is missed."""
    rng = np.random.default_rng(seed)
    table = Table("costs", "all [ms]", "Clarabel [s]", "ratio", "error", "reference")
    missed = False
    with threadpool_limits(1):
        for case in make_cases(rng):
            r = measure(case, pairs, rng)
            failed = not (r.error <= MAX_ERROR and r.ratio >= case.min_speedup)
            missed |= failed
            ratio = f"{r.ratio:.0f}" + (f" (≥ {case.min_speedup:.0f})" if case.min_speedup else "")
            numbers = (
                f"{r.seconds * 1e3:.1f}",
                f"{r.clarabel:.2f}",
                ratio,
            )
            style = "red" if failed else None
            table.add_row(case.name, *numbers, f"{r.error:.1e}", r.verified, style=style)
    Console(width=120).print(table)
    if write:
        write_table(table, "scripts/benchmark_costs.py")
    print(f"all costs on {os.cpu_count()} threads, Clarabel on one")
    if cold:
        nothing, cached = time_first_call()
        print(f"first call of a process: {nothing:.1f} s to compile, {cached:.2f} s from the cache")
    raise typer.Exit(int(missed))


if __name__ == "__main__":
    typer.run(main)
