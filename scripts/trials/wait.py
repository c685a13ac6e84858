"""Let a component arrive before two late vehicles, under noise: python wait.py.

Components that have arrived wait until all have; they drift under disturbances meanwhile.
"""

import json
from pathlib import Path

import numpy as np
from judge import judge

import sato

CASES = ((0.0, 0), (0.002, 0), (0.002, 1), (0.004, 0), (0.004, 1), (0.004, 2))


def waiting(disturbance: float) -> sato.Reconfiguration:
    """Place nine vehicles at their targets, and two that meet late and reset their clocks."""
    lattice = [[float(i), float(j)] for i in range(3) for j in range(3)]
    return sato.Reconfiguration(
        name="wait",
        model=sato.DoubleIntegrator(2),
        start=np.array([*lattice, [60.0, 0.0], [60.0, 14.0]]),
        legs=[
            sato.Leg(sato.Points([*lattice, [60.0, 6.4], [60.0, 7.6]], keep_order=True), steps=60)
        ],
        step=1.0,
        comm_radius=3.0,
        collision_radius=0.5,
        max_control=0.1,
        max_speed=0.3,
        horizon_steps=4,
        replan_steps=1,
        margin="auto",
        disturbance=disturbance,
    )


def main() -> None:
    """Fly every case and print a line each."""
    for disturbance, seed in CASES:
        run = sato.run(waiting(disturbance), seed=seed)
        folder = run.save(Path("runs/wait", f"{disturbance:g}-{seed}"))
        row = {"disturbance_m_s2": disturbance, "seed": seed}
        row["separation_m"] = judge(folder / "run.nc")["separation_m"]
        row |= {key: run.summary[key] for key in ("reached", "slack_used", "braked", "broken")}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
