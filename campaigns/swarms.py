"""Swarms drawn from ranges, which `missions.py` explains, and places for them."""

from typing import Any
from zlib import crc32

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.distance import pdist

import sato

Range = tuple[float, float]
RANGES: dict[str, Range] = {
    "radius": (0.2, 2.0),
    "step": (0.2, 2.0),
    "travel": (0.4, 1.2),
    "braking": (2.0, 8.0),
    "room": (2.0, 4.0),
    "start_gap": (1.2, 1.5),
    "target_gap": (1.2, 2.0),
    "reach": (1.05, 3.0),
    "time": (1.2, 2.0),
}
LOGARITHMIC = "radius", "step"
HORIZON = 4  # steps, the default


class Draw:
    """A swarm drawn from the ranges, those of a family in place of the general ones."""

    def __init__(self, family: str, rng: np.random.Generator, **ranges: Range) -> None:
        # Trials of a campaign give all families the same stream; each takes its own of it.
        rng = np.random.default_rng([int(rng.integers(2**32)), crc32(family.encode())])
        self.rng, self.axes = rng, int(rng.integers(2, 4))
        self.count = int(np.exp(rng.uniform(np.log(2), np.log(61))))
        for name, (low, high) in (RANGES | ranges).items():
            is_log = name in LOGARITHMIC
            value = np.exp(rng.uniform(np.log(low), np.log(high))) if is_log else None
            setattr(self, name, rng.uniform(low, high) if value is None else value)
        self.speed = self.travel * self.radius / self.step
        self.control = self.speed / self.braking / self.step
        self.side = self.room * self.radius * self.count ** (1 / self.axes)
        self.is_given = bool(rng.random() < 1 / 3)

    def points(self, gap: float, count: int | None = None, side: float | None = None) -> Array:
        """Draw places in the box, a gap apart [R]."""
        radii = np.full(count or self.count, gap * self.radius)
        return place(self.rng, radii, side or self.side, self.axes)

    def targets(self) -> Any:
        """Draw points, a lattice or a ring beside the starts."""
        center = self.rng.uniform(-self.side / 2, self.side / 2, self.axes)
        shape = self.rng.choice(["points", "lattice", "ring"])
        if shape == "points":
            return center + self.points(self.target_gap)
        options = {"center": tuple(center), "spacing": self.target_gap * self.radius}
        return sato.Lattice(**options) if shape == "lattice" else sato.Ring(**options)

    def leg(self, targets: Any, **events: Any) -> sato.Leg:
        """Return a leg with automatic steps."""
        return sato.Leg(targets, "auto", time_factor=self.time, **events)

    def mission(self, start: Array, targets: Any, **changed: Any) -> sato.Reconfiguration:
        """Return the mission; values of the swarm and of the plan may be changed."""
        speed = float(np.max(changed.get("max_speed", self.speed)))
        horizon = changed.get("horizon_steps", HORIZON)
        unseen = 2 * speed * horizon * self.step
        unseen += float(np.max(changed.get("collision_radius", self.radius)))
        values: dict[str, Any] = {
            "model": sato.DoubleIntegrator(self.axes),
            "start": start,
            "legs": () if targets is None else [self.leg(targets)],
            "step": self.step,
            "comm_radius": self.reach * unseen,
            "collision_radius": self.radius,
            "max_control": self.control,
            "max_speed": self.speed,
            "assignment": "given" if self.is_given else "auction",
        }
        return sato.Reconfiguration(**values | changed)


def place(
    rng: np.random.Generator, radii: Float[Array, " k"], side: float, axes: int
) -> Float[Array, "k d"]:
    """Draw points in a box, two at least (R_i + R_j)/2 apart; a larger box where it is full."""
    placed: list[Array] = []
    while len(placed) < len(radii):
        side *= 1.001
        point, own = rng.uniform(-side / 2, side / 2, axes), radii[len(placed)]
        required = (radii[: len(placed)] + own) / 2
        if not placed or (np.linalg.norm(np.array(placed) - point, axis=1) >= required).all():
            placed.append(point)
    return np.array(placed)


def spread(count: int, axes: int, gap: float) -> tuple[Array, float]:
    """Return unit vectors around a circle or a sphere, and the radius at which they are so apart.

    It is two gaps at least.
    """
    k = np.arange(count)
    angle = 2 * np.pi * k / count if axes == 2 else np.pi * (1 + 5**0.5) * k
    height = np.zeros(count) if axes == 2 else 1 - (2 * k + 1) / count
    wide = np.sqrt(1 - height**2)
    unit = np.column_stack([wide * np.cos(angle), wide * np.sin(angle), height])[:, :axes]
    return unit, max(gap / float(pdist(unit).min()), 2 * gap)
