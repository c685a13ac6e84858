"""Given targets in a crowded room: python scripts/study_given_targets.py [NAME ...].

The missions `empty10` to `empty60` of the LSC planner [Park2022]: 10 to 60 quadrotors in a room of
3 x 3 x 2 m. A ball of 0.3 m with z halved stands for the ellipsoid of their downwash. Each agent
flies to its own target in 1.6 times the least time, foresees the whole leg, and keeps a plan that
arrives.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import sato

MISSIONS = Path(__file__).parent / "lsc_missions.json"
HALVED = np.array([1.0, 1.0, 0.5])
RADIUS = 0.3  # [m]


def make_mission(start: list[list[float]], goal: list[list[float]]) -> sato.Reconfiguration:
    """Return a mission with given targets; the times are those of the limits on x and y."""
    positions, targets = (np.array(points) * HALVED for points in (start, goal))

    def mission(**settings: int) -> sato.Reconfiguration:
        return sato.Reconfiguration(
            model=sato.DoubleIntegrator(3),
            start=positions,
            legs=[sato.Leg(targets, "auto", time_factor=1.6)],
            step=0.2,
            comm_radius=20.0,  # all hear all
            collision_radius=RADIUS,
            max_control=2.0,
            max_speed=1.0,
            assignment="given",
            **settings,
        )

    steps = mission().draw(np.random.default_rng(0)).legs[0].steps
    return mission(foresight_steps=steps, freeze_steps=steps)


def main() -> int:
    """Fly the missions; return 1 if any does not arrive, or comes too close."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    data = json.loads(MISSIONS.read_text(encoding="utf-8"))["missions"]
    names = [name for name in data if name.startswith("empty")]
    parser.add_argument("names", nargs="*", help="missions; all if absent")
    chosen = parser.parse_args().names or names
    table = Table(
        "mission", "steps", "reached", "least separation, R", "slack", "braked", "fuel", "s"
    )
    passed = True
    for name in chosen:
        mission, begin = make_mission(**data[name]), time.process_time()
        run = sato.run(mission)
        found, seconds = run.summary, time.process_time() - begin
        separation = found["min_separation_m"] / RADIUS
        passed &= bool(found["reached"] and run.check().kept)
        fuel = found["fuel_m_s"] / found.get("fuel_lower_bound_m_s", np.nan)
        cells = (
            found["legs"][0]["steps"],
            found["reached"],
            f"{separation:.6f}",
            found["slack_used"],
            found["braked"],
            f"{fuel:.3f}",
            f"{seconds:.0f}",
        )
        print(name, *cells, file=sys.stderr, flush=True)
        table.add_row(name, *map(str, cells))
    Console(width=110).print(table)
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
