"""Count survivors that pass lost vehicles closer than R_col: python debris.py DIR/run.nc.

Lost vehicles do not vanish here: each coasts on from where it fell silent.
"""

import sys

import h5py
import numpy as np
from judge import lost_agents, passes


def main(file: str) -> None:
    """Print how many lost vehicles are passed closer than the collision radius."""
    with h5py.File(file) as run:
        t, x, v, u = (run[n][:] for n in ("time", "position", "velocity", "applied_control"))
        alive = run["alive"][:].astype(bool)
        radius = float(np.atleast_1d(run.attrs["collision_radius_m"])[0])
    least, pairs, lost = np.inf, set(), lost_agents(alive)
    for each in lost:
        for survivor, distance in passes(each, t, x, v, np.nan_to_num(u), alive, radius):
            least = min(least, distance)
            if distance < radius:
                pairs.add((each[1], survivor))
    wrecks, survivors = ({pair[side] for pair in pairs} for side in (0, 1))
    print(
        f"{len(lost)} lost; {len(wrecks)} of them are passed closer than R_col = {radius} m, by "
        f"{len(survivors)} survivors; least distance {least:.4f} m"
    )


if __name__ == "__main__":
    main(sys.argv[1])
