"""Small reconfigurations, drawn and simulated, for tests of their parts."""

import numpy as np

from dynamics import ClohessyWiltshire, DoubleIntegrator
from dynamics.trajectory_geometry import separations
from sato.obstacles import Box, Sphere
from sato.reconfiguration.leg import Leg, Loss
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.shapes.shape import Points


def at_rest(positions):
    """States at rest."""
    return np.concatenate([positions, np.zeros_like(positions)], axis=1)


def row(count, y, axes=2):
    """Positions a meter apart."""
    positions = np.zeros((count, axes))
    positions[:, 0] = np.arange(count) - (count - 1) / 2
    positions[:, 1] = y
    return positions


def leg_to(states, steps, **more):
    """A leg to all of these states, in this order."""
    d = states.shape[1] // 2
    shape = Points(states[:, :d], states[:, d:], keep_order=True)
    return Leg(shape, steps, count=len(states), **more)


def make_mission(start, *legs, **changes):
    """A drawn mission from positions or states, of double integrators unless it is changed."""
    columns = start.shape[1]
    values = {
        "model": DoubleIntegrator(columns if columns < 4 else columns // 2),
        "start": start,
        "legs": legs,
        "step": 1.0,
        "comm_radius": 4.0,
        "collision_radius": 0.5,
        "max_control": 0.1,
        "max_speed": 0.4,
        "horizon_steps": 4,
        "replan_steps": 2,
        "auction_steps": 4,
    }
    return Reconfiguration(**(values | changes)).draw(np.random.default_rng(0))


def crowd_in_the_way(rng, *, rows=3, is_box=False, **changes):
    """A square of vehicles that nobody crosses, and a body that comes over them unseen."""
    side = 1.06 * 0.5 * np.arange(rows)
    places = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    places += rng.normal(0.0, 0.004, places.shape)
    center, moves = np.array([-3.0, 0.5 + rng.normal(0.0, 0.2)]), {"velocity": (0.25, 0.0)}
    passing = Sphere(tuple(center), 0.4, known=False, **moves)
    if is_box:
        passing = Box(tuple(center - 0.3), tuple(center + 0.3), known=False, **moves)
    limits = {"max_control": 0.2, "max_speed": 0.6, "collision_radius": 0.5}
    radii = {"comm_radius": 8.0, "sensing_radius": 2.5}
    return make_mission(places, Leg(places, 16), obstacles=(passing,), **(limits | radii | changes))


def wreck_in_the_way(rng, **changes):
    """Four spacecraft with given targets, over which one drifts that is lost on its way."""
    start = np.array([[-3.0, 0.0, 0.0], [1.5, 2.0, 0.0], [1.5, -2.0, 0.0], [3.0, 2.0, 0.0]])
    targets = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.7, 0.0, 0.0], [2.4, 0.0, 0.0]])
    start, targets = start + rng.normal(0, 0.1, (4, 3)), targets + rng.normal(0, 0.05, (4, 3))
    loss = Loss("agents", agents=(0,), at_step=int(rng.integers(4, 8)), body="coast")
    later = targets + np.array([0.0, 0.5, 0.0])
    shapes = (Points(places, keep_order=True) for places in (targets, later))
    legs = (Leg(shape, 14, losses=own) for shape, own in zip(shapes, ((loss,), ()), strict=True))
    limits = {"max_control": 0.06, "comm_radius": 20.0, "assignment": "given"}
    return make_mission(start, *legs, **({"model": ClohessyWiltshire(1e-3)} | limits | changes))


def fly(mission, seed=0):
    """All frames of a flight."""
    return list(simulate(mission, np.random.default_rng(seed)))


def min_separation(mission, frames, pieces=1):
    """Least separation along the trajectories, each step divided into pieces."""
    x = np.array([np.concatenate([f.position, f.velocity], axis=1) for f in frames])
    u = np.nan_to_num([f.applied_control for f in frames[:-1]])
    alive = np.array([f.alive for f in frames])
    plant, h, d = mission.flown_plant, mission.step, mission.axes
    fine = [plant.propagate(x[k], u[k], k * h, h, pieces)[:-1] for k in range(len(u))]
    x = np.concatenate([*fine, x[-1:]])
    alive = np.concatenate([np.repeat(alive[:-1], pieces, axis=0), alive[-1:]])
    return separations(x[..., :d], x[..., d:], alive, h / pieces).minimum.distance
