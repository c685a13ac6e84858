"""Report of a comparison: tables for the terminal, and files."""

import csv
import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from sato.compare.machine import describe_machine
from sato.compare.measure import Measurement, measure_solvers
from sato.compare.plan import ComparisonPlan, format_tolerance
from sato.compare.summary import (
    find_violations,
    reference_tolerance,
    sizes_present,
    tolerances_present,
)
from sato.compare.worker import SolveOutcome
from sato.console import progress_bar

MISSING = "–"
PIPE_WIDTH = 140
MEASUREMENTS_FILE, MACHINE_FILE = "measurements.csv", "machine.json"
HEADERS = (
    "wrong\nclaims", "not\nsolved", "first\nms", "re-solve\nms", "iterations\n", "cost\nerror",
    "memory\nMiB",
)  # fmt: skip
OUTCOME_COLUMNS = ("verdict", "why", "s", *SolveOutcome._fields[3:])
COLUMNS = (
    *("solver", "family", "size", "instance", "tolerance", "feasible", "right"),
    *(f"{solve}_{name}" for solve in ("first", "again") for name in OUTCOME_COLUMNS),
    "memory_mib",
)


def run_comparison(plan: ComparisonPlan, folder: Path, seed: int) -> list[str]:
    """Compare solvers, print the tables, and write everything into a folder.

    Returns:
        Guarantees of the toolkit that the comparison violates.
    """
    machine = describe_machine(plan.solvers)
    print_plan(plan, machine)
    with progress_bar("solving") as progress:
        measurements = measure_solvers(plan, np.random.default_rng(seed), progress)
    files = write_comparison(measurements, machine, folder)
    print_comparison(plan, measurements)
    for path in files:
        print(path)
    return find_violations(measurements)


def print_plan(plan: ComparisonPlan, machine: Mapping[str, Any]) -> None:
    """Print the machine, and the solvers that are left out."""
    console = _make_console()
    console.print(
        f"{machine['processor']}, {machine['cores']} cores, one thread for each solver, "
        f"Python {machine['python']}",
        markup=False,
    )
    console.print(", ".join(f"{name} {number}" for name, number in machine["versions"].items()))
    for reason in plan.exclusions:
        console.print(f"left out: {reason}", markup=False)


def print_comparison(plan: ComparisonPlan, measurements: Sequence[Measurement]) -> None:
    """Print a table for each family."""
    console, at = _make_console(), reference_tolerance(plan.tolerances)
    for name in dict.fromkeys(m.family for m in measurements):
        some = [m for m in measurements if m.family == name]
        solvers = list(dict.fromkeys(m.solver for m in some))
        title = f"{name} ({' / '.join(sizes_present(some))})"
        table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
        table.add_column("solver", no_wrap=True)
        shares = [f"right\n{format_tolerance(t)}" for t in tolerances_present(some)]
        for header in (*shares, *HEADERS):
            table.add_column(header, justify="right", overflow="fold")
        for solver in solvers:
            table.add_row(solver, *summarize([m for m in some if m.solver == solver], at))
        console.print(table)
        if absent := [s.name for s in plan.solvers if s.name not in solvers]:
            console.print(f"  cannot take it: {', '.join(absent)}")
        for line in list_failures(some):
            console.print(f"  {line}", markup=False)
    console.print(
        f"Times, iterations and the largest error of the cost are those of correct answers at "
        f"{format_tolerance(at)}, from small to large. Times are processor times; memory is that "
        "of the largest size. Not solved: failed, crashed, skipped, or infeasible without a proof."
    )


def summarize(measurements: Sequence[Measurement], tolerance: float) -> list[str]:
    """Summarize the measurements of a solver in the cells of a table.

    They are its correct answers at each tolerance, the loosest first; the numbers of wrong claims
    and of unsolved problems; medians over correct answers of each size of times and iterations;
    the largest error of the cost; and the memory at the largest size.

    Args:
        measurements: Measurements of the solver in a family.
        tolerance: Tolerance at which times, iterations and the error are taken.
    """
    shares = []
    for each in tolerances_present(measurements):
        given = [m.is_correct for m in measurements if m.tolerance == each]
        shares.append(f"{sum(given)}/{len(given)}")
    sizes = sizes_present(measurements)
    correct = [m for m in measurements if m.tolerance == tolerance and m.is_correct]
    by_size = [[m for m in correct if m.size == size] for size in sizes]
    first = [_median(m.first.seconds for m in group) for group in by_size]
    second = [_median(m.second.seconds for m in group if m.second) for group in by_size]
    iterations = [_median(m.first.iterations for m in group) for group in by_size]
    errors = [m.first.cost_error for m in correct if m.instance.is_feasible]
    growth = [m.memory_growth for m in measurements if m.size == sizes[-1]]
    memory = max((mebibytes for mebibytes in growth if mebibytes == mebibytes), default=None)
    verdicts = Counter(outcome.verdict for m in measurements for outcome in m.outcomes)
    wrong = verdicts["wrong claim"]
    unsolved = [verdicts[verdict] for verdict in ("failed", "unproven", "crashed", "skipped")]
    return [
        *shares,
        f"[bold red]{wrong}[/]" if wrong else "0",
        str(sum(unsolved)),
        _format_milliseconds(first),
        _format_milliseconds(second),
        "/".join(MISSING if n is None else f"{n:.0f}" for n in iterations),
        f"{max(errors):.0e}" if errors else MISSING,
        MISSING if memory is None else f"{memory:.1f}",
    ]


def list_failures(measurements: Sequence[Measurement]) -> list[str]:
    """List each verdict of a solver in a family once, with the first example."""
    failures: dict[tuple[str, str, str], list[str]] = {}
    for m in measurements:
        for outcome in m.outcomes:
            if outcome.verdict not in ("solved", "infeasible"):
                example = f"{m.instance.name} at {format_tolerance(m.tolerance)}: {outcome.reason}"
                failures.setdefault((m.solver, m.family, outcome.verdict), []).append(example)
    return [
        f"{solver}: {verdict}{f' {len(examples)} times' if len(examples) > 1 else ''}, "
        f"{examples[0]}"
        for (solver, _, verdict), examples in failures.items()
    ]


def write_comparison(
    measurements: Sequence[Measurement], machine: Mapping[str, Any], folder: Path
) -> list[Path]:
    """Write all files of a comparison, or none.

    Args:
        measurements: All measurements.
        machine: The machine that they were taken on.
        folder: Folder, which is created if missing; files of an earlier comparison are replaced.

    Returns:
        The files.
    """
    from sato.compare.figures import draw_comparison

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".saving-", dir=folder) as name:
        tmp_dir = Path(name)
        with open(tmp_dir / MEASUREMENTS_FILE, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows(map(_row, measurements))
        machine_text = json.dumps(machine, indent=2, ensure_ascii=False) + "\n"
        (tmp_dir / MACHINE_FILE).write_text(machine_text, encoding="utf-8")
        draw_comparison(measurements, tmp_dir)
        paths = [folder / path.name for path in sorted(tmp_dir.iterdir())]
        for path in paths:
            os.replace(tmp_dir / path.name, path)
    return paths


def _row(m: Measurement) -> list[object]:
    what = m.solver, m.family, m.size, m.instance.name, m.tolerance
    cells: list[object] = [*what, m.instance.is_feasible, m.is_correct]
    for outcome in (m.first, m.second):
        if outcome is None:
            cells += [""] * len(OUTCOME_COLUMNS)
        else:
            reason = " ".join(outcome.reason.split())
            cells += [outcome.verdict, reason, *map(_blank_if_nan, outcome[2:])]
    return [*cells, _blank_if_nan(m.memory_growth)]


def _blank_if_nan(number: float | int | None) -> object:
    return "" if number is None or number != number else number


def _format_milliseconds(seconds: Sequence[float | None]) -> str:
    # Three digits, without an exponent.
    return "/".join(MISSING if s is None else f"{float(f'{1e3 * s:.3g}'):.12g}" for s in seconds)


def _median(numbers: Iterable[float | None]) -> float | None:
    known = [number for number in numbers if number is not None]
    return median(known) if known else None


def _make_console() -> Console:
    # A file or a pipe has no width to which tables must be fitted.
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=PIPE_WIDTH)
