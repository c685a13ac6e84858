"""Overhead of campaigns, and memory of the parent: python scripts/benchmark_campaign.py.

The overhead is the time of the workers that no run used, over the time that runs took, in the
same campaign: of a run that sleeps 50 ms ± 10 %, and of `conflict`. The memory is that of the
parent over 10,000 rows. With --seeds, `uiuc` is flown with that many seeds by the workers, and then
one after another in this process. Numba's caches are filled before.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from time import perf_counter, sleep

import numpy as np

import sato
from sato.campaigns.definition import Campaign
from sato.campaigns.engine import fly_campaign
from sato.campaigns.table import open_table
from sato.campaigns.trial import run_trial

WORKERS, STUB_TIME = 2, 0.05  # [s]


def simulate_sleep(trial):
    """Sleep in place of a flight, and return a row of usual size."""
    began = perf_counter()
    sleep(STUB_TIME * np.random.default_rng(trial.seed).uniform(0.9, 1.1))
    return simulate_row(trial) | {"wall_s": perf_counter() - began}


def simulate_row(trial):
    """Return a row of usual size at once."""
    summary = {f"number_{k}": trial.seed / (k + 1) for k in range(20)}
    return {"exit": "reached", "error": None, "scenario": "x" * 2000, "summary": summary}


def resident_mib():
    """Return the memory of this process now (Linux) [MiB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


def measure(function, campaign):
    """Fly a campaign, and return its table's folder, and time and memory at its first rows and end.

    Returns:
        Folder, and (time since the start [s], memory [MiB]) by number of rows.
    """
    folder = Path(tempfile.mkdtemp(), "campaign")
    began, marks = perf_counter(), {}

    def note(exits, total):
        marks[sum(exits.values())] = perf_counter() - began, resident_mib()

    fly_campaign(campaign, folder, workers=WORKERS, function=function, progress=note)
    return folder, marks


def print_overhead(name, function, runs):
    """Measure one kind of run."""
    folder, marks = measure(function, Campaign(scenario="conflict", trials=runs))
    with open_table(folder) as table:
        busy = sum(row["wall_s"] for row in table.rows(["wall_s"]))
    end, first = marks[runs][0], marks[2 * WORKERS][0]
    # From the first rows on, all but their share of the work is left.
    steady = (end - first) * WORKERS / (busy * (1 - 2 * WORKERS / runs)) - 1
    whole = end * WORKERS / busy - 1
    print(
        f"{name}: {runs} runs of {1e3 * busy / runs:.1f} ms in {end:.1f} s with {WORKERS} workers:"
        f" overhead {100 * whole:.1f} %, {100 * steady:.1f} % after the first {2 * WORKERS} rows",
        flush=True,
    )


def print_speedup(seeds):
    """Fly seeds of `uiuc` by the workers, and one after another in this process."""
    sato.run("uiuc")
    campaign = Campaign(scenario="uiuc", trials=seeds)
    folder, marks = measure(run_trial, campaign)
    with open_table(folder) as table:
        times = [row["wall_s"] for row in table.rows(["row", "wall_s"])]
    rate = sum(times) / marks[seeds][0]
    print(f"uiuc: {seeds} seeds in {marks[seeds][0]:.1f} s with {WORKERS} workers", flush=True)
    began = perf_counter()
    for row in range(seeds):
        run_trial(campaign.trial(row))
        alone = perf_counter() - began
        factor = rate * alone / sum(times[: row + 1])
        print(f"the first {row + 1} in {alone:.1f} s in one process: {factor:.2f} times as long")


def main() -> int:
    """Print overheads, memory and the time of a status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--rows", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, default=0)
    given = parser.parse_args()
    if given.seeds:
        print_speedup(given.seeds)
        return 0
    sato.run("conflict")
    print_overhead("sleep", simulate_sleep, given.runs)
    print_overhead("conflict", run_trial, given.runs)
    folder, marks = measure(simulate_row, Campaign(scenario="conflict", trials=given.rows))
    growth = marks[given.rows][1] - marks[100][1]
    began = perf_counter()
    with open_table(folder) as table:
        exits = dict(table.exits())
    took, size = perf_counter() - began, (folder / "campaign.sqlite").stat().st_size
    print(
        f"{given.rows} rows in {marks[given.rows][0]:.1f} s: memory of the parent grows "
        f"{growth:.1f} MiB, status {exits} in {took:.3f} s, {size / 2**20:.1f} MiB of table"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
