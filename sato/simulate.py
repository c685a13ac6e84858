"""From a scenario to a run: draw, fly, judge."""

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from sato.former import ScenarioFile, read
from sato.interfaces import FrameT, MissionT, System
from sato.record import Run
from sato.resource_usage import peak_memory_mib
from sato.scenario.mission import Mission
from sato.systems import load_system

FrameCallback = Callable[[Any, Any], object]  # of the mission and a frame


def run(
    scenario: str | Path | ScenarioFile,
    *,
    seed: int = 0,
    overrides: Iterable[str] = (),
    progress: FrameCallback | None = None,
) -> Run:
    """Fly a scenario and judge what came of it.

    The same seed and version give the same run. Ctrl-C, or a programme without an answer,
    ends the flight early: the run then holds what was flown, its attribute `complete` is 0,
    and `stopped` says why.

    Args:
        scenario: A built-in name, a TOML file, or what `read` made of one.
        seed: Of everything that is drawn.
        overrides: Each "table.key=value"; only with a name or a file.
        progress: Called with the mission and each frame.

    Warns:
        BeyondValidity: The model is wrong where the swarm flies, see `sato.former.validity`.

    Raises:
        ScenarioError: The scenario cannot be flown; nothing was.
    """
    if seed < 0:
        raise ValueError(f"a seed must not be negative, got {seed}")
    if isinstance(scenario, ScenarioFile | Mission):
        if tuple(overrides):
            raise ValueError("overrides go with the name of a scenario, not with one already read")
    else:
        scenario = read(scenario, overrides)
    flies = load_system(scenario.system)
    began = perf_counter()
    # On matrices as small as these, threads of BLAS only wait for each other.
    with threadpool_limits(1, user_api="blas"):
        rng = np.random.default_rng(seed)
        mission = scenario.build(rng)
        scenario.warn(mission)
        frames, stopped = _collect_frames(flies, mission, rng, progress)
        flown = Run.from_frames(
            flies,
            frames,
            mission,
            scenario.to_toml(),
            name=scenario.name,
            seed=seed,
            version=version("sato-swarm"),
            wall_s=perf_counter() - began,
            peak_memory_mib=peak_memory_mib(),
            stopped=stopped,
        )
        return add_check_results(flown)


def add_check_results(run: Run) -> Run:
    """The run with all that can be said of it in its summary."""
    summary = dict(run.summary)
    # Who stops the flight may stop the judging too, and still keeps what was flown.
    with suppress(KeyboardInterrupt):
        report = run.check()
        summary |= report.summary
        summary["broken"] = [promise.name for promise in report.promises if not promise.kept]
    return replace(run, summary=summary)


def _collect_frames(
    system: System[MissionT, FrameT],
    mission: MissionT,
    rng: np.random.Generator,
    progress: FrameCallback | None,
) -> tuple[list[FrameT], str]:
    frames: list[FrameT] = []
    try:
        with _defer_interrupt() as asked:
            for frame in system.simulate(mission, rng):
                frames.append(frame)
                if progress is not None:
                    progress(mission, frame)
                if asked.is_set():
                    return frames, "interrupted"
    except KeyboardInterrupt:
        if not frames:
            raise
        return frames, "interrupted"
    except system.stop_errors as error:
        if not frames:
            raise
        return frames, str(error)
    return frames, ""


@contextmanager
def _defer_interrupt() -> Iterator[threading.Event]:
    # Compiled code cannot pass on an interruption that finds it at work, so the first Ctrl-C
    # waits for the next instant; a second one does not.
    asked = threading.Event()
    former = signal.getsignal(signal.SIGINT)
    here = threading.current_thread() is threading.main_thread()
    if not here or former is not signal.default_int_handler:
        yield asked
        return

    def note(number: int, frame: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, former)

    signal.signal(signal.SIGINT, note)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, former)
