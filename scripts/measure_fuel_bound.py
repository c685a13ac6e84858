"""Distance from the chief up to which `fuel_lower_bound_m_s` bounds the fuel.

The bound is of one linearization about the chief, and the flight is not. One spacecraft at rest on
the chief's circle, a distance ahead of it, is flown under J2 to a place 2 km farther ahead or back,
in 24 minutes, with a limit of the control that binds and one that does not. It has nothing to
avoid, so that only the linearization separates its fuel from the bound. Prints fuel over bound for
both ways, and by how much of the bound `sato check` finds the fuel too small. Exit code 1 where the
fuel within 2 km of the chief is below 0.999 of its bound.
"""

import sys
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from written_tables import ROOT, write_table

import sato

LIMITS = (5e-3, 0.1)  # of the control [m/s²]
DISTANCES = (0.0, 1e3, 2e3, 5e3, 10e3, 20e3, 50e3, 100e3)  # along the track [m]
RADIUS = 7000e3  # of the chief's orbit [m]


def on_the_circle(distance: float) -> np.ndarray:
    """Return the state at rest on the chief's circle, ahead of it."""
    angle = distance / RADIUS
    return RADIUS * np.array([[np.cos(angle) - 1, np.sin(angle), 0.0, 0.0, 0.0, 0.0]])


def fly(distance: float, way: float, max_control: float) -> tuple[float, float]:
    """Return the fuel over its bound, NaN if the target was not reached, and what check lacks."""
    mission = sato.Reconfiguration(
        model=sato.J2(sato.Orbit.from_elements(RADIUS, inclination=np.radians(51.6))),
        start=on_the_circle(distance),
        legs=[sato.Leg(on_the_circle(distance + way), steps=24)],
        step=60.0,
        comm_radius=1e6,
        collision_radius=50.0,
        max_control=max_control,
        max_speed=50.0,
        tie_break=0.0,
    )
    run = sato.run(mission)
    (lacking,) = (promise.value for promise in run.check().promises if promise.name == "fuel")
    ratio = run.summary["fuel_m_s"] / run.summary["fuel_lower_bound_m_s"]
    return float(ratio) if run.summary["reached"] else float("nan"), lacking


def main(
    write: Annotated[bool, typer.Option("--write", help="Replace the table of the page.")] = False,
) -> None:
    """Print the table."""
    names = (
        f"{limit * 1e3:g} mm/s²: {name}"
        for limit in LIMITS
        for name in ("2 km ahead", "2 km back", "missed in check")
    )
    table = Table("distance from the chief [km]", *names)
    is_wrong = False
    for distance in DISTANCES:
        row = []
        for limit in LIMITS:
            (ahead, _), (back, lacking) = (fly(distance, way, limit) for way in (2e3, -2e3))
            row += [f"{ahead:.4f}", f"{back:.4f}", f"{lacking:.0e}"]
            is_wrong |= distance <= 2e3 and not min(ahead, back) > 0.999
        table.add_row(f"{distance / 1e3:g}", *row)
    Console().print(table)
    if write:
        write_table(table, "scripts/measure_fuel_bound.py", ROOT / "docs/orbit.md")
    sys.exit(is_wrong)


if __name__ == "__main__":
    typer.run(main)
