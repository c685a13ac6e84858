"""Random missions and trajectories that agents may commit to, and distances in continuous time."""

import sys
from itertools import islice
from pathlib import Path

import numpy as np
from reconfiguration_runs import make_mission, row

import sato
from sato.reconfiguration import loop, stopping
from sato.reconfiguration.offers import Offers
from sato.reconfiguration.stopping import count_stop_steps, stopping_horizon

sys.path.append(str(Path(__file__).parent.parent / "campaigns"))  # as a worker of a campaign has it

import judge
import missions
import swarms

NORMS = (1, 2, "inf")


def crowd(axes=2, agents=3, **changes):
    """A mission of agents in a row."""
    return make_mission(row(agents, 0.0, axes), sato.Leg(row(agents, 3.0, axes), 14), **changes)


def stop_at_once(limit, velocity, h):
    """Equal controls that bring a double integrator to rest, in the fewest steps."""
    count = int(count_stop_steps(limit, velocity, h))
    return np.tile(-velocity / (max(count, 1) * h), (count, 1))


def sample(x, u, h, count=60):
    """Positions along trajectories of double integrators, densely sampled."""
    d, t = u.shape[-1], np.linspace(0, h, count)[:, None]
    p, v = x[..., :-1, None, :d], x[..., :-1, None, d:]
    dense = p + t * v + t**2 / 2 * u[..., None, :]
    return dense.reshape(*u.shape[:-2], -1, d)


def random_offers(rng, mission, agents, box):
    """Draw offers that need not be clear of each other, the committed ones included."""
    d, h, T, choices = mission.axes, mission.step, 12, 4
    limit, start = mission.control_limit(0), np.zeros((agents, 2 * mission.axes))
    start[:, :d] = rng.uniform(-box, box, (agents, d))
    start[:, d:] = limit.cut(rng.normal(0, 0.2, (agents, d))) * h
    u, steps = np.zeros((agents, choices, T, d)), np.zeros(agents, dtype=int)
    for a in range(agents):
        for c in range(choices):
            begun = limit.cut(rng.normal(0, 0.1, (rng.integers(0, 5), d)))
            stop = stop_at_once(limit, start[a, d:] + h * begun.sum(axis=0), h)
            own = np.vstack([begun, stop])[:T]
            u[a, c, : len(own)] = own
            steps[a] = max(steps[a], len(own) + 1)
    horizon = stopping_horizon(mission, T)
    x = horizon.discrete_model.simulate(np.repeat(start[:, None], choices, axis=1), u)
    is_allowed = rng.random((agents, choices)) < 0.8
    is_allowed[:, -1] = True
    clearance = rng.uniform(0.3, 0.7, agents)
    paths = horizon.control_points(x, u)
    plan_steps = tuple(range(choices - 1, -1, -1))
    return Offers(
        np.arange(agents), plan_steps, steps, horizon, u, paths, is_allowed, clearance
    ), sample(x, u, h)


def least_distances(dense):
    """Least distance of every pair, of positions agents × samples × d."""
    return np.linalg.norm(dense[:, None] - dense[None], axis=-1).min(axis=-1)


def random_reach(rng, mission, horizon):
    """Draw a trajectory that stops, and goes exactly as far as it may: positions and path."""
    T, d = horizon.steps, mission.axes
    u, v = rng.normal(0, 1, (T, d)) * rng.uniform(0, 1, (T, 1)) ** 3, rng.normal(0, 1, d)
    u[8:11], u[11:] = -(v + u[:8].sum(axis=0)) / 3, 0.0
    x = horizon.discrete_model.simulate(np.concatenate([np.zeros(d), v]), u)
    path, S = horizon.control_points(x, u), horizon.pieces_per_step
    away = [np.linalg.norm(path[k * S :] - x[k, :d], axis=-1).max() for k in range(T)]
    factor = (mission.comm_radius - horizon.clearance) / 2 / max(away)
    for more, is_near in ((1e-6, False), (0.0, True)):
        scaled = factor * (1 + more)
        near = stopping.stays_within_reach(mission, horizon, scaled * x, scaled * path)
        assert near == is_near
    return factor * x[:, :d], factor * path


def reflection(one, other):
    """Orthogonal matrix that takes the direction of a vector to that of another."""
    n = one / np.linalg.norm(one) - other / np.linalg.norm(other)
    return np.eye(len(n)) - (2 * np.outer(n, n) / (n @ n) if n @ n > 1e-20 else 0)


def distance(relative):
    """Least distance of cubics, given their control points."""
    b = np.moveaxis(relative, -2, 0)
    cubics = [b[0], 3 * (b[1] - b[0]), 3 * (b[2] - 2 * b[1] + b[0])]
    cubics += [b[3] - 3 * b[2] + 3 * b[1] - b[0]]
    flat = np.stack(cubics, axis=1)
    return judge.least_lengths(np.pad(flat, ((0, 0), (0, 0), (0, 3 - flat.shape[2])))).min()


def random_mission(rng):
    """Draw 2 to 8 vehicles: dense, crossing or spread, with periods and hearing of any kind."""
    d, n, R = int(rng.integers(2, 4)), int(rng.integers(2, 9)), 0.5
    T = int(rng.integers(1, 7))
    V = rng.uniform(0.2, 1.5) * R
    kind = rng.choice(["dense", "crossing", "spread"])
    gap, side = (1.01, 1.7) if kind == "dense" else (1.2, 2.5)
    if kind == "crossing":
        unit, radius = swarms.spread(n, d, gap * R)
        start = radius * unit
        goal = -start
    else:
        start, goal = (
            swarms.place(rng, np.full(n, gap * R), side * R * n ** (1 / d), d) for _ in range(2)
        )
    return make_mission(
        start,
        sato.Leg(sato.Points(goal, keep_order=True), "auto", time_factor=rng.uniform(1.0, 2.0)),
        assignment=str(rng.choice(["given", "auction"])),
        collision_radius=R,
        comm_radius=rng.choice([1.0, 1.5]) * (2 * V * T + R) * (1 + 1e-9),
        max_speed=V,
        max_control=V / np.exp(rng.uniform(0, 2)),
        control_norm="inf" if rng.random() < 0.9 or n > 3 else NORMS[rng.integers(2)],
        horizon_steps=T,
        replan_steps=(replan := int(rng.integers(1, T + 1))),
        auction_steps=replan,
    )


def begin(mission, count):
    """Fly so many instants at most."""
    return list(islice(loop.simulate(mission, np.random.default_rng(0)), count))


def continuous_separation(mission, frames):
    """Least distance of any two over R, by roots of the derivative on every step."""
    d, h = mission.axes, mission.step
    first, second = np.triu_indices(len(mission.initial_states), 1)
    least = np.inf
    for frame in frames[:-1]:
        parts = frame.position, h * frame.velocity, h**2 / 2 * frame.control
        cubics = np.stack([*parts, np.zeros_like(frame.control)], axis=1)
        apart = np.pad(cubics[first] - cubics[second], ((0, 0), (0, 0), (0, 3 - d)))
        least = min(least, judge.least_lengths(apart).min())
    return least / mission.largest_separation


def random_spacecraft(rng):
    """A mission of spacecraft about a circular orbit, as campaigns draw them."""
    return missions.clohessy_wiltshire(rng)
