"""Vehicles on a ring that change places, without an auction: only avoidance resolves it."""

from typing import Any

import numpy as np

import sato
from sato.formation.settings import AssignmentSettings, FrameSettings

SPACING = 2.4  # along the ring [m]


def fly(rng: np.random.Generator, agents: int, noise_m: float) -> dict[str, Any]:
    """Fly a ring in another order of its vehicles.

    Args:
        rng: Generator of the order.
        agents: Number of vehicles.
        noise_m: Standard deviation of a measured coordinate [m].
    """
    turn = np.exp(2j * np.pi * np.arange(agents) / agents)
    flat = SPACING * agents / (2 * np.pi) * turn
    ring = np.stack([flat.real, flat.imag, np.zeros(agents)], axis=1)
    flown = sato.run(
        sato.Formation(
            start=ring,
            legs=[sato.FormationLeg(ring[rng.permutation(agents)])],
            assignment=AssignmentSettings("none"),
            frames=FrameSettings(noise=noise_m, drift=0.0),
        ),
        seed=int(rng.integers(2**32)),
    )
    names = "success", "min_separation_m", "time_s", "path_m"
    return {name: flown.summary[name] for name in names}
