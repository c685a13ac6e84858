"""Report of a comparison: tables for the terminal, files, and guarantees that it must keep."""

import csv
import json
import os
import platform
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.table import Column, Table

from problems.conic import TOLERANCE
from problems.solvers import DEFAULT_SOLVER
from problems.solvers.adapter import SolverAdapter
from sato.atomic import replace_atomically
from sato.compare.measure import Measurement, SolveOutcome, measure_solvers
from sato.compare.plan import ALL_TAKES, DEFAULT_SIZES, ComparisonPlan, format_tolerance
from sato.console import TextConsole, progress_bar

MISSING = "–"
PIPE_WIDTH = 140
FILES = ("accuracy.png", "machine.json", "measurements.csv", "profile.png")


def run_comparison(plan: ComparisonPlan, folder: Path, seed: int) -> list[str]:
    """Compare solvers, print the tables, write everything into a folder, and return violations."""
    machine, console = describe_machine(plan.solvers), TextConsole(highlight=False)
    if not console.is_terminal:
        console.width = PIPE_WIDTH  # a file or a pipe has no width to which tables must be fitted
    processor = f"{machine['processor']}, {machine['cores']} cores"
    console.print(f"{processor}, one thread for each solver, Python {machine['python']}")
    console.print(", ".join(f"{name} {number}" for name, number in machine["versions"].items()))
    for reason in plan.exclusions:
        console.print(f"left out: {reason}")
    with progress_bar("solving") as progress:
        measurements = measure_solvers(plan, np.random.default_rng(seed), progress)
    paths = write_comparison(measurements, machine, folder)
    print_comparison(plan, measurements, console)
    if not {family.size for family in plan.families} > set(DEFAULT_SIZES):
        console.print(f"{ALL_TAKES}.")
    console.print(*paths, sep="\n", soft_wrap=True)
    return find_violations(measurements)


def describe_machine(solvers: Iterable[SolverAdapter]) -> dict[str, Any]:
    """Return processor, cores, and versions; nothing that identifies the owner."""
    versions = {}
    required = {name for solver in solvers for name in solver.pip_packages.split()}
    for name in sorted({"sato-swarm", "numpy", "scipy"} | required):
        with suppress(PackageNotFoundError):  # run from a folder without being installed
            versions[name] = version(name)
    processor = platform.processor() or platform.machine()
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                processor = line.partition(":")[2].strip()
    python = platform.python_version()
    return {"processor": processor, "cores": os.cpu_count(), "python": python, "versions": versions}


def write_comparison(
    measurements: Sequence[Measurement], machine: dict[str, Any], folder: Path
) -> list[Path]:
    """Write all files of a comparison, or none; those of an earlier comparison are replaced."""
    from sato.compare.figures import draw_comparison

    rows = [
        {"solver": m.solver, "family": m.family.name, "size": m.family.size}
        | {"instance": m.instance.name, "feasible": m.instance.is_feasible}
        | {"tolerance": m.tolerance, "solve": solve, **outcome._asdict()}
        for m in measurements
        for solve, outcome in zip(("first", "second"), m.outcomes, strict=False)
    ]
    paths = [folder / name for name in FILES]
    with ExitStack() as stack:
        new = [stack.enter_context(replace_atomically(path)) for path in paths]
        accuracy, description, table, profile = new
        description.write_text(json.dumps(machine, indent=2) + "\n", "utf-8")
        with open(table, "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0])
            writer.writeheader()
            writer.writerows(rows)
        draw_comparison(measurements, profile, accuracy)
    return paths


def print_comparison(
    plan: ComparisonPlan, measurements: Sequence[Measurement], console: TextConsole
) -> None:
    """Print a table for each family."""
    at = min((t for t in plan.tolerances if t >= TOLERANCE), default=plan.tolerances[0])
    for family in dict.fromkeys(family.name for family in plan.families):
        some = [m for m in measurements if m.family.name == family]
        sizes = " / ".join(dict.fromkeys(m.family.size for m in some))
        solvers = dict.fromkeys(m.solver for m in some)
        rows = {name: summarize([m for m in some if m.solver == name], at) for name in solvers}
        columns = [Column(header, justify="right") for header in next(iter(rows.values()), ())]
        table = Table("solver", *columns, title=f"{family} ({sizes})", title_justify="left")
        for solver, cells in rows.items():
            table.add_row(solver, *cells.values())
        console.print(table)
        if absent := [solver.name for solver in plan.solvers if solver.name not in rows]:
            console.print(f"  cannot take it: {', '.join(absent)}")
        for line in list_failures(some):
            console.print(f"  {line}")
    shown = "Times (of the processor), iterations and the largest error of the cost"
    console.print(f"{shown} are of correct answers at {format_tolerance(at)}, from small to large.")


def summarize(measurements: Sequence[Measurement], tolerance: float) -> dict[str, str]:
    """Summarize the measurements of a solver in the cells of a table, by their headers.

    They are its correct answers at each tolerance, the loosest first; the numbers of wrong claims
    and of unsolved problems; and, at one tolerance, medians over correct answers of each size of
    times and iterations, and the largest error of the cost.
    """
    cells = {}
    for each in dict.fromkeys(m.tolerance for m in measurements):
        given = [m.is_correct for m in measurements if m.tolerance == each]
        cells[f"right\n{format_tolerance(each)}"] = f"{sum(given)}/{len(given)}"
    sizes = dict.fromkeys(m.family.size for m in measurements)
    correct = [m for m in measurements if m.tolerance == tolerance and m.is_correct]
    by_size = [[m.outcomes for m in correct if m.family.size == size] for size in sizes]
    first = [[outcomes[0] for outcomes in group] for group in by_size]
    second = [[outcomes[1] for outcomes in group if len(outcomes) > 1] for group in by_size]
    errors = [m.outcomes[0].cost_error for m in correct if m.instance.is_feasible]
    verdicts = [outcome.verdict for m in measurements for outcome in m.outcomes]
    right = verdicts.count("solved") + verdicts.count("infeasible")
    wrong = verdicts.count("wrong claim")
    return cells | {
        "wrong\nclaims": str(wrong),
        "not\nsolved": str(len(verdicts) - right - wrong),
        "first\nms": _medians([1e3 * solve.seconds for solve in group] for group in first),
        "re-solve\nms": _medians([1e3 * solve.seconds for solve in group] for group in second),
        "iterations\n": _medians([solve.iterations for solve in group] for group in first),
        "cost\nerror": f"{max(errors):.0e}" if errors else MISSING,
    }


def _medians(groups: Iterable[Iterable[float | None]]) -> str:
    known = [[number for number in group if number is not None] for group in groups]
    # Three digits, without an exponent.
    return "/".join(f"{float(f'{median(g):.3g}'):.12g}" if g else MISSING for g in known)


def list_failures(measurements: Iterable[Measurement]) -> list[str]:
    """List each verdict of a solver once, with the first example."""
    failures: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for m in measurements:
        for outcome in m.outcomes:
            if outcome.verdict not in ("solved", "infeasible"):
                example = f"{m.instance.name} at {format_tolerance(m.tolerance)}: {outcome.reason}"
                failures[m.solver, outcome.verdict].append(example)
    return [
        f"{solver}: {verdict} ({len(examples)}), {examples[0]}"
        for (solver, verdict), examples in failures.items()
    ]


def find_violations(measurements: Iterable[Measurement]) -> list[str]:
    """List violations of what the toolkit guarantees of every comparison.

    Its default solver is correct on every instance at 1e-6 and looser; no accepted answer
    violates the requested tolerance, nor in its cost what duality allows; and no answer is
    accepted that contradicts what is known of an instance.
    """
    violations = []
    for m in measurements:
        is_guaranteed = m.solver == DEFAULT_SOLVER and m.tolerance >= TOLERANCE
        for outcome in m.outcomes:
            if is_guaranteed or outcome.verdict in ("solved", "infeasible"):
                where = f"{m.solver} on {m.instance.name} at {format_tolerance(m.tolerance)}"
                violations += [f"{where}: {text}" for text in _doubts(m, outcome)]
    return violations


def _doubts(m: Measurement, outcome: SolveOutcome) -> Iterator[str]:
    if outcome.verdict != m.expected:
        yield f"{outcome.verdict} ({outcome.reason}), but known to be {m.expected}"
    elif m.instance.is_feasible:
        residual = np.max([outcome.primal_residual, outcome.dual_residual, outcome.gap])
        if not residual <= m.tolerance:
            yield f"accepted, but off by {residual:.1e}"
        error = outcome.cost_error * m.instance.cost_scale
        allowed = m.instance.cost_tolerance(m.tolerance)
        if not error <= allowed:
            yield f"accepted, but its cost is off by {error:.1e}, above {allowed:.1e}"
