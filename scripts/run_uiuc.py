"""123 vehicles write U, I, U, C and lose a quarter on the way: python scripts/run_uiuc.py [SEED]."""

import sys
from pathlib import Path

import sato
from sato.reconfiguration.state import ReconfigurationFrame


def print_progress(mission: object, frame: ReconfigurationFrame) -> None:
    """Say how the swarm stands, every twenty seconds."""
    if frame.time % 20 == 0:
        networks = frame.component.max() + 1
        print(f"t = {frame.time:3.0f} s  leg {frame.leg_index + 1}  {networks} networks")


seed = int(sys.argv[1]) if len(sys.argv) > 1 else 0
run = sato.run("uiuc", seed=seed, progress=print_progress)

for number, leg in enumerate(run.summary["legs"], start=1):
    print(f"leg {number}: {leg['holes']} holes, gap {leg['gap']:.2f}, {leg['resets']} resets")
print(f"least separation {run.summary['min_separation_m']:.6f} m, all along the paths")
print(f"slack {run.summary['slack_used']}, broken promises: {run.check().broken or 'none'}")

folder = Path("runs") / f"uiuc-{seed}"
run.save(folder)
print("figures:", *run.plot(folder), sep="\n  ")
