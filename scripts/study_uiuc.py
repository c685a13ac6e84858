"""Scenario uiuc for many seeds and losses: python scripts/study_uiuc.py --seeds 20.

The share lost after the I is a quarter, as in the paper; with --shares also a tenth, and a
third with a longer reach, a larger box, and the speed and steps that belong to them.
"""

import argparse
import sys
from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

import sato

LARGE_LOSS_OVERRIDES = (
    "swarm.start.box_m=49.0",
    "swarm.comm_radius_m=5.0",
    "model.max_speed_m_s=0.375",
    "leg.steps=110",
)
LOSS_SHARES: dict[float, tuple[str, ...]] = {0.25: (), 0.1: (), 1 / 3: LARGE_LOSS_OVERRIDES}


def list_cases(seeds: int, shares: bool) -> list[tuple[float, int]]:
    """List the shares and seeds to simulate: five seeds for each other share."""
    first = [(0.25, seed) for seed in range(seeds)]
    return first + [(s, seed) for s in (0.1, 1 / 3) for seed in range(5)] * shares


def find_failures(summary: dict[str, Any], broken: list[str], share: float) -> Iterator[str]:
    """Yield the requirements that a flight violates."""
    legs = summary["legs"]
    if legs[0]["components_at_start"] < 5:
        yield f"only {legs[0]['components_at_start']} networks at the start"
    if share >= 0.25 and legs[2]["components_at_start"] < 2:
        yield "the loss did not split the swarm"
    yield from broken
    yield from (f"leg {n} not reached" for n, leg in enumerate(legs, 1) if not leg["reached"])
    yield from (f"leg {n}: duplicates" for n, leg in enumerate(legs, 1) if leg["duplicates"])
    alive = summary["agents"] - summary["lost"]
    for n, (leg, holes) in enumerate(zip(legs, (0, 0, 123 - alive, 0), strict=True), 1):
        if leg["holes"] != holes:
            yield f"leg {n}: {leg['holes']} holes, not {holes}"
    if legs[3]["gap"] > 1.5:
        yield f"gap {legs[3]['gap']:.2f}"
    if not summary["min_separation_m"] >= summary["collision_radius_m"]:
        yield f"separation {summary['min_separation_m']}"
    if summary["slack_used"]:
        yield f"slack {summary['slack_used']}"


def main() -> int:
    """Simulate all flights; return 1 if any violates a requirement."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=20)
    options.add_argument("--shares", action="store_true", help="other shares too, five seeds each")
    given = options.parse_args()
    console, failed = Console(width=max(150, Console().width)), 0
    table = Table("lost", "seed", "networks", "holes", "gap", "resets", "steps", "least [m]")
    for name in ("slack", "braked", "fuel/bound", "wall [s]", "verdict"):
        table.add_column(name)
    for share, seed in track(list_cases(given.seeds, given.shares), "flying", console=console):
        run = sato.run(
            "uiuc", seed=seed, overrides=(f"leg.2.lose.share={share}", *LOSS_SHARES[share])
        )
        lost = sum(len(event["agents"]) for event in run.events("loss"))
        wrong = list(find_failures({**run.summary, "lost": lost}, run.summary["broken"], share))
        failed += bool(wrong)
        legs, s = run.summary["legs"], run.summary
        table.add_row(
            f"{share:.2f}",
            str(seed),
            " ".join(f"{g['components_at_start']}→{g['components_at_end']}" for g in legs),
            " ".join(str(g["holes"]) for g in legs),
            " ".join(f"{g['gap']:.2f}" for g in legs),
            " ".join(str(g["resets"]) for g in legs),
            " ".join(str(g["steps"]) for g in legs),
            f"{s['min_separation_m']:.7f}",
            str(s["slack_used"]),
            str(s["braked"]),
            f"{s['fuel_m_s'] / s['fuel_lower_bound_m_s']:.2f}",
            f"{s['wall_s']:.0f}",
            "; ".join(wrong) or "good",
        )
    console.print(table)
    console.print(f"{failed} of {table.row_count} not as they should be")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
