"""Onboard code compared with Python on random problems: cost, residuals and time per solve.

    python scripts/study_onboard.py [scenario ...]

Prints what stands in docs/onboard.md.
"""

import tempfile
from pathlib import Path
from time import thread_time
from typing import Annotated

import numpy as np
import typer
from onboard_library import SOLVED, CompiledSolver, random_instances

from problems.avoidance import AvoidanceProblem
from sato.onboard import export_c

INSTANCE_COUNT = 1000
SIZES = {"uiuc": (5, 40), "random3d": (3, 20), "crossing": (1, 36)}  # neighbors, steps


def study_scenario(scenario: str, neighbors: int, steps: int) -> None:
    """Export and compile the code, solve with both, and print a row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        problem = export_c(scenario, Path(folder, "c"), neighbors, steps)
        code = CompiledSolver(Path(folder, "c"))
    transfer = problem.program.transfer
    dt = transfer.model.dt
    codes, cost, residual, times, active = [], [], [], [], 0
    instances = random_instances(problem, np.random.default_rng(2016))
    for instance, _ in zip(instances, range(INSTANCE_COUNT), strict=False):
        began = thread_time()
        trajectory = AvoidanceProblem(transfer, *instance).solve().trajectory
        python = thread_time() - began
        began = thread_time()
        flown = code.solve(*instance)
        times.append((thread_time() - began, python))
        least = dt * float(transfer.weights @ np.abs(trajectory.u).sum(axis=1))
        codes.append(flown.code)
        cost.append(abs(flown.cost - least) / max(least, transfer.max_control * dt))
        residual.append(flown.residual)
        active += bool((instance[2].violation(trajectory.x, trajectory.u) > -1e-6).any())
    in_c, python = 1e3 * np.median(times, axis=0)
    slowest = 1e3 * np.max(times, axis=0)[0]
    print(
        f"{scenario}, {neighbors} neighbors, {steps} steps: "
        f"{codes.count(SOLVED)} of {INSTANCE_COUNT} solved, {active} with a half-space that binds; "
        f"cost differs by {np.median(cost):.1e} (median), {max(cost):.1e} (most); "
        f"residual at most {max(residual):.1e}; "
        f"C {in_c:.2f} ms (most {slowest:.1f}), Python {python:.1f} ms, of the processor"
    )


def main(
    scenarios: Annotated[list[str] | None, typer.Argument(help="all if left out")] = None,
) -> None:
    """Print a row of the table for each scenario."""
    for name in scenarios or []:
        if name not in SIZES:
            raise typer.BadParameter(f"no scenario {name!r}, only {', '.join(SIZES)}")
    for name in scenarios or SIZES:
        study_scenario(name, *SIZES[name])


if __name__ == "__main__":
    typer.run(main)
