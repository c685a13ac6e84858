"""What a run and a judgement look like on a terminal."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from dynamics.trajectory_geometry import sampled_separations
from sato.interfaces import Frame, FrameT, MissionProgress, MissionT
from sato.record import Run

if TYPE_CHECKING:
    import sato.check

LABELS = {  # where a name alone does not say it, or ends as if it had a unit
    "fuel_per_agent_m_s": ("Δv per spacecraft", "m/s"),
    "bytes_per_vehicle_s": ("sent by each vehicle", "bytes/s"),
}


@contextmanager
def show_mission_progress(
    quiet: bool, progress_of: Callable[[MissionT, FrameT], MissionProgress]
) -> Iterator[Callable[[MissionT, FrameT], None] | None]:
    """A watcher of frames: a bar on a terminal, else a line a stage, and none when quiet.

    Args:
        quiet: Whether nothing is to be said.
        passage: How far a mission has come at a frame.
    """
    if quiet:
        yield None
    elif not sys.stderr.isatty():
        yield _LineReporter(progress_of)
    else:
        said = "{task.fields[stage]}, step {task.completed} of {task.total}, {task.fields[words]}"
        columns = (BarColumn(), TextColumn(said), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            yield _BarReporter(progress_of, bar)


@contextmanager
def progress_bar(doing: str) -> Iterator[Callable[[int, int], None]]:
    """A bar for what is counted, on a terminal; nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    columns = (TextColumn(doing), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(doing)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def spinner(doing: str) -> AbstractContextManager[object]:
    """A sign of life while something uncounted goes on, on a terminal; nothing elsewhere."""
    return Console(stderr=True).status(doing) if sys.stderr.isatty() else nullcontext()


class _ProgressReporter:
    """What a passenger wants to know: stage, parts of the network, least separation so far."""

    def __init__(self, passage: Callable[[Any, Any], MissionProgress]) -> None:
        self.progress_of = passage
        self.min_separation = float("inf")

    def describe(self, frame: Frame, more: str) -> str:
        now = sampled_separations(frame.position[None], frame.alive[None])
        self.min_separation = min(self.min_separation, float(now[0]))
        parts = int(frame.component.max()) + 1
        near = (
            f", least separation {self.min_separation:.3g} m"
            if self.min_separation < float("inf")
            else ""
        )
        return f"{parts} component{'s' * (parts != 1)}{near}{more and f', {more}'}"


class _LineReporter(_ProgressReporter):
    """A line at the start of each stage."""

    stage = ""

    def __call__(self, mission: object, frame: Frame) -> None:
        stage, _, _, more = self.progress_of(mission, frame)
        words = self.describe(frame, more)
        if stage != self.stage:
            self.stage = stage
            print(f"{stage} at {frame.time:g} s: {words}", file=sys.stderr)


class _BarReporter(_ProgressReporter):
    """A bar over the steps of all stages; what is known of their number may change."""

    def __init__(self, passage: Callable[[Any, Any], MissionProgress], bar: Progress) -> None:
        super().__init__(passage)
        self.bar = bar
        self.task = bar.add_task("", total=None, visible=False, stage="", words="")

    def __call__(self, mission: object, frame: Frame) -> None:
        stage, done, total, more = self.progress_of(mission, frame)
        fields: dict[str, Any] = {"stage": stage, "words": self.describe(frame, more)}
        self.bar.update(self.task, completed=done, total=total, visible=True, **fields)


def print_summary(run: Run, folder: Path) -> None:
    """The summary as a table; what there are several of stands side by side."""
    console = Console()
    whole = Table(show_header=False)
    for name, value in run.summary.items():
        if isinstance(value, list) and value and all(isinstance(part, dict) for part in value):
            console.print(_parts_table(name.removesuffix("s"), value))
        elif isinstance(value, dict):
            for which, each in value.items():
                whole.add_row(_label(name, which), _format_value(each))
        else:
            radius = run.summary.get("collision_radius_m")
            limit = radius if name.startswith("min_separation") else None
            whole.add_row(_label(name), _format_value(value, limit))
    console.print(whole)
    console.print(f"{folder}", highlight=False, markup=False, soft_wrap=True)


def _parts_table(name: str, parts: list[dict[str, Any]]) -> Table:
    table = Table()
    table.add_column("")
    for number in range(1, len(parts) + 1):
        table.add_column(f"{name} {number}", justify="right")
    for key in dict.fromkeys(key for part in parts for key in part):
        table.add_row(_label(key), *[_format_value(part.get(key)) for part in parts])
    return table


def print_report(report: "sato.check.Report") -> None:
    """Each promise, and whether it was kept."""
    table = Table()
    for name in ("promise", "kept", "found", "may be", "which means"):
        table.add_column(name)
    for p in report.promises:
        kept = "yes" if p.kept else "NO"
        table.add_row(
            p.name, kept, _format_value(p.value, p.tolerance), _format_value(p.tolerance), p.message
        )
    Console().print(table)


def _label(name: str, which: str = "") -> str:
    words, unit = LABELS.get(name) or _split_unit(name)
    return ", ".join(part for part in (words, which, unit) if part)


def _split_unit(name: str) -> tuple[str, str]:
    for ending, unit in (("_m_s", "m/s"), ("_m", "m"), ("_s", "s"), ("_mib", "MiB")):
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), ""


def _format_value(value: object, compared_to: float | None = None) -> str:
    # With as many digits as it takes to tell it from what stands beside it.
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        digits = 4
        if compared_to is not None and compared_to != value:
            while digits < 16 and f"{value:.{digits}g}" == f"{compared_to:.{digits}g}":
                digits += 1
        return f"{value:.{digits}g}"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return "" if value is None else str(value)
