"""Functions of a trial that fly nothing, for tests of campaigns; and a parent to be killed."""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

import sato
from sato.campaigns.definition import Campaign
from sato.campaigns.engine import fly_campaign
from sato.campaigns.trial import run_trial

TRIALS = 40


def count(trial):
    """Return a row at once."""
    summary = {"seed": trial.seed, "half": trial.seed / 2, "legs": [{"steps": trial.row}]}
    return {"exit": "reached", "error": None, "scenario": f"row {trial.row}", "summary": summary}


def die(trial):
    """End the process at one row, and take too long at another."""
    if trial.row == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if trial.row == 5:
        time.sleep(1000)
    return count(trial)


def import_nothing(trial):
    """Fly a trial with a function that is nowhere."""
    return run_trial(trial._replace(columns="nowhere:f"))


def campaign(**changes):
    """Define a campaign of which nothing is flown."""
    return Campaign(**{"scenario": "conflict", "trials": TRIALS} | changes)


def more_columns(run):
    """Add columns to a run, but for one seed."""
    if run.summary["seed"] == 1:
        raise KeyError("no such thing")
    return {"instants": run.data.sizes["time"]}


if __name__ == "__main__":
    fly_campaign(
        campaign(),
        Path(sys.argv[1]),
        workers=2,
        function=count,
        progress=lambda exits, runs: print(sum(exits.values()), flush=True),
    )


def count_agents(agents):
    """Compute a row without random numbers, which no campaign can call."""
    return {"count": agents}


def toss(rng, sides, fails=False):
    """Compute a row without a run."""
    if fails:
        raise ZeroDivisionError("as asked")
    thrown = int(rng.integers(sides))
    return {"thrown": thrown, "is_first": thrown == 0}


class Gusty(sato.Plant):
    """Double integrators that overshoot."""

    def propagate(self, x, u, t, dt, substeps=1):
        """Step with more thrust than was asked for."""
        return sato.LinearPlant(sato.DoubleIntegrator(2)).propagate(x, 1.05 * u, t, dt, substeps)


def draw_gusty(rng):
    """Draw a mission with a plant of its own, which no file holds."""
    start = 2.0 * np.c_[np.arange(2), np.zeros(2)]
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(2),
        plant=Gusty(),
        start=start,
        legs=[sato.Leg(start + rng.uniform(1, 2), steps=12)],
        step=1.0,
        comm_radius=20.0,
        collision_radius=0.5,
        max_control=0.3,
        max_speed=1.0,
    )
