"""Judge a run of a double integrator without this library: python campaigns/judge.py DIR/run.nc.

Takes the recorded data alone, and computes the least separation of live agents along the
continuous trajectories, the residual of the equations of motion, the errors at the targets,
and the least distance of survivors to lost vehicles, which here coast on from where they fell
silent.
"""

import json
import sys
from typing import Any

import numpy as np
import xarray as xr

NAMES = ("time", "position", "velocity", "applied_control", "leg_index", "target_index")
ROUNDING = 1e-6  # of the collision radius


def judge_run(run: Any) -> dict[str, Any]:
    """Judge a run of a campaign: whether it collided without a record, too."""
    found = judge(run.data)
    is_close = found["separation_m"] < (1 - ROUNDING) * found["collision_radius_m"]
    is_recorded = run.summary["slack_used"] or run.summary["braked"]
    return {"judged": found | {"silent_collision": is_close and not is_recorded}}


def judge(data: xr.Dataset) -> dict[str, Any]:
    """Return what the data itself says about safety and arrival."""
    t, x, v, u, leg, target = (data[name].values for name in NAMES)
    alive, targets = data["alive"].values.astype(bool), data["target_position"].values
    radius = float(np.atleast_1d(data.attrs["collision_radius_m"])[0])
    u = np.nan_to_num(u)
    live = np.flatnonzero(alive[-1] & (target[-1] >= 0))
    held = target[-1, live]
    miss = np.linalg.norm(x[-1, live] - targets[leg[-1]][held], axis=1)
    lost = lost_agents(alive)
    near = [(each[1], *p) for each in lost for p in passes(each, t, x, v, u, alive, radius)]
    too_near = [(wreck, survivor) for wreck, survivor, distance in near if distance < radius]
    return {
        "collision_radius_m": radius,
        "steps": len(t) - 1,
        "separation_m": least_separation(t, x, v, u, alive, 3 * radius),
        "lost": len(lost),
        "wreck_separation_m": min((distance for *_, distance in near), default=None),
        "wrecks_passed_too_close": len({wreck for wreck, _ in too_near}),
        "survivors_too_close": len({survivor for _, survivor in too_near}),
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
    print(json.dumps(judge(xr.load_dataset(sys.argv[1])), indent=1))
