"""What a run and a judgement look like on a terminal."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from dynamics.path import sampled_separations
from sato.record import Run
from sato.system import F, Frame, M, Passage

if TYPE_CHECKING:
    import sato.check

CALLED = {  # where a name alone does not say it, or ends as if it had a unit
    "fuel_per_agent_m_s": ("Δv per spacecraft", "m/s"),
    "bytes_per_vehicle_s": ("sent by each vehicle", "bytes/s"),
}


@contextmanager
def progress(
    quiet: bool, passage: Callable[[M, F], Passage]
) -> Iterator[Callable[[M, F], None] | None]:
    """A watcher of frames: a bar on a terminal, else a line a stage, and none when quiet.

    Args:
        quiet: Whether nothing is to be said.
        passage: How far a mission has come at a frame.
    """
    if quiet:
        yield None
    elif not sys.stderr.isatty():
        yield _Lines(passage)
    else:
        said = "{task.fields[stage]}, step {task.completed} of {task.total}, {task.fields[words]}"
        columns = (BarColumn(), TextColumn(said), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            yield _Bar(passage, bar)


@contextmanager
def counted(doing: str) -> Iterator[Callable[[int, int], None]]:
    """A bar for what is counted, on a terminal; nothing elsewhere."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    columns = (TextColumn(doing), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(doing)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def waiting(doing: str) -> AbstractContextManager[object]:
    """A sign of life while something uncounted goes on, on a terminal; nothing elsewhere."""
    return Console(stderr=True).status(doing) if sys.stderr.isatty() else nullcontext()


class _Watch:
    """What a passenger wants to know: stage, parts of the network, least separation so far."""

    def __init__(self, passage: Callable[[Any, Any], Passage]) -> None:
        self.passage = passage
        self.least = float("inf")

    def words(self, frame: Frame, more: str) -> str:
        now = sampled_separations(frame.position[None], frame.alive[None])
        self.least = min(self.least, float(now[0]))
        parts = int(frame.component.max()) + 1
        near = f", least separation {self.least:.3g} m" if self.least < float("inf") else ""
        return f"{parts} component{'s' * (parts != 1)}{near}{more and f', {more}'}"


class _Lines(_Watch):
    """A line at the start of each stage."""

    stage = ""

    def __call__(self, mission: object, frame: Frame) -> None:
        stage, _, _, more = self.passage(mission, frame)
        words = self.words(frame, more)
        if stage != self.stage:
            self.stage = stage
            print(f"{stage} at {frame.time:g} s: {words}", file=sys.stderr)


class _Bar(_Watch):
    """A bar over the steps of all stages; what is known of their number may change."""

    def __init__(self, passage: Callable[[Any, Any], Passage], bar: Progress) -> None:
        super().__init__(passage)
        self.bar = bar
        self.task = bar.add_task("", total=None, visible=False, stage="", words="")

    def __call__(self, mission: object, frame: Frame) -> None:
        stage, done, total, more = self.passage(mission, frame)
        fields: dict[str, Any] = {"stage": stage, "words": self.words(frame, more)}
        self.bar.update(self.task, completed=done, total=total, visible=True, **fields)


def tell(run: Run, folder: Path) -> None:
    """The summary as a table; what there are several of stands side by side."""
    console = Console()
    whole = Table(show_header=False)
    for name, value in run.summary.items():
        if isinstance(value, list) and value and all(isinstance(part, dict) for part in value):
            console.print(_side_by_side(name.removesuffix("s"), value))
        elif isinstance(value, dict):
            for which, each in value.items():
                whole.add_row(_spelt(name, which), _short(each))
        else:
            radius = run.summary.get("collision_radius_m")
            limit = radius if name.startswith("min_separation") else None
            whole.add_row(_spelt(name), _short(value, limit))
    console.print(whole)
    console.print(f"{folder}", highlight=False, markup=False, soft_wrap=True)


def _side_by_side(name: str, parts: list[dict[str, Any]]) -> Table:
    table = Table()
    table.add_column("")
    for number in range(1, len(parts) + 1):
        table.add_column(f"{name} {number}", justify="right")
    for key in dict.fromkeys(key for part in parts for key in part):
        table.add_row(_spelt(key), *[_short(part.get(key)) for part in parts])
    return table


def tell_promises(report: "sato.check.Report") -> None:
    """Each promise, and whether it was kept."""
    table = Table()
    for name in ("promise", "kept", "found", "may be", "which means"):
        table.add_column(name)
    for p in report.promises:
        kept = "yes" if p.kept else "NO"
        table.add_row(p.name, kept, _short(p.value, p.tolerance), _short(p.tolerance), p.sentence)
    Console().print(table)


def _spelt(name: str, which: str = "") -> str:
    words, unit = CALLED.get(name) or _split(name)
    return ", ".join(part for part in (words, which, unit) if part)


def _split(name: str) -> tuple[str, str]:
    for ending, unit in (("_m_s", "m/s"), ("_m", "m"), ("_s", "s"), ("_mib", "MiB")):
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), ""


def _short(value: object, beside: float | None = None) -> str:
    # With as many digits as it takes to tell it from what stands beside it.
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        digits = 4
        if beside is not None and beside != value:
            while digits < 16 and f"{value:.{digits}g}" == f"{beside:.{digits}g}":
                digits += 1
        return f"{value:.{digits}g}"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return "" if value is None else str(value)
