"""What a comparison looks like on a terminal."""

from collections.abc import Mapping, Sequence

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from sato.compare.measure import Measurement
from sato.compare.plan import ComparisonPlan, format_tolerance
from sato.compare.summary import SolverSummary, reference_tolerance, sizes_present, summarize

MISSING = "–"
PIPE_WIDTH = 140


def print_plan(plan: ComparisonPlan, machine: Mapping[str, object]) -> None:
    """On what it is measured, and who is not asked."""
    console = _make_console()
    versions = machine["versions"]
    console.print(
        f"{machine['processor']}, {machine['cores']} cores, one thread for each solver, "
        f"Python {machine['python']}",
        markup=False,
    )
    if isinstance(versions, dict):
        console.print(", ".join(f"{name} {number}" for name, number in versions.items()))
    for why in plan.excluded:
        console.print(f"not asked: {why}", markup=False)


def print_comparison(plan: ComparisonPlan, measurements: Sequence[Measurement]) -> None:
    """A block a family."""
    console, at = _make_console(), reference_tolerance(plan.tolerances)
    for name in dict.fromkeys(m.family for m in measurements):
        some = [m for m in measurements if m.family == name]
        console.print(_family_table(name, some, plan.tolerances, at))
        if absent := [s.name for s in plan.solvers if s.name not in {m.solver for m in some}]:
            console.print(f"  cannot take it: {', '.join(absent)}")
        for line in _list_failures(some):
            console.print(f"  {line}", markup=False)
    console.print(
        f"Times, iterations and the worst error of the cost are at {format_tolerance(at)}, of what was "
        "right, small to large; times are the processor's; memory is of the largest. Not solved: "
        "failed, crashed, skipped, or infeasible without a proof."
    )


def _family_table(
    name: str, some: Sequence[Measurement], tolerances: Sequence[float], at: float
) -> Table:
    there = sizes_present(some)
    title = f"{name} ({' / '.join(there)})"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("solver", no_wrap=True)
    heads = [f"right\n{format_tolerance(tolerance)}" for tolerance in tolerances]
    heads += ["wrong\nclaims", "not\nsolved", "first\nms", "re-solve\nms", "iterations\n"]
    for head in [*heads, "cost\nerror", "memory\nMiB"]:
        table.add_column(head, justify="right", overflow="fold")
    for line in summarize(some, at):
        table.add_row(*_summary_cells(line))
    return table


def _summary_cells(line: SolverSummary) -> list[str]:
    unsolved = line.failed + line.unproven + line.crashed + line.skipped
    return [
        line.solver,
        *line.correct,
        f"[bold red]{line.wrong_claims}[/]" if line.wrong_claims else "0",
        str(unsolved),
        _format_milliseconds(line.first),
        _format_milliseconds(line.second),
        "/".join(MISSING if n is None else f"{n:.0f}" for n in line.iterations),
        MISSING if line.cost_error is None else f"{line.cost_error:.0e}",
        MISSING if line.memory is None else f"{line.memory:.1f}",
    ]


def _format_milliseconds(seconds: Sequence[float | None]) -> str:
    # Three digits, and never an exponent.
    times = [None if s is None else float(f"{1e3 * s:.3g}") for s in seconds]
    return "/".join(MISSING if t is None else f"{t:.12g}" for t in times)


def _list_failures(some: Sequence[Measurement]) -> list[str]:
    # Each kind of trouble of a solver once, with the first example of it.
    found: dict[tuple[str, str], list[str]] = {}
    for m in some:
        for outcome in m.outcomes:
            if outcome.verdict not in ("solved", "infeasible"):
                where = f"{m.instance.name} at {format_tolerance(m.tolerance)}: {outcome.reason}"
                found.setdefault((m.solver, outcome.verdict), []).append(where)
    return [
        f"{solver}: {verdict}{f' {len(cases)} times' if len(cases) > 1 else ''}, {cases[0]}"
        for (solver, verdict), cases in found.items()
    ]


def _make_console() -> Console:
    # In a file or a pipe nothing has to be squeezed.
    there = Console(highlight=False)
    return there if there.is_terminal else Console(highlight=False, width=PIPE_WIDTH)
