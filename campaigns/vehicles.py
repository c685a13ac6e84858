"""Random missions of reconfigurations, drawn for campaigns, and what is asked of them."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

import sato

RATIO = 3.0  # of the largest radius or limit to the smallest
RADIUS, CONTROL, SPEED = 0.5, 0.04, 0.25  # the smallest [m, m/s², m/s]
START_FACTOR, TARGET_FACTOR = 1.1, 1.5  # of the distances apart, over those required
CROWDING = 5.0  # side of the box for two vehicles, over the largest required distance
HALVED = np.array([1.0, 1.0, 0.5])
ALWAYS = 10_000  # steps, more than any leg has


def unequal(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw 3 to 12 vehicles with radii and limits of their own, in the plane or in space."""
    count, axes = int(rng.integers(3, 13)), int(rng.integers(2, 4))
    radii, control, speed = (
        least * rng.uniform(1, RATIO, count) for least in (RADIUS, CONTROL, SPEED)
    )
    widest = float(np.sort(radii)[-2:].mean())
    side = CROWDING * widest * (count / 2) ** (1 / axes)
    start = _place(rng, START_FACTOR * radii, side, axes)
    target = _place(rng, np.full(count, TARGET_FACTOR * widest), side, axes)
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(axes),
        start=start,
        legs=(sato.Leg(target, steps="auto"),),
        step=1.0,
        comm_radius=20 * side,
        collision_radius=tuple(radii.tolist()),
        max_control=tuple(control.tolist()),
        max_speed=tuple(speed.tolist()),
        horizon_steps=6,
        replan_steps=2,
        foresight_steps=ALWAYS,
    )


def automatic(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw 2 to 8 vehicles and one to three legs with automatic numbers of steps."""
    agents, axes = int(rng.integers(2, 9)), int(rng.integers(2, 4))
    assignment = str(rng.choice(["auction", "given"]))
    start = _scatter(rng, agents, axes)
    if rng.random() < 0.5:
        start = np.hstack([start, rng.uniform(-0.2, 0.2, start.shape)])
    more = 0 if assignment == "given" else int(rng.integers(0, agents + 1))
    shapes = [_scatter(rng, agents + more, axes) + rng.uniform(-8, 8, axes) for _ in range(3)]
    legs = [sato.Leg(shape, "auto") for shape in shapes[: rng.integers(1, 4)]]
    if rng.random() < 0.5:
        legs[-1] = sato.Leg(sato.Ring(spacing=2.0), "auto")
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(axes),
        start=start,
        legs=legs,
        step=2.0,
        comm_radius=300.0,
        collision_radius=0.5,
        max_control=0.05,
        max_speed=float(rng.choice([0.5, 5.0])),
        assignment=assignment,
        foresight_steps=200,  # the whole leg
    )


def room(_: np.random.Generator) -> dict[str, Any]:
    """Return a mission whose limits along z are halved, for starts and targets given by a case."""
    limits = {
        "max_control_axes_m_s2": (2.0 * HALVED).tolist(),
        "max_speed_axes_m_s": (1.0 * HALVED).tolist(),
        "speed_norm": "inf",
    }
    return _room(limits)


def ball(_: np.random.Generator) -> dict[str, Any]:
    """Return a mission whose limits along z are those of x and y."""
    return _room({"max_control_m_s2": 2.0, "max_speed_m_s": 1.0})


def crowd(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw 4 to 12 vehicles, 1.1 R apart and farther, with given targets, and how they plan."""
    axes, count = int(rng.integers(2, 4)), int(rng.integers(4, 13))
    side, radii = rng.uniform(1.5, 3.0) * count ** (1 / axes), np.full(count, START_FACTOR)
    start, target = _place(rng, radii, side, axes), _place(rng, radii, side, axes)
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(axes),
        start=start,
        legs=(sato.Leg(target, "auto", time_factor=rng.choice([1.2, 1.5, 1.6, 2.0])),),
        step=1.0,
        comm_radius=1e3,
        collision_radius=1.0,
        max_control=rng.choice([0.05, 0.1, 0.2]),
        max_speed=rng.choice([0.3, 0.5, 1.0]),
        assignment="given",
    )
    steps = _first_leg(mission).steps
    plans: list[dict[str, int]] = [
        {},
        {"foresight_steps": steps},
        {"foresight_steps": steps, "freeze_steps": steps},
        {"foresight_steps": steps, "freeze_steps": min(6, steps), "replan_steps": 2},
        {"freeze_steps": steps, "horizon_steps": 6, "replan_steps": 3, "auction_steps": 3},
    ]
    return replace(mission, **plans[rng.integers(len(plans))])


def judge_steps(run: sato.Run) -> dict[str, Any]:
    """Tell whether one step less than the least of the first leg is refused, and the least not."""
    mission = run.mission
    least = _first_leg(mission, time_factor=1.0).steps
    return {
        "without_resets": not any(leg["resets"] for leg in run.summary["legs"]),
        "least_taken": not _is_refused(mission, least),
        "less_refused": least == 0 or _is_refused(mission, least - 1),
    }


def _room(limits: dict[str, Any]) -> dict[str, Any]:
    ends = np.eye(2, 3)  # in whose place a case puts others
    return {
        "system": "reconfiguration",
        "name": "room",
        "swarm": {
            "start": {"kind": "points", "positions_m": ends.tolist()},
            "comm_radius_m": 1e3,
            "collision_radius_m": 0.3,
        },
        "model": {"kind": "double_integrator", "dimension": 3, **limits},
        "leg": [
            {
                "shape": {"kind": "points", "positions_m": ends.tolist()},
                "steps": "auto",
                "time_factor": 1.6,
            }
        ],
        "plan": {"step_s": 0.2, "assignment": "given", "foresight_steps": ALWAYS},
    }


def _place(
    rng: np.random.Generator, radii: Float[Array, " k"], side: float, axes: int
) -> Float[Array, "k d"]:
    """Draw points in a box, two at least (R_i + R_j)/2 apart; a larger box where it is full."""
    placed: list[Array] = []
    while len(placed) < len(radii):
        side *= 1.001
        point, own = rng.uniform(-side / 2, side / 2, axes), radii[len(placed)]
        required = (radii[: len(placed)] + own) / 2
        if not placed or (np.linalg.norm(np.array(placed) - point, axis=1) >= required).all():
            placed.append(point)
    return np.array(placed)


def _scatter(rng: np.random.Generator, count: int, axes: int) -> Float[Array, "count d"]:
    """Draw points of a grid that are 3 m apart, moved by up to half a meter."""
    cells = np.stack(np.unravel_index(rng.permutation(6**axes)[:count], (6,) * axes), axis=1)
    return 3.0 * cells + rng.uniform(-0.5, 0.5, (count, axes))


def _first_leg(mission: sato.Reconfiguration, **changed: Any) -> sato.Leg:
    alone = replace(mission, legs=(replace(mission.legs[0], **changed),))
    return alone.draw(np.random.default_rng(0)).legs[0]


def _is_refused(mission: sato.Reconfiguration, steps: int) -> bool:
    try:
        _first_leg(mission, steps=steps)
    except sato.InputError as error:
        return str(error).startswith("leg.0.steps")
    return False
