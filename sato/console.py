"""Progress, summaries and reports on a terminal, and progress in a notebook."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from dynamics.trajectory_geometry import sampled_separations
from sato.check.report import Report
from sato.interfaces import Frame, FrameT, MissionProgress, MissionT
from sato.summary import format_label, format_value, is_parts, summary_rows


@contextmanager
def show_mission_progress(
    progress_of: Callable[[MissionT, FrameT], MissionProgress],
) -> Iterator[Callable[[MissionT, FrameT], None]]:
    """Show progress: a bar on a terminal or in a notebook, else a line a stage.

    Args:
        progress_of: Progress of a mission at a frame.

    Yields:
        A function to be called with the mission and each frame.
    """
    console = Console(stderr=True)
    if not (sys.stderr.isatty() or console.is_jupyter):
        yield _LineReporter(progress_of)
        return
    text = "{task.fields[stage]}, step {task.completed} of {task.total}, {task.fields[details]}"
    columns = (BarColumn(), TextColumn(text), TimeElapsedColumn())
    with Progress(*columns, console=console) as bar:
        yield _BarReporter(progress_of, bar)


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar of counted work on a terminal; nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def spinner(label: str) -> AbstractContextManager[object]:
    """Show a spinner on a terminal; nothing elsewhere."""
    return Console(stderr=True).status(label) if sys.stderr.isatty() else nullcontext()


class _Reporter:
    """Base of reporters: components of the network, and least separation so far."""

    def __init__(self, progress_of: Callable[[Any, Any], MissionProgress]) -> None:
        self.progress_of = progress_of
        self.min_separation = float("inf")

    def describe(self, frame: Frame, details: str) -> str:
        now = sampled_separations(frame.position[None], frame.alive[None])
        self.min_separation = min(self.min_separation, float(now[0]))
        count = int(frame.component.max()) + 1
        parts = [f"{count} component{'s' * (count != 1)}"]
        if self.min_separation < float("inf"):
            parts.append(f"least separation {self.min_separation:.3g} m")
        return ", ".join([*parts, details] if details else parts)


class _LineReporter(_Reporter):
    """A line at the start of each stage."""

    stage = ""

    def __call__(self, mission: object, frame: Frame) -> None:
        stage, _, _, details = self.progress_of(mission, frame)
        text = self.describe(frame, details)
        if stage != self.stage:
            self.stage = stage
            print(f"{stage} at {frame.time:g} s: {text}", file=sys.stderr)


class _BarReporter(_Reporter):
    """A bar over the steps of all stages; their number may change on the way."""

    def __init__(self, progress_of: Callable[[Any, Any], MissionProgress], bar: Progress) -> None:
        super().__init__(progress_of)
        self.bar = bar
        self.task = bar.add_task("", total=None, visible=False, stage="", details="")

    def __call__(self, mission: object, frame: Frame) -> None:
        stage, done, total, details = self.progress_of(mission, frame)
        fields: dict[str, Any] = {"stage": stage, "details": self.describe(frame, details)}
        self.bar.update(self.task, completed=done, total=total, visible=True, **fields)


def print_summary(summary: dict[str, Any], folder: Path) -> None:
    """Print a summary as a table, and parts such as legs side by side."""
    console = Console()
    for name, value in summary.items():
        if is_parts(value):
            console.print(_parts_table(name.removesuffix("s"), value))
    table = Table(show_header=False)
    for label, text in summary_rows(summary):
        table.add_row(label, text)
    console.print(table)
    console.print(f"{folder}", highlight=False, markup=False, soft_wrap=True)


def print_report(report: Report) -> None:
    """Print each promise, and whether it was kept."""
    table = Table()
    for name in ("promise", "kept", "value", "limit", "meaning"):
        table.add_column(name)
    for promise in report.promises:
        value, limit = promise.value, promise.tolerance
        shown = (format_value(value, limit), format_value(limit), promise.message)
        table.add_row(promise.name, "yes" if promise.kept else "NO", *shown)
    for name in report.skipped:
        table.add_row(
            name, "?", "", "", "skipped: it needs the mission, sato.load(path, mission=…)"
        )
    Console().print(table)


def _parts_table(name: str, parts: list[dict[str, Any]]) -> Table:
    table = Table()
    table.add_column("")
    for number in range(1, len(parts) + 1):
        table.add_column(f"{name} {number}", justify="right")
    for key in dict.fromkeys(key for part in parts for key in part):
        table.add_row(format_label(key), *[format_value(part.get(key)) for part in parts])
    return table
