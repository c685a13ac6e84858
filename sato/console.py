"""Progress, summaries and reports on a terminal, and progress in a notebook."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import inf, isfinite
from pathlib import Path
from time import monotonic
from typing import Any

from rich.box import HEAVY_HEAD, MARKDOWN
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.table import Column, Table

from dynamics.trajectory_geometry import sampled_separations
from sato.check.report import Report
from sato.compilation import announce_compilation
from sato.interfaces import Frame, FrameT, MissionProgress, MissionT
from sato.summary import format_label, format_value, is_parts, summary_rows
from sato.terminal import as_plain, echo

MAX_TABLE = 500  # rows of a table with rules, which takes 1 ms a row
UPDATE_INTERVAL = 0.1  # between two updates of a bar, as many as its terminal shows [s]
PIPE_WIDTH = 10_000  # a file or a pipe has no width to which tables must be fitted


class TextConsole(Console):
    """Console on which text is text: no markup in it, and no character that commands a terminal."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        """Render, with controls in text spelled out."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=as_plain(segment.text))


@contextmanager
def show_mission_progress(
    progress_of: Callable[[MissionT, FrameT], MissionProgress],
) -> Iterator[Callable[[MissionT, FrameT], None]]:
    """Yield a function of mission and frame that shows progress: by a bar, or a line a stage."""
    console = TextConsole(stderr=True)
    has_bar = sys.stderr.isatty() or console.is_jupyter
    text = "{task.fields[stage]}, step {task.completed} of {task.total}, {task.fields[details]}"
    columns = (BarColumn(), TextColumn(text, markup=False), TimeElapsedColumn())
    shown, shown_at, least, unseen = "", -inf, inf, list[FrameT]()
    with Progress(*columns, console=console, disable=not has_bar) as bar:
        task = bar.add_task("", total=None, visible=False, stage="", details="")

        def show(mission: MissionT, frame: FrameT) -> None:
            nonlocal shown, shown_at, least
            unseen.append(frame)
            stage, done, total, details = progress_of(mission, frame)
            is_due = has_bar and (done == total or monotonic() >= shown_at + UPDATE_INTERVAL)
            if stage == shown and not is_due:
                return
            least = min(least, *map(_least_separation, unseen))
            unseen.clear()
            details = _describe(frame, least, details)
            if has_bar:
                fields: dict[str, Any] = {"stage": stage, "details": details}
                bar.update(task, completed=done, total=total, visible=True, **fields)
            else:
                echo(f"{stage} at {frame.time:g} s: {details}", err=True)
            shown, shown_at = stage, monotonic()

        yield show


@contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None]]:
    """Show a bar of counted work on a terminal, a moving one until it is counted; else nothing."""
    console, is_hidden = TextConsole(stderr=True), not sys.stderr.isatty()
    columns = (TextColumn(label, markup=False), BarColumn(), TimeElapsedColumn())
    bar = Progress(*columns, console=console, transient=True, disable=is_hidden)
    with announce_compilation(), bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def print_summary(summary: dict[str, Any], folder: Path) -> None:
    """Print a summary as a table, and parts such as legs side by side."""
    console = TextConsole()
    for name, parts in summary.items():
        if is_parts(parts):
            numbers = range(1, len(parts) + 1)
            heads = [Column(f"{name.removesuffix('s')} {n}", justify="right") for n in numbers]
            table = Table("", *heads)
            for key in dict.fromkeys(key for part in parts for key in part):
                table.add_row(format_label(key), *[format_value(part.get(key)) for part in parts])
            console.print(table)
    table = Table(show_header=False)
    for label, text in summary_rows(summary):
        table.add_row(label, text)
    console.print(table)
    console.print(f"{folder}", highlight=False, soft_wrap=True)


def print_rows(head: Sequence[str], rows: Sequence[Sequence[str]], markdown: bool = False) -> None:
    """Print rows of text under a head; as wide as they are where the output is no terminal."""
    console = TextConsole(highlight=False)
    if markdown or len(rows) > MAX_TABLE:
        head = [name.replace("\n", " ") for name in head]
    if len(rows) > MAX_TABLE:
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        for row in (head, *rows):
            echo("  ".join(map(str.ljust, row, widths)).rstrip())
        return
    if markdown or not console.is_terminal:
        console.width = PIPE_WIDTH
    table = Table(*head, box=MARKDOWN if markdown else HEAVY_HEAD)
    for row in rows:
        table.add_row(*row)
    console.print(table)


def print_report(report: Report) -> None:
    """Print each promise, and whether it was kept."""
    table = Table("promise", "kept", "value", "limit", "meaning")
    for promise in report.promises:
        value, limit = promise.value, promise.tolerance
        shown = (format_value(value, limit), format_value(limit), promise.text)
        table.add_row(promise.name, "yes" if promise.kept else "NO", *shown)
    for name in report.skipped:
        table.add_row(name, "?", "", "", "skipped")
    console = TextConsole()
    console.print(table)
    if report.skipped:
        console.print(f"skipped: {report.skip_reason}", soft_wrap=True)


def _least_separation(frame: Frame) -> float:
    return float(sampled_separations(frame.position[None], frame.alive[None])[0])


def _describe(frame: Frame, least: float, details: str) -> str:
    count = int(frame.component.max()) + 1
    separation = f"least separation {least:.3g} m" if isfinite(least) else ""
    network = f"{count} component{'s' * (count != 1)}"
    return ", ".join(filter(None, (network, separation, details)))
