"""Connectivity over many seeds, row by row: python scripts/study_connectivity.py [row …].

Every row is the built-in scenario with other numbers. Without names all rows are flown, each with
the seeds that stand beside it.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from sato.connectivity.mission import ConnectivityFlight
from sato.connectivity.trial import Trial, fly_trial
from sato.scenario import read


class Row(NamedTuple):
    """A way of flying."""

    seeds: int
    overrides: tuple[str, ...]


NEAR = ("stick.count=3", "stick.spacing_m=5.0")
BOX = ("swarm.start.box_m=[5.0, 5.0, 2.5]",)
DENSE = (*NEAR, *BOX, "obstacles.count=25", "stick.speed_m_s=2.9")
EXACT, POWER = ("estimator.kind=exact",), ("estimator.kind=power_pi",)
ROUGH = ("plant.lag_s=0.3", "noise.camera_m=0.05", "link.loss=0.1")
SLOW = ("limits.speed_m_s=1.0", "stick.speed_m_s=0.8")
ROWS = {
    "exact": Row(100, (*NEAR, *EXACT)),
    "flood": Row(100, NEAR),
    "exact-dense": Row(100, (*DENSE, *EXACT)),
    "flood-dense": Row(100, DENSE),
    "rough": Row(100, (*NEAR, *ROUGH)),
    "quadrotor": Row(50, (*NEAR, "plant.kind=quadrotor")),
    "occlusion": Row(50, (*NEAR, "camera.occlusion=true")),
    "power_pi": Row(50, (*NEAR, *POWER)),
    "power_pi-slow": Row(50, (*NEAR, *POWER, *SLOW)),
    "blind": Row(50, (*EXACT, "camera.blind=true")),
    "no-action": Row(20, ("potential.strength=0.0",)),
    "no-repulsion": Row(20, (*BOX, *NEAR, "obstacles.count=0", "repulsion.strength=0.0")),
    "printed-yaw": Row(100, (*NEAR, "tracking.printed=true")),
    "death": Row(100, (*NEAR, "death=[{}]")),
    "far": Row(100, ()),
    "far-exact": Row(100, EXACT),
    "fast": Row(20, ("stick.speed_m_s=5.0",)),
    "30": Row(20, ("swarm.agents=30",)),
    "100": Row(20, ("swarm.agents=100",)),
}


class Job(NamedTuple):
    """One flight."""

    row: str
    seed: int
    duration: float  # [s]


class Done(NamedTuple):
    """What came of it."""

    trial: Trial
    wall: float  # of flying [s]


def mission(job: Job) -> tuple[ConnectivityFlight, np.random.Generator]:
    """What is flown, and who draws on."""
    rng = np.random.default_rng(job.seed)
    settings = (*ROWS[job.row].overrides, f"run.duration_s={job.duration}")
    return read("connectivity", settings).build(rng), rng


def fly(job: Job) -> Done:
    """Fly one."""
    with threadpool_limits(1, user_api="blas"):
        flown, rng = mission(job)
        began = perf_counter()
        trial = fly_trial(flown, rng)
        return Done(trial, perf_counter() - began)


def table(found: dict[str, list[Done]], duration: float) -> Table:
    """A row for each way of flying."""
    names = ("", "kept", "least λ₂, median", "robots [m]", "obstacles [m]", "waypoints")
    names += ("|λ̂₂ − λ₂|", "yaw: mutual", "one-sided", "s of wall / s")
    shown = Table(*names)
    for name, done in found.items():
        trials = [d.trial for d in done]
        least = [t.lambda2 for t in trials]
        shown.add_row(
            name,
            f"{sum(t.kept for t in trials)} / {len(trials)}",
            f"{min(least):.3f}, {np.median(least):.2f}",
            f"{min(t.robots for t in trials):.2f}",
            f"{min(t.obstacles for t in trials):.2f}",
            " ".join(f"{k}: {sum(t.waypoints == k for t in trials)}" for k in counted(trials)),
            f"{mean([t.error for t in trials]):.5f}",
            f"{mean([t.mutual for t in trials]):.4f}",
            f"{mean([t.one_sided for t in trials]):.4f}",
            f"{np.mean([d.wall for d in done]) / duration:.3f}",
        )
    return shown


def counted(trials: Sequence[Trial]) -> list[int]:
    """Which numbers of waypoints were reached, the most first."""
    return sorted({t.waypoints for t in trials}, reverse=True)


def mean(values: Sequence[float]) -> float:
    """Of those that are known; NaN without any."""
    known = [v for v in values if np.isfinite(v)]
    return float(np.mean(known)) if known else np.nan


def losses(done: Sequence[Done]) -> list[str]:
    """A line for each flight that did not hang together throughout."""
    return [
        f"  seed {seed}: λ₂ ≤ λ₂^min at {d.trial.lost:.2f} s, least λ₃ − λ₂ in the second before "
        f"{d.trial.gap:.3f}"
        for seed, d in enumerate(done)
        if not d.trial.kept
    ]


def mourning(done: Sequence[Done]) -> str:
    """What became of the rest where a robot was lost."""
    longest = max(d.trial.counted for d in done)
    restless = max(d.trial.restless for d in done)
    return (
        f"  the dead were counted with for {longest:.2f} s at most; robots on their own for more "
        f"than 1 s asked for {restless:g} m/s or rad/s at most, with nothing near"
    )


def main() -> int:
    """Fly the rows that are asked for."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("rows", nargs="*", metavar="row", help=f"of {', '.join(ROWS)}")
    options.add_argument("--seeds", type=int, help="as many of each")
    options.add_argument("--duration", type=float, default=60.0, help="of a flight [s]")
    options.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    given = options.parse_args()
    unknown = [row for row in given.rows if row not in ROWS]
    if unknown:
        options.error(f"there is no row {unknown[0]}; there are {', '.join(ROWS)}")
    names = given.rows or list(ROWS)
    jobs = [
        Job(name, seed, given.duration)
        for name in names
        for seed in range(given.seeds or ROWS[name].seeds)
    ]
    console = Console(width=max(150, Console().width))
    found: dict[str, list[Done]] = {name: [] for name in names}
    for name in names:
        fly(Job(name, 0, 0.1))  # compiles
    began = perf_counter()
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        results = pool.map(fly, jobs)
        for job, done in track(
            zip(jobs, results, strict=True), "flying", len(jobs), console=console
        ):
            found[job.row].append(done)
    console.print(table(found, given.duration))
    for name, done in found.items():
        for line in losses(done):
            console.print(f"{name}{line}")
        if name == "death":
            console.print(f"{name}{mourning(done)}")
    console.print(f"{len(jobs)} flights in {perf_counter() - began:.0f} s on {given.workers} cores")
    return 0


if __name__ == "__main__":
    sys.exit(main())
