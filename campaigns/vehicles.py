"""Random missions of reconfigurations, drawn for campaigns, and what is asked of them."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from swarms import place

import sato

LSC = Path(__file__).parents[1] / "tests" / "data" / "lsc_missions.json"
START_FACTOR = 1.1  # of the distances apart, over those required


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


def crowd(rng: np.random.Generator) -> sato.Reconfiguration:
    """Draw 4 to 12 vehicles, 1.1 R apart and farther, with given targets, and how they plan."""
    axes, count = int(rng.integers(2, 4)), int(rng.integers(4, 13))
    side, radii = rng.uniform(1.5, 3.0) * count ** (1 / axes), np.full(count, START_FACTOR)
    start, target = place(rng, radii, side, axes), place(rng, radii, side, axes)
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


def _room(case: dict[str, list[list[float]]], _: np.random.Generator) -> sato.Reconfiguration:
    start, goal = (np.array(case[name]) for name in ("start", "goal"))
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(3),
        start=start,
        legs=(sato.Leg(sato.Points(goal, keep_order=True), "auto", time_factor=1.6),),
        step=0.2,
        comm_radius=1e3,
        collision_radius=0.3,
        separation_axes=(1.0, 1.0, 2.0),
        max_control=2.0,
        max_speed=1.0,
        speed_norm="inf",
        assignment="given",
        foresight_steps=10_000,  # the whole leg
    )


# Missions of the LSC planner [Park2022], by name, with the ellipsoid of a quadrotor's downwash.
lsc = SimpleNamespace(
    **{
        name: partial(_room, case)
        for name, case in json.loads(LSC.read_text(encoding="utf-8"))["missions"].items()
    }
)


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
