"""Missions of vehicles with radii and limits of their own, in one network, drawn at random.

    python scripts/study_unequal_vehicles.py --count 50

Radii, controls and speeds differ by up to three to one. Starts are at rest, each pair somewhat
farther apart than it must be; targets are 1.5 times the largest required distance apart. Agents
plan again every third of the horizon, and look ahead over the whole leg. Each run is checked from
its data: targets, limits, and in continuous time the distance (R_i + R_j)/2 of each pair.
"""

import argparse
from time import perf_counter

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

import sato
from sato.reconfiguration.mission import Reconfiguration

RATIO = 3.0  # of the largest radius or limit to the smallest
RADIUS, CONTROL, SPEED = 0.5, 0.04, 0.25  # the smallest [m, m/s², m/s]
START_FACTOR, TARGET_FACTOR = 1.1, 1.5  # of the distances apart, over those required
CROWDING = 5.0  # side of the box for two vehicles, over the largest required distance


def place(
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


def draw_mission(seed: int, assignment: str = "auction") -> Reconfiguration:
    """Draw 3 to 12 vehicles and targets, in the plane or in space."""
    rng = np.random.default_rng(seed)
    count, axes = int(rng.integers(3, 13)), int(rng.integers(2, 4))
    radii, control, speed = (
        least * rng.uniform(1, RATIO, count) for least in (RADIUS, CONTROL, SPEED)
    )
    widest = float(np.sort(radii)[-2:].mean())
    side = CROWDING * widest * (count / 2) ** (1 / axes)
    start = place(rng, START_FACTOR * radii, side, axes)
    target = place(rng, np.full(count, TARGET_FACTOR * widest), side, axes)
    return Reconfiguration(
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
        foresight_steps=10_000,
        assignment=assignment,
    )


def main() -> None:
    """Fly the missions, print a line each, and count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--given", action="store_true", help="targets given, so that many cross")
    args = parser.parse_args()
    assignment = "given" if args.given else "auction"
    reached = recorded = broken = 0
    least = np.inf
    for seed in range(args.first, args.first + args.count):
        begin = perf_counter()
        run = sato.run(draw_mission(seed, assignment), seed=seed)
        summary, report = run.summary, run.check()
        faults = [promise.name for promise in report.broken]
        separation = summary["min_relative_separation"]
        reached += summary["reached"]
        recorded += bool(summary["slack_used"])
        broken += bool(set(faults) - ({"separation"} if summary["slack_used"] else set()))
        least = min(least, separation)
        print(
            f"{seed:3d}  {summary['agents']:2d} vehicles  reached {summary['reached']}  "
            f"separation {separation:.6f}  slack {summary['slack_used']}  "
            f"braked {summary['braked']}  {faults}  {perf_counter() - begin:.1f} s",
            flush=True,
        )
    print(
        f"{reached} of {args.count} reached; least separation {least:.9f} of that required; "
        f"{recorded} with slack recorded; {broken} with another promise broken"
    )


if __name__ == "__main__":
    main()
