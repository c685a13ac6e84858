"""Random missions with automatic numbers of steps: python scripts/study_automatic_steps.py.

Two to eight vehicles in the plane or in space, from rest or in motion, with and without a
speed limit that binds; lists of their own and shapes, in one to
three legs, by auction or with given targets. Each is flown with 1.5 times the least number of
steps, and one step less than the least of the first leg must be refused.
"""

import argparse
import sys
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

import sato


def scattered(rng: np.random.Generator, count: int, axes: int) -> np.ndarray:
    """Draw points of a grid that are 3 m apart, moved by up to half a meter."""
    cells = np.stack(np.unravel_index(rng.permutation(6**axes)[:count], (6,) * axes), axis=1)
    return 3.0 * cells + rng.uniform(-0.5, 0.5, (count, axes))


def draw_mission(rng: np.random.Generator) -> dict[str, Any]:
    """Draw the fields of a mission."""
    agents, axes = int(rng.integers(2, 9)), int(rng.integers(2, 4))
    assignment = str(rng.choice(["auction", "given"]))
    start = scattered(rng, agents, axes)
    if rng.random() < 0.5:
        start = np.hstack([start, rng.uniform(-0.2, 0.2, start.shape)])
    more = 0 if assignment == "given" else int(rng.integers(0, agents + 1))
    shapes = [scattered(rng, agents + more, axes) + rng.uniform(-8, 8, axes) for _ in range(3)]
    legs = [sato.Leg(shape, "auto") for shape in shapes[: rng.integers(1, 4)]]
    if rng.random() < 0.5:
        legs[-1] = sato.Leg(sato.Ring(spacing=2.0), "auto")
    return {
        "model": sato.DoubleIntegrator(axes),
        "start": start,
        "legs": legs,
        "step": 2.0,
        "comm_radius": 300.0,
        "collision_radius": 0.5,
        "max_control": 0.05,
        "max_speed": float(rng.choice([0.5, 5.0])),
        "assignment": assignment,
        "foresight_steps": 200,  # the whole leg
    }


def least_steps(fields: dict[str, Any]) -> int:
    """Return the least number of steps of the first leg, alone."""
    first = replace(fields["legs"][0], time_factor=1.0)
    mission = sato.Reconfiguration(**fields | {"legs": [first]})
    return mission.draw(np.random.default_rng(0)).legs[0].steps


def is_refused(fields: dict[str, Any], steps: int) -> bool:
    """Tell whether the first leg is refused with a number of steps."""
    if steps == 0:
        return True
    first = replace(fields["legs"][0], steps=steps)
    try:
        sato.Reconfiguration(**fields | {"legs": [first]}).draw(np.random.default_rng(0))
    except sato.InputError as error:
        return str(error).startswith("leg.0.steps")
    return False


def main() -> int:
    """Fly the missions; return 1 if any does not reach its targets, or is not the least."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--missions", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    counts: Counter[str] = Counter()
    for number in track(range(options.missions), "missions", console=Console(stderr=True)):
        fields = draw_mission(np.random.default_rng((options.seed, number)))
        least = least_steps(fields)
        run = sato.run(sato.Reconfiguration(**fields), seed=0)
        found = {
            "reached": run.summary["reached"],
            "in the steps planned": not any(leg["resets"] for leg in run.summary["legs"]),
            "one step less than the least refused": is_refused(fields, least - 1),
            "the least itself taken": not is_refused(fields, least),
            "kept": run.check().kept,
        }
        counts.update(name for name, holds in found.items() if holds)
        if not all(found.values()):
            failed = [name for name, holds in found.items() if not holds]
            print(f"mission {number}, least {least}: not {', '.join(failed)}", flush=True)
    for name in found:
        print(f"{name}: {counts[name]} of {options.missions}")
    needed = ("reached", "one step less than the least refused", "the least itself taken")
    return int(any(counts[name] < options.missions for name in needed))


if __name__ == "__main__":
    sys.exit(main())
