"""Tables of a comparison, for the terminal and in Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from statistics import median

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from sato.compare.measure import Measurement
from sato.compare.plan import ComparisonPlan, format_tolerance
from sato.compare.summary import (
    SolverSummary,
    reference_tolerance,
    sizes_present,
    summarize,
    tolerances_present,
)

MISSING = "–"
PIPE_WIDTH = 140
COUNTED_VERDICTS = ("wrong claim", "failed", "unproven", "crashed", "skipped")


def print_plan(plan: ComparisonPlan, machine: Mapping[str, object]) -> None:
    """Print the machine, and the solvers that are left out."""
    console = _make_console()
    console.print(
        f"{machine['processor']}, {machine['cores']} cores, one thread for each solver, "
        f"Python {machine['python']}",
        markup=False,
    )
    versions = machine["versions"]
    if isinstance(versions, dict):
        console.print(", ".join(f"{name} {number}" for name, number in versions.items()))
    for reason in plan.exclusions:
        console.print(f"left out: {reason}", markup=False)


def print_comparison(plan: ComparisonPlan, measurements: Sequence[Measurement]) -> None:
    """Print a table for each family."""
    console, at = _make_console(), reference_tolerance(plan.tolerances)
    for name in dict.fromkeys(m.family for m in measurements):
        some = [m for m in measurements if m.family == name]
        console.print(_family_table(name, some, at))
        if absent := [s.name for s in plan.solvers if s.name not in {m.solver for m in some}]:
            console.print(f"  cannot take it: {', '.join(absent)}")
        for line in _list_failures(some):
            console.print(f"  {line}", markup=False)
    console.print(
        f"Times, iterations and the largest error of the cost are those of correct answers at "
        f"{format_tolerance(at)}, from small to large. Times are processor times; memory is that "
        "of the largest size. Not solved: failed, crashed, skipped, or infeasible without a proof."
    )


def format_markdown(measurements: Sequence[Measurement]) -> str:
    """Format three parts: correct answers and verdicts, times at the medium size, and failures."""
    tolerances = tolerances_present(measurements)
    at, sizes = reference_tolerance(tolerances), sizes_present(measurements)
    size = "medium" if "medium" in sizes else sizes[-1]
    solvers = summarize(measurements, at)
    families = list(dict.fromkeys(m.family for m in measurements))
    timed = [m for m in measurements if m.size == size and m.tolerance == at]
    counts = _markdown_table(
        ["solver", *(f"right at {format_tolerance(t)}" for t in tolerances), *COUNTED_VERDICTS],
        ([s.solver, *s.correct, *(str(s.verdicts[v]) for v in COUNTED_VERDICTS)] for s in solvers),
    )
    times = _markdown_table(
        ["solver", *families],
        (
            [
                s.solver,
                *(
                    _median_times([m for m in timed if (m.solver, m.family) == (s.solver, family)])
                    for family in families
                ),
            ]
            for s in solvers
        ),
    )
    return "\n".join(
        [
            *counts,
            "",
            f"Medians of correct first solves and re-solves [ms], {size} size, at "
            f"{format_tolerance(at)}; ✗: never correct.",
            "",
            *times,
            "",
            *(f"- {line}" for line in _list_failures(measurements)),
            "",
        ]
    )


def _family_table(name: str, measurements: Sequence[Measurement], at: float) -> Table:
    title = f"{name} ({' / '.join(sizes_present(measurements))})"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("solver", no_wrap=True)
    headers = [f"right\n{format_tolerance(t)}" for t in tolerances_present(measurements)]
    headers += ["wrong\nclaims", "not\nsolved", "first\nms", "re-solve\nms", "iterations\n"]
    for header in [*headers, "cost\nerror", "memory\nMiB"]:
        table.add_column(header, justify="right", overflow="fold")
    for summary in summarize(measurements, at):
        table.add_row(*_summary_cells(summary))
    return table


def _summary_cells(summary: SolverSummary) -> list[str]:
    wrong, *unsolved = (summary.verdicts[verdict] for verdict in COUNTED_VERDICTS)
    return [
        summary.solver,
        *summary.correct,
        f"[bold red]{wrong}[/]" if wrong else "0",
        str(sum(unsolved)),
        _format_milliseconds(summary.first),
        _format_milliseconds(summary.second),
        "/".join(MISSING if n is None else f"{n:.0f}" for n in summary.iterations),
        MISSING if summary.cost_error is None else f"{summary.cost_error:.0e}",
        MISSING if summary.memory is None else f"{summary.memory:.1f}",
    ]


def _format_milliseconds(seconds: Sequence[float | None]) -> str:
    # Three digits, without an exponent.
    times = [None if s is None else float(f"{1e3 * s:.3g}") for s in seconds]
    return "/".join(MISSING if t is None else f"{t:.12g}" for t in times)


def _list_failures(measurements: Sequence[Measurement]) -> list[str]:
    # Each verdict of a solver in a family once, with the first example.
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


def _median_times(measurements: Sequence[Measurement]) -> str:
    correct = [m for m in measurements if m.is_correct]
    if not correct:
        return "✗" if measurements else ""
    first = [m.first.seconds for m in correct]
    second = [m.second.seconds for m in correct if m.second]
    cell = " / ".join(_format_milliseconds([median(times)]) for times in (first, second) if times)
    all_correct = len(correct) == len(measurements)
    return cell if all_correct else f"{cell} ({len(correct)} of {len(measurements)})"


def _markdown_table(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    separator = "|---|" + "---:|" * (len(headers) - 1)
    lines = [f"| {' | '.join(cells)} |" for cells in (headers, *rows)]
    return [lines[0], separator, *lines[1:]]


def _make_console() -> Console:
    # A file or a pipe has no width to which tables must be fitted.
    console = Console(highlight=False)
    return console if console.is_terminal else Console(highlight=False, width=PIPE_WIDTH)
