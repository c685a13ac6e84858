"""Runs: missions flown, saved, loaded, checked and shown."""

import re
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.random import Generator
from threadpoolctl import ThreadpoolController, threadpool_limits

from dynamics.callbacks import CallbackError, as_kind, is_own, is_strict, strictly
from dynamics.doors import checked
from sato import frames as flight_frames
from sato import record
from sato.check.common import EventLog
from sato.check.report import Promise, Report, Verdict
from sato.compilation import announce_compilation
from sato.console import show_mission_progress
from sato.damage import EVENTS, find_damage
from sato.interfaces import Frame, System
from sato.resource_usage import peak_memory_mib
from sato.run_data import RunData
from sato.scenario.definition import Seed
from sato.scenario.errors import InputError, ScenarioError, join_names
from sato.scenario.file import NO_MISSION, Mission, describe_own, from_dict, parse_embedded, read
from sato.scenario.origin import Origin
from sato.scenario.overrides import Setting, Settings, list_settings
from sato.summary import summary_rows
from sato.systems import load_system
from sato.terminal import as_html

if TYPE_CHECKING:  # slow to import
    import matplotlib.figure
    import xarray

    from sato.scene import SwarmScene

# Earlier versions wrote neither the classes of models nor plants of the user's own.
_UNNAMED = re.compile(
    r'(\[model\]\nkind = "own"\n)class = .*\n|\[plant\]\nkind = "own"\nclass = .*\n\n?'
)
Scenario = str | Path | Mission | Mapping[str, Any]
FrameCallback = Callable[[Any, Any], object]  # of the drawn mission and a frame


@checked
@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """Mission that was flown: its data, its summary, and the mission itself.

    Args:
        recorded: Arrays and attributes of the run file.
        claimed: Entries of `summary.json`, which the check compares with the data.
        mission: Not drawn; None where a file names a model, say, of the user's own.

    Raises:
        RunFileError: The data are not those of a run.
    """

    recorded: RunData
    claimed: Mapping[str, Any]
    mission: Mission | None = None

    def __post_init__(self) -> None:
        """Refuse data that are not those of a run."""
        record.check_format("recorded", self.recorded)

    @cached_property
    def data(self) -> "xarray.Dataset":
        """Data of the run as an xarray dataset, in which no change changes the run."""
        return self.recorded.to_xarray().copy(deep=True)

    @cached_property
    def drawn_mission(self) -> Any:
        """Mission with all random numbers drawn, as it was flown.

        Raises:
            RunFileError: The run was loaded without its mission, parts of which no file can hold.
        """
        if self.mission is None:
            scenario = str(self.recorded.attrs["scenario"])
            raise record.RunFileError(describe_own(scenario) or NO_MISSION)
        return self.mission.draw(np.random.default_rng(int(self.recorded.attrs["seed"])))

    @property
    def _readable_mission(self) -> Any:
        self._refuse_damage(self.drawn_mission)
        return self.drawn_mission

    def _refuse_damage(self, drawn: Any | None) -> None:
        if damage := find_damage(self.recorded, drawn):
            raise record.RunFileError(f"the record is damaged: {damage}")

    def events(self, *kinds: str) -> list[dict[str, Any]]:
        """Return the events in the order of time; of the given kinds only, if any.

        Raises:
            InputError: No run of this system has such a kind.
        """
        known = EVENTS.get(self.recorded.attrs["system"], kinds)
        if unknown := set(kinds).difference(known):
            names = join_names(sorted(known))
            raise InputError("kinds", f"{unknown.pop()!r} is no kind of event; {names} would do")
        log = EventLog.from_data(self.recorded)
        return [event for event in log.events if not kinds or event["kind"] in kinds]

    def check(self) -> Report:
        """Check the run by recomputing what its data and its summary say."""
        from sato.verify import verify_run

        return verify_run(self.recorded, self.mission, self.claimed)

    @cached_property
    def report(self) -> Report:
        """Report of the first check; one that failed says so, and is never a success."""
        try:
            return self.check()
        except record.RunFileError as error:
            return Report((Promise("file", False, 1.0, 0.0, str(error)),), {})
        except Exception as error:
            if is_strict.get():
                raise
            return Report((), {}, failure=f"{type(error).__name__}: {error}")

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Entries of `summary.json`, recomputed by `report`; never those that a file claims.

        Without the mission, entries that need it are claimed ones, but for success and verdict.
        What a caller writes into it is saved with the run, and is no more than a claim there.
        """
        first = record.initial_summary(self.recorded.attrs)
        claimed = self.claimed if self.mission is None else {}
        return {**claimed, **first, **self.report.entries}

    @property
    def verdict(self) -> Verdict:
        """Verdict of `report`: "kept", "not reached", "broken" or "unchecked"."""
        return self.report.verdict

    def figures(self) -> dict[str, "matplotlib.figure.Figure"]:
        """Draw the figures of the run, by name."""
        from sato.render import draw_figures

        return draw_figures(self.recorded, self._readable_mission)

    def plot(self, directory: str | Path, pdf: bool = False) -> list[Path]:
        """Write the figures of the run as PNG, or PDF, in place of figures of earlier runs."""
        from sato.render import write_figures

        digest = self.recorded.attrs.get("digest", "")
        return write_figures(self.figures(), Path(directory), pdf, digest)

    def animate(
        self,
        directory: str | Path,
        fps: Annotated[int, Gt(0), Le(1000)] = 20,
        frames: Annotated[int, Gt(0)] = record.MAX_FRAMES,
        progress: Callable[[int, int], object] | None = None,
    ) -> Path:
        """Write an animation of the run, as `sato.render.animate` does."""
        from sato.render import animate

        digest = self.recorded.attrs.get("digest", "")
        return animate(self.scene(), Path(directory), digest, fps, frames, progress)

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
        report, scene = self.report, system.scene(self.recorded, self._readable_mission)
        located = (p for p in report.broken if p.agents and np.isfinite(p.time or 0.0))
        return replace(scene, verdict=report.line, broken=tuple(located))

    def player(self, path: str | Path) -> Path:
        """Write the run as one HTML file, which plays it in a browser without a network."""
        from sato.player import write_player

        return write_player(self.scene(), self.recorded.attrs, Path(path))

    def export(self, path: str | Path, format: str = "oem") -> Path:
        """Write the trajectories for other tools, see `sato.export`."""
        from sato.export import export

        self._refuse_damage(None)
        return export(self.recorded, path, format, self.scene if format == "rrd" else None)

    def save(self, directory: str | Path) -> Path:
        """Write run.nc and summary.json into a directory, and return it."""
        record.save(self.recorded, self.summary, Path(directory))
        return Path(directory)

    def __repr__(self) -> str:
        """Show the verdict, and the summary, an entry a line."""
        rows = summary_rows(self.summary)
        width = max((len(label) for label, _ in rows), default=0)
        lines = (f"  {label:{width}}  {text}" for label, text in rows)
        return "\n".join([self.report.line, *lines])

    def _repr_html_(self) -> str:
        return f"<pre>{as_html(repr(self))}</pre>"


@checked
def run(
    scenario: Scenario,
    *,
    seed: Seed = 0,
    overrides: Settings = (),
    progress: bool | FrameCallback | None = None,
    strict: bool = False,
    processes: Literal["lock-step", "free-running"] | None = None,
    port: Annotated[int, Gt(0), Lt(2**16)] | None = None,
    speed: Annotated[float, Ge(1e-3), Le(1e3)] = 1.0,
) -> Run:
    """Fly a mission and check the run.

    The same seed and version give the same run. Ctrl-C, or a problem without a solution, ends
    the flight early: the run then holds what was flown, its attribute `complete` is 0, and
    `stopped` gives the reason.

    Args:
        scenario: Name of a built-in scenario, TOML file, mission, or dict with the keys of a
            file.
        seed: Random seed, from 0 to 2⁶⁴ − 1.
        overrides: Each "table.key=value", or a pair of key and value, or a dict of these; not
            with a mission.
        progress: True shows a progress bar; a function is called with the drawn mission and
            each frame.
        strict: Raise exceptions of functions of your own as they are: of models, plants, solvers,
            systems and `progress`. By default those of a model, a plant or a system end the flight,
            and those of a solver or of `progress` are counted; the first is shown.
        processes: Fly each vehicle of a reconfiguration as a process of its own, in lock step or
            free running. In a script this stands below `if __name__ == "__main__":`.
        port: Port of the loopback interface by which processes talk; by default they do by a
            socket that no other user can open.
        speed: Factor by which processes that run freely are faster than the clock.

    Raises:
        ValueError: The scenario cannot be flown; nothing was.
    """
    began = perf_counter()
    if processes is None and (port is not None or speed != 1):
        reason = 'is of processes; processes = "free-running", or --free-running, would do'
        raise InputError("speed" if port is None else "port", reason)
    overrides = list_settings(overrides)
    # With matrices as small as these, the threads of BLAS only wait for each other.
    quiet_blas = threadpool_limits(1, user_api="blas")
    with quiet_blas, announce_compilation(progress is True), strictly(strict):
        mission, drawn, rng = _draw(scenario, seed, overrides)
        system, origin = load_system(mission.system), Origin.of(scenario, overrides)
        if processes is not None:
            from sato.processes.flight import as_processes, print_processes

            own = (print_processes,) if progress is True else ()
            system = as_processes(system, mission, int(seed), processes, port, speed, *own)
        for sentence in drawn.warnings():
            warnings.warn(sentence, stacklevel=3)
        callback: FrameCallback = progress if callable(progress) else (lambda mission, frame: None)
        bar = show_mission_progress(system.progress) if progress is True else nullcontext(callback)
        with flight_frames.watching(callback) if is_own(callback) else bar as callback:
            frames, stopped = _collect_frames(system, drawn, rng, callback, strict)
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
        flown = Run(data, record.initial_summary(data.attrs), mission)
        # Neither Ctrl-C nor a fault in a check may lose what was flown.
        try:
            if failure := flown.report.failure:
                warnings.warn(f"the run could not be checked: {failure}", stacklevel=3)
        except KeyboardInterrupt:
            vars(flown)["report"] = Report((), {}, failure="interrupted")
        return flown


@checked
def simulate(scenario: Scenario, seed: Seed = 0, overrides: Settings = ()) -> Iterator[Frame]:
    """Fly a mission and yield its frames one by one.

    Args:
        scenario: As of `run`, and so are the others.
        seed: Random seed.
        overrides: Changes of the scenario.

    Raises:
        ValueError: The scenario cannot be flown.
    """
    mission, drawn, rng = _draw(scenario, seed, list_settings(overrides))
    frames = flight_frames.fly(load_system(mission.system), drawn, rng)
    limited = ThreadpoolController().wrap(limits=1, user_api="blas")
    return iter(limited(lambda: next(frames, None)), None)


@checked
def load(path: str | Path, mission: Mission | None = None) -> Run:
    """Load a run from its folder, or from the run file itself.

    Args:
        path: Folder or file.
        mission: Mission that was flown; only needed where its model, its plant or another part is
            of your own, for all others are in the file.

    Raises:
        RunFileError: The file is missing, damaged, not a run, or of another mission.
    """
    data, summary = record.load(Path(path))
    text = str(data.attrs["scenario"])
    if mission is not None:
        given = mission.to_toml()
        if text not in (given, _UNNAMED.sub(r"\1", given)):
            raise record.RunFileError(f"{path}: is a run of another mission than is given")
        return Run(data, summary, mission)
    try:
        return Run(data, summary, parse_embedded(text))
    except ScenarioError as error:
        with suppress(ScenarioError):  # of text that is no TOML
            if describe_own(text):
                return Run(data, summary)
        reason = f"the scenario in the file cannot be read: {error}"
        raise record.RunFileError(f"{path}: {reason}") from error


def _draw(
    scenario: Scenario, seed: Any, overrides: tuple[Setting, ...]
) -> tuple[Any, Any, Generator]:
    if isinstance(scenario, str | Path):
        mission = read(scenario, overrides)
    elif isinstance(scenario, Mapping):
        mission = from_dict(dict(scenario), overrides)
    elif overrides:
        raise InputError("overrides", "cannot change a mission; dataclasses.replace can")
    else:
        mission = scenario
    rng = np.random.default_rng(seed)
    try:
        kind = type(mission)
        drawn = as_kind(mission.draw(rng), kind, f"a mission of {kind.__name__}.draw")
        return mission.without_files(), drawn, rng  # as they are now
    except InputError as error:
        if isinstance(scenario, str | Path):
            raise ScenarioError(f"{scenario}: {error}") from error
        raise


def _collect_frames(
    system: System[Any, Any],
    mission: Any,
    rng: Generator,
    callback: FrameCallback,
    is_strict: bool,
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
    endings = endings if is_strict else (*endings, CallbackError)
    try:
        if is_deferred:
            signal.signal(signal.SIGINT, note)
        for frame in flight_frames.fly(system, mission, rng):
            frames.append(frame)
            callback(mission, frame)
            if interrupted.is_set():
                raise KeyboardInterrupt
    except (Exception, KeyboardInterrupt) as error:
        if not frames or (is_strict and not isinstance(error, endings)):
            raise
        if isinstance(error, KeyboardInterrupt):
            return frames, "interrupted"
        fault = f"a fault of the program: {type(error).__name__}: {error}"
        return frames, str(error) if isinstance(error, endings) else fault
    finally:
        if is_deferred:
            signal.signal(signal.SIGINT, former)
    return frames, ""
