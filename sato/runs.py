"""Runs: missions flown, saved, loaded, checked and shown."""

import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property
from html import escape
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.random import Generator
from threadpoolctl import ThreadpoolController, threadpool_limits

from sato import record
from sato.check.common import EventLog
from sato.check.report import Report
from sato.compilation import announce_compilation
from sato.console import show_mission_progress
from sato.interfaces import Frame, System
from sato.resource_usage import peak_memory_mib
from sato.run_data import RunData
from sato.scenario.errors import InputError, ScenarioError, format_value
from sato.scenario.file import Mission, from_dict, parse, read
from sato.scenario.origin import Origin
from sato.summary import summary_rows
from sato.systems import load_system

if TYPE_CHECKING:  # slow to import
    import matplotlib.figure
    import xarray

    from sato.scene import SwarmScene

Scenario = str | Path | Mission | Mapping[str, Any]
FrameCallback = Callable[[Any, Any], object]  # of the drawn mission and a frame


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """Mission that was flown: its data, its summary, and the mission itself.

    Args:
        recorded: Arrays and attributes of the run file.
        summary: Entries of `summary.json`.
        mission: Not drawn; None where a file holds a model of the user's own.

    Raises:
        InputError: The data are no `RunData`.
    """

    recorded: RunData
    summary: dict[str, Any]
    mission: Any | None = None

    def __post_init__(self) -> None:
        """Refuse a dataset in place of its arrays."""
        if not isinstance(self.recorded, RunData):
            got = type(self.recorded).__name__
            raise InputError(
                "recorded", f"must be RunData, got {got}; RunData.from_xarray would do"
            )

    @cached_property
    def data(self) -> "xarray.Dataset":
        """Data of the run as an xarray dataset, in which no change changes the run."""
        return self.recorded.to_xarray().copy(deep=True)

    @cached_property
    def drawn_mission(self) -> Any:
        """Mission with all random numbers drawn, as it was flown.

        Raises:
            RunFileError: The run was loaded without its mission, which has its own model.
        """
        if self.mission is None:
            raise record.RunFileError(
                "this run has a model of your own, which no file can hold; give its mission: "
                "sato.load(path, mission=...)"
            )
        return self.mission.draw(np.random.default_rng(int(self.recorded.attrs["seed"])))

    def events(self, *kinds: str) -> list[dict[str, Any]]:
        """Return the events in the order of time; of the given kinds only, if any."""
        log = EventLog.from_data(self.recorded)
        return [event for event in log.events if not kinds or event["kind"] in kinds]

    def check(self) -> Report:
        """Check the run by recomputing what its data and its summary say."""
        from sato.verify import verify_run

        return verify_run(self.recorded, self.mission, self.summary)

    def figures(self) -> dict[str, "matplotlib.figure.Figure"]:
        """Draw the figures of the run, by name."""
        from sato.render import draw_figures

        return draw_figures(self.recorded, self.drawn_mission)

    def plot(self, directory: str | Path, pdf: bool = False) -> list[Path]:
        """Write the figures of the run as PNG, or PDF, in place of figures of earlier runs."""
        from sato.render import write_figures

        digest = self.recorded.attrs.get("digest", "")
        return write_figures(self.figures(), Path(directory), pdf, digest)

    def animate(self, directory: str | Path, **options: Any) -> Path:
        """Write an animation of the run; options as in `sato.render.animate`."""
        from sato.render import animate

        digest = self.recorded.attrs.get("digest", "")
        return animate(self.scene(), Path(directory), digest, **options)

    def scene(self) -> "SwarmScene":
        """Make the scene of the run, as viewers show it.

        Raises:
            InputError: The system has none.
            RunFileError: The run has no instants.
        """
        system = load_system(self.recorded.attrs["system"])
        if system.scene is None:
            raise InputError("", f"runs of {system.name} have no scene that a viewer could show")
        if not len(self.recorded["time"]):
            raise record.RunFileError("the run has no instants, and nothing can be shown")
        return system.scene(self.recorded, self.drawn_mission)

    def player(self, path: str | Path) -> Path:
        """Write the run as one HTML file, which plays it in a browser without a network."""
        from sato.player import write_player

        return write_player(self.scene(), self.recorded.attrs, Path(path))

    def export(self, path: str | Path, format: str = "oem") -> Path:
        """Write the trajectories for other tools, see `sato.export`."""
        from sato.export import export

        return export(self.recorded, path, format, self.scene if format == "rrd" else None)

    def save(self, directory: str | Path) -> Path:
        """Write run.nc and summary.json into a directory, and return it."""
        record.save(self.recorded, self.summary, Path(directory))
        return Path(directory)

    def __repr__(self) -> str:
        """Show the summary, an entry a line."""
        rows = summary_rows(self.summary)
        width = max((len(label) for label, _ in rows), default=0)
        return "\n".join(["Run", *(f"  {label:{width}}  {text}" for label, text in rows)])

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"


def run(
    scenario: Scenario,
    *,
    seed: int = 0,
    overrides: Iterable[str] = (),
    progress: bool | FrameCallback | None = None,
    processes: Literal["lock-step", "free-running"] | None = None,
    port: int | None = None,
    speed: float = 1.0,
) -> Run:
    """Fly a mission and check the run.

    The same seed and version give the same run. Ctrl-C, or a problem without a solution, ends
    the flight early: the run then holds what was flown, its attribute `complete` is 0, and
    `stopped` gives the reason.

    Args:
        scenario: Name of a built-in scenario, TOML file, mission, or dict with the keys of a
            file.
        seed: Random seed, from 0 to 2⁶⁴ − 1.
        overrides: Each "table.key=value"; not with a mission.
        progress: True shows a progress bar; a function is called with the drawn mission and
            each frame.
        processes: Fly each vehicle of a reconfiguration as a process of its own, in lock step or
            free running. In a script this stands below `if __name__ == "__main__":`.
        port: Port of the loopback interface by which processes talk; any that is free by default.
        speed: Factor by which processes that run freely are faster than the clock.

    Raises:
        ValueError: The scenario cannot be flown; nothing was.
    """
    began = perf_counter()
    overrides = overrides if isinstance(overrides, str) else tuple(overrides)
    # With matrices as small as these, the threads of BLAS only wait for each other.
    with threadpool_limits(1, user_api="blas"), announce_compilation(progress is True):
        mission, drawn, rng = _draw(scenario, seed, overrides)
        system, origin = load_system(mission.system), Origin.of(scenario, overrides)
        if processes is not None:
            from sato.processes.flight import as_processes, print_processes

            own = (print_processes,) if progress is True else ()
            system = as_processes(system, mission, int(seed), processes, port, speed, *own)
        for sentence in drawn.warnings():
            warnings.warn(sentence, stacklevel=2)
        callback = progress if callable(progress) else (lambda mission, frame: None)
        bar = show_mission_progress(system.progress) if progress is True else nullcontext(callback)
        with bar as callback:
            frames, stopped = _collect_frames(system, drawn, rng, callback)
        data = record.collect_run_data(
            system,
            frames,
            drawn,
            name=mission.name,
            seed=int(seed),
            version=version("sato-swarm"),
            wall_s=perf_counter() - began,
            peak_memory_mib=peak_memory_mib(),
            scenario=mission.to_toml(),
            origin=origin.to_json(),
            stopped=stopped,
        )
        return _add_check_results(Run(data, record.initial_summary(data.attrs), mission))


def simulate(scenario: Scenario, seed: int = 0, overrides: Iterable[str] = ()) -> Iterator[Frame]:
    """Fly a mission and yield its frames one by one.

    Args:
        scenario: Name of a built-in scenario, TOML file, mission, or dict with the keys of a
            file.
        seed: Random seed, from 0 to 2⁶⁴ − 1.
        overrides: Each "table.key=value"; not with a mission.

    Raises:
        ValueError: The scenario cannot be flown.
    """
    mission, drawn, rng = _draw(scenario, seed, overrides)
    frames = load_system(mission.system).simulate(drawn, rng)
    limited = ThreadpoolController().wrap(limits=1, user_api="blas")
    return iter(limited(lambda: next(frames, None)), None)


def load(path: str | Path, mission: Mission | None = None) -> Run:
    """Load a run from its folder, or from the run file itself.

    Args:
        path: Folder or file.
        mission: Mission that was flown; only needed where its model is of your own, for all
            others are in the file.

    Raises:
        RunFileError: The file is missing, damaged, not a run, or of another mission.
    """
    data, summary = record.load(Path(path))
    text = str(data.attrs["scenario"])
    if mission is not None:
        if mission.to_toml() != text:
            raise record.RunFileError(f"{path}: is a run of another mission than is given")
        return Run(data, summary, mission)
    try:
        return Run(data, summary, parse(text))
    except ScenarioError as error:
        if '[model]\nkind = "own"\n' in text:
            return Run(data, summary)
        reason = f"the scenario in the file cannot be read: {error}"
        raise record.RunFileError(f"{path}: {reason}") from error


def _draw(scenario: object, seed: Any, overrides: Iterable[str]) -> tuple[Any, Any, Generator]:
    is_integer = isinstance(seed, int | np.integer) and not isinstance(seed, bool)
    if not is_integer or not 0 <= seed < 2**64:
        raise InputError("seed", f"must be an integer from 0 to 2⁶⁴ − 1, got {format_value(seed)}")
    if isinstance(scenario, str | Path):
        mission = read(scenario, overrides)
    elif isinstance(scenario, Mapping):
        mission = from_dict(dict(scenario), overrides)
    elif not isinstance(scenario, Mission):
        got = f"an object of type {type(scenario).__name__}"
        raise InputError("scenario", f"must be a name, a path, a mission or a dict, got {got}")
    elif tuple(overrides):
        raise InputError("overrides", "cannot change a mission; dataclasses.replace can")
    else:
        mission = scenario
    rng = np.random.default_rng(seed)
    try:
        return mission, mission.draw(rng), rng
    except InputError as error:
        if isinstance(scenario, str | Path):
            raise ScenarioError(f"{scenario}: {error}") from error
        raise


def _add_check_results(run: Run) -> Run:
    summary = dict(run.summary)
    # Neither Ctrl-C nor a fault in a check may lose what was flown.
    try:
        report = run.check()
    except KeyboardInterrupt:
        pass
    except Exception as error:
        summary["check_failed"] = f"{type(error).__name__}: {error}"
        warnings.warn(f"the run could not be checked: {error}", stacklevel=3)
    else:
        summary |= report.summary
        summary["broken"] = [promise.name for promise in report.broken]
    return replace(run, summary=summary)


def _collect_frames(
    system: System[Any, Any], mission: Any, rng: Generator, callback: FrameCallback
) -> tuple[list[Any], str]:
    # Compiled code loses an exception that is raised in it by a signal, so the first Ctrl-C
    # waits for the next frame; a second one does not.
    interrupted = threading.Event()
    former = signal.getsignal(signal.SIGINT)
    is_main = threading.current_thread() is threading.main_thread()
    is_deferred = is_main and former is signal.default_int_handler

    def note(number: int, frame: object) -> None:
        interrupted.set()
        signal.signal(signal.SIGINT, former)

    frames: list[Any] = []
    endings: tuple[type[BaseException], ...] = (KeyboardInterrupt, *system.stop_errors)
    try:
        if is_deferred:
            signal.signal(signal.SIGINT, note)
        for frame in system.simulate(mission, rng):
            frames.append(frame)
            callback(mission, frame)
            if interrupted.is_set():
                raise KeyboardInterrupt
    except endings as error:
        if not frames:
            raise
        return frames, "interrupted" if isinstance(error, KeyboardInterrupt) else str(error)
    finally:
        if is_deferred:
            signal.signal(signal.SIGINT, former)
    return frames, ""
