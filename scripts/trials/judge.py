"""Judge a run file of a double integrator without this library: python judge.py DIR/run.nc.

Reads the file by h5py alone, and computes the least separation of live agents along the
continuous trajectories, the residual of the equations of motion, the errors at the targets,
and the least distance of survivors to lost vehicles that coast on.
"""

import json
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np


def judge(file: str | Path) -> dict[str, Any]:
    """Return what the run file itself says about safety and arrival."""
    with h5py.File(file) as run:
        names = ("time", "position", "velocity", "applied_control", "leg_index", "target_index")
        t, x, v, u, leg, target = (run[name][:] for name in names)
        alive, targets = run["alive"][:].astype(bool), run["target_position"][:]
        radius = float(np.atleast_1d(run.attrs["collision_radius_m"])[0])
    u = np.nan_to_num(u)
    live = np.flatnonzero(alive[-1] & (target[-1] >= 0))
    held = target[-1, live]
    miss = np.linalg.norm(x[-1, live] - targets[leg[-1]][held], axis=1)
    return {
        "collision_radius_m": radius,
        "steps": len(t) - 1,
        "separation_m": least_separation(t, x, v, u, alive, 3 * radius),
        "wreck_separation_m": wreck_separation(t, x, v, u, alive, radius),
        "motion_residual": motion_residual(t, x, v, u, alive),
        "largest_miss_m": float(miss.max(initial=0.0)),
        "duplicate_targets": len(held) - len(np.unique(held)),
    }


def least_distance(p: np.ndarray, v: np.ndarray, a: np.ndarray, h: float) -> float:
    """Return min |p + v t + a t²/2| over 0 ≤ t ≤ h, by the roots of the derivative."""
    derivative = [a @ a, 3 * (v @ a), 2 * (v @ v + p @ a), 2 * (p @ v)]
    roots = np.roots(np.trim_zeros(derivative, "f"))
    times = [0.0, h, *(r.real for r in roots if abs(r.imag) < 1e-9 and 0 < r.real < h)]
    return min(float(np.linalg.norm(p + v * s + a * s**2 / 2)) for s in times)


def least_separation(
    t: np.ndarray, x: np.ndarray, v: np.ndarray, u: np.ndarray, alive: np.ndarray, near: float
) -> float:
    """Return the least distance of two live agents [m]; exact where it is less than `near`."""
    least = np.inf
    for k, h in enumerate(np.diff(t)):
        live = np.flatnonzero(alive[k])
        first, second = np.triu_indices(len(live), 1)
        reach = np.linalg.norm(v[k, live], axis=1) * h
        reach += np.linalg.norm(u[k, live], axis=1) * h**2 / 2
        apart = np.linalg.norm(x[k, live[first]] - x[k, live[second]], axis=1)
        close = apart - reach[first] - reach[second] < min(least, near)
        for i, j in zip(live[first[close]], live[second[close]], strict=True):
            relative = [each[k, i] - each[k, j] for each in (x, v, u)]
            least = min(least, least_distance(*relative, h))
        least = min(least, apart.min(initial=np.inf))
    return float(least)


def lost_agents(alive: np.ndarray) -> list[tuple[int, int]]:
    """Return the instant and the index of every agent that is lost."""
    return [(int(k) + 1, int(i)) for k, i in np.argwhere(alive[:-1] & ~alive[1:])]


def wreck_separation(
    t: np.ndarray, x: np.ndarray, v: np.ndarray, u: np.ndarray, alive: np.ndarray, radius: float
) -> float | None:
    """Return the least distance of survivors to lost agents that coast on [m], if any are lost."""
    distances = [d for lost in lost_agents(alive) for d in passes(lost, t, x, v, u, alive, radius)]
    return min((d for _, d in distances), default=None)


def passes(
    lost: tuple[int, int],
    t: np.ndarray,
    x: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    alive: np.ndarray,
    radius: float,
) -> list[tuple[int, float]]:
    """Return the survivors that come near a lost agent, with their least distances [m]."""
    begin, agent = lost
    wreck, drift, found = x[begin, agent].copy(), v[begin, agent], []
    for k in range(begin, len(t) - 1):
        h = t[k + 1] - t[k]
        live = np.flatnonzero(alive[k])
        reach = 4 * radius + 4 * h * np.abs(v[k]).max()
        for i in live[np.linalg.norm(x[k, live] - wreck, axis=1) < reach]:
            nearest = least_distance(x[k, i] - wreck, v[k, i] - drift, u[k, i], h)
            found.append((int(i), nearest))
        wreck += drift * h
    return found


def motion_residual(
    t: np.ndarray, x: np.ndarray, v: np.ndarray, u: np.ndarray, alive: np.ndarray
) -> float:
    """Return the largest error of r̈ = u from instant to instant."""
    h = np.diff(t)[:, None, None]
    both = (alive[:-1] & alive[1:])[..., None]
    position = np.abs(x[1:] - (x[:-1] + h * v[:-1] + h**2 / 2 * u[:-1]))
    velocity = np.abs(v[1:] - (v[:-1] + h * u[:-1]))
    return float(np.where(both, np.maximum(position, velocity), 0.0).max(initial=0.0))


if __name__ == "__main__":
    print(json.dumps(judge(sys.argv[1]), indent=1))
