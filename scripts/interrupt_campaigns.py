"""Kill campaigns at random instants, and resume them: python scripts/interrupt_campaigns.py.

Workers, parents and schedulers are ended by kill -9, of processes here and of a Dask cluster on
loopback. Exit code 1 where a resumed table differs from an undisturbed one in more than wall
time, memory, worker, attempts and order, or SQLite finds it damaged.
"""

import argparse
import json
import os
import signal
import sqlite3
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, sleep

import numpy as np
import psutil

from sato.campaigns.definition import Campaign
from sato.campaigns.engine import fly_campaign
from sato.campaigns.table import MEASURED, TABLE_FILE, open_table

TRIALS, DURATION = 150, 0.03  # of a run [s]
KINDS = [(place, who) for place in ("here", "Dask") for who in ("worker", "parent", "scheduler")]
KINDS.remove(("here", "scheduler"))
ENVIRONMENT = os.environ | {
    "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), str(Path(__file__).parents[1])])
}
WAIT = 120.0  # for a campaign to end [s]


def simulate_run(trial):
    """Return a row that follows from its trial, after some time."""
    rng = np.random.default_rng(trial.seed)
    sleep(DURATION * rng.uniform(0.5, 1.5))
    summary = {"cost": rng.normal(), "legs": rng.integers(9, size=3)}
    return {"exit": "reached", "error": None, "scenario": f"{trial.parameters}", "summary": summary}


def fly(folder, scheduler=None, resume=False):
    """Fly the campaign in this process."""
    grid = {"plan.horizon_steps": [1, 2]}
    campaign = Campaign(scenario="conflict", trials=TRIALS // 2, grid=grid)
    place = {"workers": 2} if scheduler is None else {"scheduler": scheduler}
    fly_campaign(campaign, folder, resume=resume, function=simulate_run, **place)


def start_parent(folder, scheduler):
    """Start a process that flies the campaign, or resumes it."""
    words = [sys.executable, __file__, "--fly", str(folder)]
    words += ["--scheduler", scheduler] if scheduler else []
    return subprocess.Popen(words, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)


@contextmanager
def cluster(home, workers=2):
    """Start a scheduler, and workers that are restarted by their nannies."""
    file, logs = home / "scheduler.json", subprocess.DEVNULL
    file.unlink(missing_ok=True)
    started = []

    def start(name, *words):
        command = [sys.executable, "-m", f"distributed.cli.dask_{name}"]
        command += ["--scheduler-file", str(file), *words]
        process = subprocess.Popen(command, cwd=home, env=ENVIRONMENT, stdout=logs, stderr=logs)
        started.append(process)
        return process

    try:
        scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        while not file.exists():
            sleep(0.1)
        sleep(0.3)
        for _ in range(workers):
            start("worker", "--nthreads", "1", "--no-dashboard", "--death-timeout", "60")
        yield scheduler, started[1:], json.loads(file.read_text())["address"]
    finally:
        for process in started:
            for child in children(process.pid):
                child.kill()
            process.kill()
            process.wait()


def children(pid):
    """List the processes that a process started, and those that these started."""
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []


def leaves(pid):
    """List the processes below a process that have none below them."""
    return [child for child in children(pid) if not children(child.pid)]


def rows(folder):
    """Read what a resumed table must have in common with an undisturbed one."""
    with open_table(folder) as table:
        return [{k: v for k, v in row.items() if k not in MEASURED} for row in table.rows()]


def count_rows(folder):
    """Count the rows of a table that may not be there yet."""
    try:
        with open_table(folder) as table:
            return len(table)
    except (ValueError, RuntimeError):
        return 0


def is_sound(folder):
    """Let SQLite check a table."""
    connection = sqlite3.connect(folder / TABLE_FILE)
    found = connection.execute("PRAGMA integrity_check").fetchone()
    connection.close()
    return found == ("ok",)


def interrupt(place, who, folder, home, rng):
    """Kill one process of a campaign at a random instant, and resume until all rows are there."""
    instant, victims = rng.uniform(0, 1), []
    while True:
        if place == "here":
            end = _fly_and_kill(None, who, folder, instant, victims, rng)
        else:
            with cluster(home) as processes:
                end = _fly_and_kill(processes, who, folder, instant, victims, rng)
        if end == 0:
            return victims[0]


def _fly_and_kill(processes, who, folder, instant, victims, rng):
    parent = start_parent(folder, processes and processes[2])
    began = perf_counter()
    # Somewhere between the first row and the last, or before the first.
    while not victims and parent.poll() is None and perf_counter() - began < WAIT:
        done = count_rows(folder)
        if done >= instant * TRIALS * 0.9:
            sleep(rng.uniform(0, 2 * DURATION))
            if who == "worker":
                owners = [parent] if processes is None else processes[1]
                found = [child for owner in owners for child in leaves(owner.pid)]
                if not found:
                    continue
                victim = found[rng.integers(len(found))]
            else:
                victim = psutil.Process((parent if who == "parent" else processes[0]).pid)
            victims.append(done)
            victim.send_signal(signal.SIGKILL)
    try:
        said = parent.communicate(timeout=WAIT)[1]
    except subprocess.TimeoutExpired:
        parent.kill()
        raise RuntimeError(f"the parent hangs after the end of the {who}") from None
    if parent.returncode not in (0, -signal.SIGKILL) and "--resume" not in said:
        raise RuntimeError(f"the parent ended after the end of the {who}: {said[-1500:]}")
    return parent.returncode


def main() -> int:
    """Kill campaigns, and compare their tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=["here", "Dask"])
    parser.add_argument("--fly", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--scheduler", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.fly is not None:
        fly(given.fly, given.scheduler, resume=True)
        return 0
    rng, faults = np.random.default_rng(given.seed), 0
    home = Path(tempfile.mkdtemp())
    fly(home / "undisturbed")
    expected = rows(home / "undisturbed")
    kinds = [kind for kind in KINDS if given.only in (None, kind[0])]
    for number in range(given.times):
        place, who = kinds[number % len(kinds)]
        folder = home / str(number)
        done = interrupt(place, who, folder, home, rng)
        with open_table(folder) as table:
            died = table.exits()["died"]
        if died:  # recorded, and flown again when the campaign is resumed
            fly(folder, resume=True)
        is_equal = rows(folder) == expected and is_sound(folder)
        faults += not is_equal
        end = "equal" if is_equal else "DIFFERENT"
        print(f"{place}, {who} killed at {done} of {TRIALS} rows, {died} died: {end}", flush=True)
    print(f"{given.times - faults} of {given.times} resumed tables equal the undisturbed one")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
