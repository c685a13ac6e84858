"""Given targets in a crowd: python scripts/study_given_targets.py [NAME ...].

The missions `empty10` to `empty60` of the LSC planner [Park2022]: 10 to 60 quadrotors in a room of
3 x 3 x 2 m. A ball of 0.3 m with z halved stands for the ellipsoid of their downwash, so the limits
along z are halved too, except with `--ball`. Each agent flies to its own target in 1.6 times the
least time, and foresees the whole leg; with `--freeze` it keeps a plan that arrives.

`--random COUNT` draws crowds instead, in the plane and in space, with several horizons and periods,
and finds those in which separation was lost without a record.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from rich.console import Console
from rich.table import Table

import sato

MISSIONS = Path(__file__).parent / "lsc_missions.json"
HALVED = np.array([1.0, 1.0, 0.5])
RADIUS, CONTROL, SPEED = 0.3, 2.0, 1.0  # [m, m/s², m/s]


def make_crowd(
    start: Float[Array, "N d"], goal: Float[Array, "N d"], factor: float, **options: Any
) -> sato.Reconfiguration:
    """Return a mission with given targets in which all hear all."""
    return sato.Reconfiguration(
        model=sato.DoubleIntegrator(start.shape[1]),
        start=start,
        legs=[sato.Leg(goal, "auto", time_factor=factor)],
        comm_radius=1e3,
        assignment="given",
        **options,
    )


def count_steps(mission: sato.Reconfiguration) -> int:
    """Count the steps of the leg."""
    return mission.draw(np.random.default_rng(0)).legs[0].steps


def make_room(name: str, ball: bool, freeze: bool) -> sato.Reconfiguration:
    """Return one of the missions of the file."""
    data = json.loads(MISSIONS.read_text(encoding="utf-8"))["missions"][name]
    start, goal = (np.array(data[end]) * HALVED for end in ("start", "goal"))
    limits: dict[str, Any] = {"max_control": CONTROL, "max_speed": SPEED}
    if not ball:
        axes = {"max_control_axes": CONTROL * HALVED, "max_speed_axes": SPEED * HALVED}
        limits = {**axes, "speed_norm": "inf"}
    mission = make_crowd(start, goal, 1.6, step=0.2, collision_radius=RADIUS, **limits)
    steps = count_steps(mission)
    return replace(mission, foresight_steps=steps, freeze_steps=steps if freeze else 0)


def draw_crowd(seed: int, most: int = 12) -> sato.Reconfiguration:
    """Draw 4 vehicles or more, 1.1 R apart and farther, and how they plan."""
    rng = np.random.default_rng(seed)
    axes, count = int(rng.integers(2, 4)), int(rng.integers(4, most + 1))
    side = rng.uniform(1.5, 3.0) * count ** (1 / axes)
    start, goal = _place(rng, count, side, axes), _place(rng, count, side, axes)
    mission = make_crowd(
        start,
        goal,
        rng.choice([1.2, 1.5, 1.6, 2.0]),
        step=1.0,
        collision_radius=1.0,
        max_control=rng.choice([0.05, 0.1, 0.2]),
        max_speed=rng.choice([0.3, 0.5, 1.0]),
    )
    steps = count_steps(mission)
    plans: list[dict[str, int]] = [
        {},
        {"foresight_steps": steps},
        {"foresight_steps": steps, "freeze_steps": steps},
        {"foresight_steps": steps, "freeze_steps": min(6, steps), "replan_steps": 2},
        {"freeze_steps": steps, "horizon_steps": 6, "replan_steps": 3, "auction_steps": 3},
    ]
    return replace(mission, **plans[rng.integers(len(plans))])


def _place(rng: np.random.Generator, count: int, side: float, axes: int) -> Float[Array, "N d"]:
    placed: list[Array] = []
    while len(placed) < count:
        side *= 1.0005  # a larger box where it is full
        point = rng.uniform(-side / 2, side / 2, axes)
        if all(np.linalg.norm(point - other) >= 1.1 for other in placed):
            placed.append(point)
    return np.array(placed)


def main() -> int:
    """Fly; return 1 if a crowd does not arrive or comes too close, or one at random unrecorded."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    data = json.loads(MISSIONS.read_text(encoding="utf-8"))["missions"]
    parser.add_argument("names", nargs="*", help="missions; all if absent")
    parser.add_argument("--ball", action="store_true", help="limits of x and y also along z")
    parser.add_argument("--freeze", action="store_true", help="keep plans that arrive")
    parser.add_argument("--random", type=int, metavar="COUNT", help="crowds drawn at random")
    parser.add_argument("--first", type=int, default=0, help="first seed of these")
    parser.add_argument("--most", type=int, default=12, help="most vehicles of these")
    args = parser.parse_args()
    names = args.names or [name for name in data if name.startswith("empty")]

    def missions() -> Iterator[tuple[str, sato.Reconfiguration]]:
        if args.random is None:
            for name in names:
                yield name, make_room(name, args.ball, args.freeze)
        else:
            for seed in range(args.first, args.first + args.random):
                yield f"{seed}", draw_crowd(seed, args.most)

    columns = (
        "mission",
        "N",
        "steps",
        "reached",
        "separation, R",
        "slack",
        "braked",
        "fuel",
        "CPU s",
    )
    table, passed = Table(*columns), True
    for name, mission in missions():
        begin = time.process_time()
        run = sato.run(mission)
        found, seconds = run.summary, time.process_time() - begin
        separation = found["min_separation_m"] / found["collision_radius_m"]
        is_kept = separation >= 1 - 1e-6
        if args.random is None:
            passed &= bool(found["reached"] and is_kept)
        else:
            passed &= bool(is_kept or found["slack_used"] or found["braked"])
        fuel = found["fuel_m_s"] / found.get("fuel_lower_bound_m_s", np.nan)
        cells = (
            name,
            found["agents"],
            found["legs"][0]["steps"],
            found["reached"],
            f"{separation:.6f}",
            found["slack_used"],
            found["braked"],
            f"{fuel:.3f}",
            f"{seconds:.0f}",
        )
        print(*cells, file=sys.stderr, flush=True)
        table.add_row(*map(str, cells))
    Console(width=110).print(table)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
