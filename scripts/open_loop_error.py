"""Open-loop error of a plan of `orbit` on the exact dynamics: python scripts/open_loop_error.py.

Planned on the equations linearized about the chief, and about each spacecraft's own path.
How far they end from their targets is what a single plan costs, and why plans are made
again on the way.
"""

import argparse
import sys

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import sato

SINGLE_PLAN_OVERRIDES = (
    "plan.freeze_steps=24",
)  # nothing is planned anew with fewer steps left than these
LINEARIZATIONS = {"about the chief": "false", "about each path": "true"}


def main() -> int:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=5)
    given = options.parse_args()
    console = Console()
    table = Table("linearized", "error at the end, mean [m]", "worst [m]", "worst [mm/s]", "seeds")
    for name, own in LINEARIZATIONS.items():
        errors = []
        for seed in track(range(given.seeds), name, console=console):
            overrides = (*SINGLE_PLAN_OVERRIDES, f"model.relinearize={own}")
            errors.append(terminal_errors(sato.run("orbit", seed=seed, overrides=overrides)))
        place, speed = np.concatenate(errors, axis=1)
        row = f"{place.mean():.4f}", f"{place.max():.4f}", f"{1e3 * speed.max():.3f}"
        table.add_row(name, *row, str(given.seeds))
    console.print(table)
    return 0


def terminal_errors(run: sato.Run) -> np.ndarray:
    """Return the final position and velocity errors of every spacecraft [m, m/s]."""
    held = run.data["target_index"].values[-1]
    off = [
        run.data[name].values[-1] - run.data[f"target_{name}"].values[0, held]
        for name in ("position", "velocity")
    ]
    return np.linalg.norm(off, axis=2)


if __name__ == "__main__":
    sys.exit(main())
