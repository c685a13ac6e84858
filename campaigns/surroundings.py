"""Random missions among obstacles and lost vehicles.

forest      16 vehicles in a box of 12 m in the plane, or of 8 m in space, with R = 0.5 m,
            V = 1 m/s and U = 0.5 m/s² along each axis, among 10 spheres of 0.3 to 1 m; starts
            and targets at least R from these, and 2 R apart; in twice the least time alone
passing     the same among 3 that move at 0.1 to 0.5 V any way, none over a start in 3 s
surrounded  a mission of a family of `missions.py`, with 0 to 5 spheres and boxes of 0.5 to 2 R,
            of which one in three moves at 0.1 to 0.5 V, away from starts for as long as a vehicle
            needs to move by 2 R from rest, and, where at rest, from targets; one in two loses
            up to a quarter of its vehicles at a step of 0 to 30, which coast. In orbit there
            are no obstacles but the chief, a sphere of R, where nothing is within 2 R of it
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import missions
import numpy as np
from numpy import ndarray as Array

import sato

RADIUS, SPEED, CONTROL, COUNT = 0.5, 1.0, 0.5, 16
SIDES = {2: 12.0, 3: 8.0}  # of the box [m]
FAMILIES = (
    "default dense short low_thrust low_speed at_limit events noise in_place unequal circles "
    "spheres corridors clohessy_wiltshire j2"
).split()
MAX_DRAWS = 10_000


def _stand(
    axes: int, is_given: bool, moving: bool, rng: np.random.Generator
) -> sato.Reconfiguration:
    side, count = SIDES[axes], 3 if moving else 10
    centers = rng.uniform(-side / 2, side / 2, (count, axes))
    radii, way = rng.uniform(0.3, 1.0, count), rng.normal(size=(count, axes))
    way *= (moving * SPEED * rng.uniform(0.1, 0.5, count) / np.linalg.norm(way, axis=1))[:, None]
    start = _scatter(rng, side, centers, radii + 1.02 * RADIUS, way * 3.0)
    goal = _scatter(rng, side, centers, radii + 1.02 * RADIUS, np.zeros_like(way))
    obstacles = [
        sato.Sphere(tuple(c.tolist()), float(r), velocity=tuple(v.tolist()) if moving else None)
        for c, r, v in zip(centers, radii, way, strict=True)
    ]
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(axes),
        start=start,
        legs=[sato.Leg(goal, "auto", time_factor=2.0)],
        obstacles=obstacles,
        step=0.5,
        comm_radius=30.0,
        collision_radius=RADIUS,
        max_control=CONTROL,
        max_speed=SPEED,
        assignment="given" if is_given else "auction",
    )


def _scatter(
    rng: np.random.Generator, side: float, centers: Array, apart: Array, way: Array
) -> Array:
    """Draw places 2 R from each other, and clear of spheres that go a way."""
    found: list[Array] = []
    shares = np.linspace(0.0, 1.0, 13)[:, None, None]
    swept = centers + shares * way
    for _ in range(MAX_DRAWS):
        p = rng.uniform(-side / 2, side / 2, centers.shape[1])
        is_clear = (np.linalg.norm(swept - p, axis=2) > apart).all()
        if is_clear and all(np.linalg.norm(p - q) > 2 * RADIUS for q in found):
            found.append(p)
            if len(found) == COUNT:
                return np.array(found)
    raise ValueError("obstacles leave no room")


forest, passing = (
    SimpleNamespace(
        **{
            f"{name}_{axes}d": partial(_stand, axes, name == "given", moving)
            for name in ("free", "given")
            for axes in (2, 3)
        }
    )
    for moving in (False, True)
)


def _surround(family: str, rng: np.random.Generator) -> sato.Reconfiguration:
    mission = getattr(missions, family)(rng)
    drawn = mission.draw(np.random.default_rng(0))
    changes: dict[str, Any] = {}
    if drawn.is_point_mass:
        changes["obstacles"] = _draw_obstacles(rng, drawn)
    if rng.random() < 0.5 and not mission.legs[0].losses:
        count = mission.agent_count
        lost = rng.choice(count, int(rng.integers(0, max(2, count // 4 + 1))), replace=False)
        if 0 < len(lost) < count:
            loss = sato.Loss(
                "agents",
                agents=tuple(lost.tolist()),
                at_step=int(rng.integers(0, 31)),
                body="coast",
            )
            changes["legs"] = (replace(mission.legs[0], losses=(loss,)), *mission.legs[1:])
    legs = changes.get("legs", mission.legs)
    coasting = [
        replace(leg, losses=tuple(replace(loss, body="coast") for loss in leg.losses))
        for leg in legs
    ]
    return replace(mission, **(changes | {"legs": tuple(coasting)}))


def _draw_obstacles(rng: np.random.Generator, drawn: sato.Reconfiguration) -> list[Any]:
    d, R, found = drawn.axes, float(np.max(drawn.collision_radius)), []
    start = drawn.initial_states[:, :d]
    goals = np.concatenate([leg.targets[:, :d] for leg in drawn.legs])
    low, high = (f(np.concatenate([start, goals]), axis=0) for f in (np.min, np.max))
    escape = 2 * (2 * R / drawn.least_control) ** 0.5
    for _ in range(int(rng.integers(0, 6))):
        for _ in range(MAX_DRAWS):
            center, size = rng.uniform(low - R, high + R), R * rng.uniform(0.5, 2.0, d)
            is_moving, is_box = rng.random() < 1 / 3, rng.random() < 0.5
            way = rng.normal(size=d)
            way *= (
                is_moving
                * rng.uniform(0.1, 0.5)
                * float(drawn.top_speeds.min())
                / np.linalg.norm(way)
            )
            wide = float(np.linalg.norm(size)) if is_box else float(size[0])
            swept = center + np.linspace(0.0, escape, 25)[:, None] * way
            near = np.linalg.norm(start - swept[:, None], axis=2).min(initial=np.inf)
            at_goals = np.inf if is_moving else np.linalg.norm(goals - center, axis=1).min()
            if min(near, at_goals) > wide + 1.2 * R + drawn.margin:
                break
        else:
            continue
        velocity = tuple(way.tolist()) if is_moving else None
        if is_box:
            sides = (tuple((center + s * size).tolist()) for s in (-1, 1))
            found.append(sato.Box(*sides, velocity=velocity))
        else:
            found.append(sato.Sphere(tuple(center.tolist()), wide, velocity=velocity))
    return found


def __getattr__(name: str) -> Callable[[np.random.Generator], sato.Reconfiguration]:
    """Return a family among obstacles, by its name: "surroundings:dense"."""
    if name not in FAMILIES:
        raise AttributeError(name)
    return partial(_surround, name)
