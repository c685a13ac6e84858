"""Missions of few vehicles that meet on purpose."""

from functools import partial
from types import SimpleNamespace

import numpy as np
from numpy import ndarray as Array
from swarms import spread

import sato

RADIUS = 0.5  # [m]
SWAP_SPEED = 0.5  # [m/s]


def cross_paths(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw two crossing paths; each vehicle has one target that only it is near."""
    y = rng.uniform(-1.0, 1.0)
    start = [[0.0, 0.0, 0.15, 0.0], [rng.uniform(2.5, 3.5), y, -0.15, 0.0]]
    target = [[4.0, rng.uniform(-0.2, 0.2)], [rng.uniform(-1, -0.3), y + rng.uniform(-1, 1)]]
    return _meet(start, target, steps=60, comm_radius=2.1, speed=0.2, tie_break=0.0, reset="need")


def wait_for_late_vehicles(_: np.random.Generator) -> sato.Reconfiguration:
    """Place nine vehicles at their targets, and two that meet late and reset their clocks."""
    lattice = [[float(i), float(j)] for i in range(3) for j in range(3)]
    start = [*lattice, [60.0, 0.0], [60.0, 14.0]]
    target = [*lattice, [60.0, 6.4], [60.0, 7.6]]
    return _meet(start, target, steps=60, comm_radius=3.0, speed=0.3, margin="auto")


def _cross_round(axes: int, agents: int, _: np.random.Generator) -> sato.Reconfiguration:
    unit, radius = spread(agents, axes, 2.4 * RADIUS)
    radius = max(4.0, radius)
    return _swap(radius * unit, -radius * unit, max(40, int(6 * radius / SWAP_SPEED)))


def _exchange_columns(rows: int, spacing: float, _: np.random.Generator) -> sato.Reconfiguration:
    y = spacing * (np.arange(rows) - rows // 2)
    start = np.vstack([np.column_stack([np.full(rows, x), y]) for x in (-5.0, 5.0)])
    return _swap(start, start * [-1, 1], 50)


# By their numbers: "encounters:circle.of_8".
NUMBERS = 4, 8, 16, 32, 64
circle, sphere = (
    SimpleNamespace(**{f"of_{n}": partial(_cross_round, axes, n) for n in NUMBERS})
    for axes in (2, 3)
)
near, far = (
    SimpleNamespace(**{f"columns_of_{n}": partial(_exchange_columns, n, gap) for n in (5, 10)})
    for gap in (0.6, 1.05)
)


def _swap(start: Array, target: Array, steps: int) -> sato.Reconfiguration:
    plan = {"horizon_steps": 10, "replan_steps": 2, "auction_steps": 4, "assignment": "given"}
    return _meet(start, target, steps, comm_radius=110.5, speed=SWAP_SPEED, **plan)


def _meet(
    start: object, target: object, steps: int, comm_radius: float, speed: float, **options: object
) -> sato.Reconfiguration:
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(np.shape(target)[1]),
        start=np.asarray(start),
        legs=[sato.Leg(sato.Points(target, keep_order=True), steps=steps)],
        step=1.0,
        comm_radius=comm_radius,
        collision_radius=RADIUS,
        max_control=0.1,
        max_speed=speed,
        **options,
    )
