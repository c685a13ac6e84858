"""Connectivity over many seeds, row by row: python scripts/study_connectivity.py [row …].

Every row is the built-in scenario with other numbers. Without names all rows are flown, each with
the seeds that stand beside it.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from time import perf_counter
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from sato.connectivity.mission import Connectivity
from sato.connectivity.trial import ConnectivityTrial, run_trial
from sato.scenario.file import read


class CampaignRow(NamedTuple):
    """Configuration of a row."""

    seeds: int
    overrides: tuple[str, ...]


CLOSE_WAYPOINTS = ("stick.count=3", "stick.spacing_m=5.0")
SMALL_START_BOX = ("swarm.start.box_m=[5.0, 5.0, 2.5]",)
DENSE = (*CLOSE_WAYPOINTS, *SMALL_START_BOX, "obstacles.count=25", "stick.speed_m_s=2.9")
EXACT, POWER = ("estimator.kind=exact",), ("estimator.kind=power_pi",)
DISTURBED = ("plant.lag_s=0.3", "noise.camera_m=0.05", "link.loss=0.1")
SLOW = ("limits.speed_m_s=1.0", "stick.speed_m_s=0.8")
ROWS = {
    "exact": CampaignRow(100, (*CLOSE_WAYPOINTS, *EXACT)),
    "flood": CampaignRow(100, CLOSE_WAYPOINTS),
    "exact-dense": CampaignRow(100, (*DENSE, *EXACT)),
    "flood-dense": CampaignRow(100, DENSE),
    "rough": CampaignRow(100, (*CLOSE_WAYPOINTS, *DISTURBED)),
    "quadrotor": CampaignRow(50, (*CLOSE_WAYPOINTS, "plant.kind=quadrotor")),
    "occlusion": CampaignRow(50, (*CLOSE_WAYPOINTS, "camera.occlusion=true")),
    "power_pi": CampaignRow(50, (*CLOSE_WAYPOINTS, *POWER)),
    "power_pi-slow": CampaignRow(50, (*CLOSE_WAYPOINTS, *POWER, *SLOW)),
    "blind": CampaignRow(50, (*EXACT, "camera.blind=true")),
    "no-action": CampaignRow(20, ("potential.strength=0.0",)),
    "no-repulsion": CampaignRow(
        20, (*SMALL_START_BOX, *CLOSE_WAYPOINTS, "obstacles.count=0", "repulsion.strength=0.0")
    ),
    "printed-yaw": CampaignRow(100, (*CLOSE_WAYPOINTS, "tracking.printed=true")),
    "death": CampaignRow(100, (*CLOSE_WAYPOINTS, "death=[{}]")),
    "far": CampaignRow(100, ()),
    "far-exact": CampaignRow(100, EXACT),
    "fast": CampaignRow(20, ("stick.speed_m_s=5.0",)),
    "30": CampaignRow(20, ("swarm.agents=30",)),
    "100": CampaignRow(20, ("swarm.agents=100",)),
}


class TrialJob(NamedTuple):
    """Parameters of a flight."""

    row: str
    seed: int
    duration: float  # [s]


class TimedTrial(NamedTuple):
    """Result of a flight, with its wall time."""

    trial: ConnectivityTrial
    wall_seconds: float  # of flying [s]


def build_mission(job: TrialJob) -> tuple[Connectivity, np.random.Generator]:
    """Build the mission, and return it with its random generator."""
    rng = np.random.default_rng(job.seed)
    settings = (*ROWS[job.row].overrides, f"run.duration_s={job.duration}")
    return read("connectivity", settings).draw(rng), rng


def run_job(job: TrialJob) -> TimedTrial:
    """Simulate one flight."""
    with threadpool_limits(1, user_api="blas"):
        flown, rng = build_mission(job)
        began = perf_counter()
        trial = run_trial(flown, rng)
        return TimedTrial(trial, perf_counter() - began)


def make_table(found: dict[str, list[TimedTrial]], duration: float) -> Table:
    """Tabulate the results, with a row for each configuration."""
    names = ("", "kept", "least λ₂, median", "robots [m]", "obstacles [m]", "waypoints")
    names += ("|λ̂₂ − λ₂|", "yaw: mutual", "one-sided", "s of wall / s")
    shown = Table(*names)
    for name, done in found.items():
        trials = [d.trial for d in done]
        column = partial(summary_column, trials)
        least, reached = column("lambda2_min"), column("waypoints_reached")
        shown.add_row(
            name,
            f"{sum(t.stayed_connected for t in trials)} / {len(trials)}",
            f"{min(least):.3f}, {np.median(least):.2f}",
            f"{min(column('min_separation_m')):.2f}",
            f"{min(column('min_obstacle_distance_m')):.2f}",
            " ".join(f"{k:.0f}: {reached.count(k)}" for k in sorted(set(reached), reverse=True)),
            f"{finite_mean(column('lambda2_error_mean')):.5f}",
            f"{finite_mean(column('yaw_error_mutual')):.4f}",
            f"{finite_mean(column('yaw_error_one_sided')):.4f}",
            f"{np.mean([d.wall_seconds for d in done]) / duration:.3f}",
        )
    return shown


def summary_column(trials: Sequence[ConnectivityTrial], name: str) -> list[float]:
    """Collect an entry of all summaries; NaN where it is absent."""
    return [trial.summary.get(name, np.nan) for trial in trials]


def finite_mean(values: Sequence[float]) -> float:
    """Return the mean of the finite values; NaN if there are none."""
    known = [v for v in values if np.isfinite(v)]
    return float(np.mean(known)) if known else np.nan


def describe_disconnections(done: Sequence[TimedTrial]) -> list[str]:
    """Describe each flight that lost connectivity, in a line each."""
    return [
        f"  seed {seed}: λ₂ ≤ λ₂^min at {d.trial.disconnection_time:.2f} s, "
        f"least λ₃ − λ₂ in the second before {d.trial.min_eigenvalue_gap:.3f}"
        for seed, d in enumerate(done)
        if not d.trial.stayed_connected
    ]


def describe_lost_robots(done: Sequence[TimedTrial]) -> str:
    """Describe the behavior of the remaining robots after losses."""
    longest = max(d.trial.max_forget_time for d in done)
    restless = max(d.trial.max_idle_command for d in done)
    return (
        f"  the dead were counted with for {longest:.2f} s at most; robots on their own for more "
        f"than 1 s asked for {restless:g} m/s or rad/s at most, with nothing near"
    )


def main() -> int:
    """Simulate the requested rows and print the table."""
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
        TrialJob(name, seed, given.duration)
        for name in names
        for seed in range(given.seeds or ROWS[name].seeds)
    ]
    console = Console(width=max(150, Console().width))
    found: dict[str, list[TimedTrial]] = {name: [] for name in names}
    began = perf_counter()
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        results = pool.map(run_job, jobs)
        for job, done in track(
            zip(jobs, results, strict=True), "flying", len(jobs), console=console
        ):
            found[job.row].append(done)
    console.print(make_table(found, given.duration))
    for name, done in found.items():
        for line in describe_disconnections(done):
            console.print(f"{name}{line}")
        if name == "death":
            console.print(f"{name}{describe_lost_robots(done)}")
    console.print(f"{len(jobs)} flights in {perf_counter() - began:.0f} s on {given.workers} cores")
    return 0


if __name__ == "__main__":
    sys.exit(main())
