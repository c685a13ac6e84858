"""What a run and a judgement look like on a terminal."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from sato.reconfiguration import Reconfiguration
from sato.reconfiguration.mission import least_distance
from sato.record import Frame, Run

if TYPE_CHECKING:
    import sato.check


@contextmanager
def progress(quiet: bool) -> Iterator[Callable[[Reconfiguration, Frame], None] | None]:
    """A watcher of frames: a bar on a terminal, else a line a leg, and none when quiet."""
    if quiet:
        yield None
    elif not sys.stderr.isatty():
        yield _Lines()
    else:
        said = "leg {task.fields[leg]}, step {task.completed} of {task.total}, {task.fields[words]}"
        columns = (BarColumn(), TextColumn(said), TimeElapsedColumn())
        with Progress(*columns, console=Console(stderr=True)) as bar:
            yield _Bar(bar)


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
    """What a passenger wants to know: leg, parts of the network, least separation so far."""

    def __init__(self) -> None:
        self.least = float("inf")
        self.leg = -1

    def words(self, frame: Frame) -> str:
        self.least = min(self.least, least_distance(frame.position[frame.alive]))
        parts = int(frame.component.max()) + 1
        near = f", least separation {self.least:.3g} m" if self.least < float("inf") else ""
        return f"{parts} component{'s' * (parts != 1)}{near}"


class _Lines(_Watch):
    """A line at the start of each leg."""

    def __call__(self, mission: Reconfiguration, frame: Frame) -> None:
        words = self.words(frame)
        if frame.leg != self.leg:
            self.leg = frame.leg
            legs = len(mission.legs)
            print(f"leg {frame.leg + 1} of {legs} at {frame.time:g} s: {words}", file=sys.stderr)


class _Bar(_Watch):
    """A bar over the steps of all legs; resets make it longer."""

    def __init__(self, bar: Progress) -> None:
        super().__init__()
        self.bar = bar
        self.task: Any = None
        self.steps = 0

    def __call__(self, mission: Reconfiguration, frame: Frame) -> None:
        planned = sum(leg.steps for leg in mission.legs)
        leg = f"{frame.leg + 1} of {len(mission.legs)}"
        fields: dict[str, Any] = {"leg": leg, "words": self.words(frame)}
        if self.task is None:
            self.task = self.bar.add_task("", total=planned, **fields)
        left = sum(leg.steps for leg in mission.legs[frame.leg + 1 :])
        self.steps = round(frame.time / mission.step)
        total = max(planned, self.steps + left)
        self.bar.update(self.task, completed=self.steps, total=total, **fields)


def tell(run: Run, folder: Path) -> None:
    """The summary as a table, legs side by side."""
    said = dict(run.summary)
    legs = said.pop("legs", [])
    table = Table()
    table.add_column("")
    for number in range(1, len(legs) + 1):
        table.add_column(f"leg {number}", justify="right")
    for name in dict.fromkeys(name for leg in legs for name in leg):
        table.add_row(_spelt(name), *[_short(leg.get(name)) for leg in legs])
    whole = Table(show_header=False)
    for name, value in said.items():
        limit = said.get("collision_radius_m") if name.startswith("min_separation") else None
        if name == "fuel_per_agent_m_s":
            for which, each in value.items():
                whole.add_row(f"Δv per spacecraft, {which}, m/s", _short(each))
        else:
            whole.add_row(_spelt(name), _short(value, limit))
    console = Console()
    if legs:
        console.print(table)
    console.print(whole)
    console.print(f"{folder}", highlight=False, markup=False, soft_wrap=True)


def tell_promises(report: "sato.check.Report") -> None:
    """Each promise, and whether it was kept."""
    table = Table()
    for name in ("promise", "kept", "found", "may be", "which means"):
        table.add_column(name)
    for p in report.promises:
        kept = "yes" if p.kept else "NO"
        table.add_row(p.name, kept, _short(p.value, p.tolerance), _short(p.tolerance), p.sentence)
    Console().print(table)


def _spelt(name: str) -> str:
    for ending, unit in (("_m_s", "m/s"), ("_m", "m"), ("_s", "s"), ("_mib", "MiB")):
        if name.endswith(ending):
            return f"{name.removesuffix(ending).replace('_', ' ')}, {unit}"
    return name.replace("_", " ")


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
