"""Along-track drift of initial velocities under J2: python scripts/invariant_drift.py.

Eight points on a circle of a kilometer in the chief's plane, for fifteen orbits, from every
argument of latitude.
"""

import argparse
import sys

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from dynamics import ClohessyWiltshire
from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
from dynamics.j2 import invariant_velocity
from dynamics.orbit import Orbit
from dynamics.propagation import propagate


def along_track_drift(orbit: Orbit, place: np.ndarray, velocity: np.ndarray, orbits: int) -> float:
    """Return the largest drift of the mean along-track position [m per orbit]."""
    phase = np.arange(16) / 16
    times = orbit.period * np.concatenate([phase, orbits - 1 + phase])
    start = np.array(orbit.initial_elements)
    deputies = LVLH.from_polar_nodal(start, orbit.k_J2).to_inertial(np.hstack([place, velocity]))
    flown = propagate(np.vstack([inertial_state(start), deputies]), times, accuracy=1e-12)
    frames = LVLH.from_polar_nodal(to_polar_nodal(flown[:, 0]), orbit.k_J2)
    along = frames.from_inertial(flown[:, 1:])[..., 1].reshape(2, 16, -1).mean(axis=1)
    return float(np.abs(along[1] - along[0]).max()) / (orbits - 1)


def main() -> int:
    """Print the table; 1 if the J2-invariant velocities drift by more than 0.1 m an orbit."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--every", type=float, default=15.0, help="degrees of latitude")
    options.add_argument("--orbits", type=int, default=15)
    given = options.parse_args()
    angle = np.arange(8) * np.pi / 4
    ring = 1e3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    console = Console()
    table = Table("latitude [deg]", "J2-invariant [m/orbit]", "Clohessy-Wiltshire [m/orbit]")
    worst = 0.0
    for latitude in track(np.arange(0.0, 360.0, given.every), "flying", console=console):
        at = np.radians(latitude)
        orbit = Orbit.from_elements(6878e3, inclination=np.pi / 4, true_anomaly=float(at))
        ours = along_track_drift(orbit, ring, invariant_velocity(orbit, ring), given.orbits)
        theirs = ClohessyWiltshire.from_orbit(orbit).centered_velocity(ring)
        worst = max(worst, ours)
        plain = along_track_drift(orbit, ring, theirs, given.orbits)
        table.add_row(f"{latitude:g}", f"{ours:.4f}", f"{plain:.1f}")
    console.print(table)
    console.print(f"worst J2-invariant: {worst:.4f} m an orbit")
    return int(worst > 0.1)


if __name__ == "__main__":
    sys.exit(main())
