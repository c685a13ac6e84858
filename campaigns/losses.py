"""Judge what a loss of all thrust would do: drifts from each step, by equations of its own.

From each recorded state of each vehicle on, `motion.py` integrates two orbits of free motion; the
others fly as recorded, and freely after the end. Between samples, 5 s apart at most, two vehicles
move past each other on a line, but for a few centimeters.
"""

import json
import tomllib
from math import ceil
from typing import Any

import numpy as np
import xarray as xr
from judge import Flight, judge
from motion import Motion
from numpy import ndarray as Array

ORBITS = 2.0  # of drift, where the mission does not say how long
THRUST = 1e-6  # of the largest control: less is none
BEND = 0.05  # by which a path between two samples may differ from a line [m]


def judge_run(run: Any) -> dict[str, Any]:
    """Judge a run of a campaign, and its drifts."""
    return {"judged": judge(run.data), "drifts": judge_drifts(run.data)}


def judge_drifts(data: xr.Dataset, distance: float = 50.0) -> dict[str, Any]:
    """Return how near vehicles drift to others that fly on, and how often nearer than a distance.

    Losses of a vehicle before its first thrust change nothing, and are counted apart. So are those
    up to the last step at which others changed what they fly: they would have flown otherwise.
    """
    flight = Flight.from_dataset(data)
    motion = Motion.from_dataset(data, flight.scenario)
    plan = tomllib.loads(data.attrs["scenario"])["plan"]
    period = 2 * np.pi / _mean_rate(motion)
    duration = plan.get("passive_safety_s", ORBITS * period)
    path = motion.sample(flight.state[:-1], flight.applied)
    steps, samples = len(path), path.shape[1] - 1
    h = motion.step / samples
    count = ceil(duration / h)
    # The time of a loss is a multiple of h, so all samples of drifts and plans are at equal times.
    times = np.arange(count + 1) * h
    drifts = motion.drift(flight.state[:-1], times)
    after = motion.drift(flight.state[-1:], times, steps)[0, :, :, :3]
    planned = np.concatenate([path[:, :-1, :, :3].reshape(steps * samples, -1, 3), after])
    least = np.full((steps, flight.state.shape[1], flight.state.shape[1]), np.inf)
    for k in range(steps):
        flown = planned[k * samples : k * samples + count + 1]
        relative = drifts[k, :, :, None, :3] - flown[:, None]
        least[k] = _pass(relative)
    is_self = np.eye(least.shape[1], dtype=bool)
    least[:, is_self] = np.inf
    is_gone = ~flight.alive[-1]
    least[:, is_gone], least[:, :, is_gone] = np.inf, np.inf
    is_thrust = np.abs(flight.applied).max(axis=2) > THRUST * flight.strength
    has_thrust = np.vstack([np.zeros_like(is_thrust[:1]), np.logical_or.accumulate(is_thrust)[:-1]])
    has_thrust &= flight.alive[-1]
    near, is_left_out = least < distance + BEND, has_thrust.copy()
    has_thrust[: 1 + _last_change(data, flight, plan)] = False
    is_left_out &= ~has_thrust
    return {
        "least_m": float(least[has_thrust].min(initial=np.inf)),
        "below": int(near[has_thrust].sum()),
        "pairs_below": int((near & has_thrust[..., None]).any(axis=0).sum()),
        "losses": int(has_thrust.sum()),
        "left_out": int(is_left_out.sum()),
        "below_left_out": int(near[is_left_out].sum()),
        "below_before_thrust": int(near[~has_thrust & ~is_left_out].sum()),
    }


def _last_change(data: xr.Dataset, flight: Flight, plan: dict[str, Any]) -> int:
    """Return the step at which others last changed what they fly, 0 where they never did."""
    found, step = 0, plan["step_s"]
    for event in (json.loads(str(text)) for text in data["event"].values):
        k = round(event["time"] / step)
        if event["kind"] in ("loss", "join", "assignment", "reset", "closed"):
            found = max(found, k)
        elif event["kind"] == "cautious":  # at the next decision those change to their plans
            found = max(found, k + plan.get("replan_steps", 1))
    return min(found, len(flight.time) - 2)


def _mean_rate(motion: Motion) -> float:
    if motion.chief is None:
        return motion.rate
    (r, speed, h), mu = motion.chief[0, :3], motion.gravity[0]
    axis = 1 / (2 / r - (speed**2 + (h / r) ** 2) / mu)
    return float((mu / axis**3) ** 0.5)


def _pass(relative: Array) -> Array:
    """Return the least distance of lines between samples from the origin: vehicles, others."""
    first, way = relative[:-1], np.diff(relative, axis=0)
    share = -(first * way).sum(axis=-1) / np.maximum((way * way).sum(axis=-1), 1e-300)
    near = first + np.clip(share, 0.0, 1.0)[..., None] * way
    return np.sqrt((near * near).sum(axis=-1)).min(axis=0)
