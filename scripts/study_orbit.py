"""Spacecraft in orbit for many seeds: python scripts/study_orbit.py --seeds 20 --rough.

With --rough also with 1 m and 1 mm/s of navigation noise, 5 % and 1° of thrust error and
drag whose coefficients differ by 20 %: no spacecraft then arrives within a
decimeter, and the requirement is the separation of the true positions.
"""

import argparse
import sys
from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

import sato

DISTURBED = (
    "disturbance.position_m=1.0",
    "disturbance.velocity_mm_s=1.0",
    "disturbance.thrust=0.05",
    "disturbance.pointing_deg=1.0",
    "plant.drag=true",
    "plant.ballistic_m2_kg=0.01",
    "plant.ballistic_spread=0.2",
    "plan.position_tolerance_m=50.0",
    "plan.velocity_tolerance_m_s=0.5",
)
COLUMNS = ("seed", "steps", "networks", "least [m]", "error [m]", "error [mm/s]")
MAX_FUEL_RATIO = 1.05  # fuel over its lower bound, without noise


def find_failures(summary: dict[str, Any], rough: bool) -> Iterator[str]:
    """Yield the requirements that a flight violates."""
    yield from summary["broken"]
    if not summary["min_separation_m"] >= summary["collision_radius_m"]:
        yield f"separation {summary['min_separation_m']}"
    if rough:
        return
    if summary["slack_used"]:
        yield f"slack {summary['slack_used']}"
    if summary["fuel_m_s"] > MAX_FUEL_RATIO * summary["fuel_lower_bound_m_s"]:
        yield "fuel"


def main() -> int:
    """Simulate all flights; return 1 if any violates a requirement."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--scenario", default="orbit")
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--first", type=int, default=0, help="the first seed")
    options.add_argument("--rough", action="store_true", help="with noise, errors and drag")
    given = options.parse_args()
    console, failed = Console(width=max(130, Console().width)), 0
    table = Table(*COLUMNS, "slack", "braked", "fuel/bound", "wall [s]", "verdict")
    seeds = range(given.first, given.first + given.seeds)
    for seed in track(seeds, "flying", console=console):
        run = sato.run(given.scenario, seed=seed, overrides=DISTURBED if given.rough else ())
        s, leg = run.summary, run.summary["legs"][0]
        wrong = list(find_failures(s, given.rough))
        failed += bool(wrong)
        table.add_row(
            str(seed),
            str(leg["steps"]),
            f"{leg['components_at_start']}→{leg['components_at_end']}",
            f"{s['min_separation_m']:.3f}",
            f"{leg['worst_position_error_m']:.4f}",
            f"{1e3 * leg['worst_velocity_error_m_s']:.4f}",
            str(s["slack_used"]),
            str(s["braked"]),
            f"{s['fuel_m_s'] / s['fuel_lower_bound_m_s']:.4f}",
            f"{s['wall_s']:.0f}",
            "; ".join(wrong) or "good",
        )
    console.print(table)
    console.print(f"{failed} of {table.row_count} not as they should be")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
