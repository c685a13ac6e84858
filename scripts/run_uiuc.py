"""Scenario uiuc: python scripts/run_uiuc.py [SEED].

123 vehicles write U, I, U, C, and a quarter of them is lost on the way.
"""

import sys
from pathlib import Path

import sato
from sato.reconfiguration.state import ReconfigurationFrame


def print_progress(mission: object, frame: ReconfigurationFrame) -> None:
    """Print the state of the swarm every 20 s."""
    if frame.time % 20 == 0:
        networks = frame.component.max() + 1
        print(f"t = {frame.time:3.0f} s  leg {frame.leg_index + 1}  {networks} networks")


def main() -> None:
    """Simulate, print the results of each leg, and draw the figures."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
    run = sato.run("uiuc", seed=seed, progress=print_progress)

    for number, leg in enumerate(run.summary["legs"], start=1):
        print(f"leg {number}: {leg['holes']} holes, gap {leg['gap']:.2f}, {leg['resets']} resets")
    print(f"least separation {run.summary['min_separation_m']:.6f} m, all along the paths")
    print(f"slack {run.summary['slack_used']}, violated checks: {run.check().broken or 'none'}")

    folder = Path("runs") / f"uiuc-{seed}"
    run.save(folder)
    print("figures:", *run.plot(folder), sep="\n  ")


if __name__ == "__main__":
    main()
