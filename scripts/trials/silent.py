"""Fly two vehicles past each other with several periods: python silent.py [--seeds 25].

A run that comes closer than R_col without slack or braking is a silent collision.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from judge import judge

import sato

SPEED = 0.2  # [m/s]
RADIUS = 0.5  # [m]


def encounter(seed: int, horizon: int, replan: int) -> sato.Reconfiguration:
    """Draw two crossing paths; each vehicle has one target that only it is near."""
    rng = np.random.default_rng(seed)
    y = rng.uniform(-1.0, 1.0)
    start = [[0.0, 0.0, 0.15, 0.0], [rng.uniform(2.5, 3.5), y, -0.15, 0.0]]
    target = [[4.0, rng.uniform(-0.2, 0.2)], [rng.uniform(-1, -0.3), y + rng.uniform(-1, 1)]]
    return sato.Reconfiguration(
        name="silent",
        model=sato.DoubleIntegrator(2),
        start=start,
        legs=[sato.Leg(sato.Points(target, keep_order=True), steps=60)],
        step=1.0,
        comm_radius=2 * SPEED * horizon + RADIUS,
        collision_radius=RADIUS,
        max_control=0.1,
        max_speed=SPEED,
        horizon_steps=horizon,
        replan_steps=replan,
        tie_break=0.0,
        reset="need",
    )


def main() -> None:
    """Fly every encounter and print a line each."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=25)
    parser.add_argument("--out", type=Path, default=Path("runs/silent"))
    args = parser.parse_args()
    for horizon, replan in ((4, 4), (6, 2), (4, 1)):
        for seed in range(args.seeds):
            run = sato.run(encounter(seed, horizon, replan))
            folder = run.save(args.out / f"{horizon}-{replan}-{seed}")
            separation = judge(folder / "run.nc")["separation_m"] / RADIUS
            row = {"horizon": horizon, "replan": replan, "seed": seed, "separation": separation}
            row["collided"] = separation < 1 - 1e-6
            row |= {key: run.summary[key] for key in ("slack_used", "braked", "reached")}
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
