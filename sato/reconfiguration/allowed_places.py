"""Starts and targets that obstacles block, or that are outside of the allowed positions.

Targets of shapes that known obstacles block are left out when a mission is drawn.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.convexify import SEPARATION_TOLERANCE
from sato.obstacles import Obstacle
from sato.scenario.errors import InputError
from sato.shapes import Points

if TYPE_CHECKING:
    from sato.reconfiguration.leg import Leg
    from sato.reconfiguration.mission import Reconfiguration

MAX_LEFT_OUT = 20  # times that a shape is drawn with more targets, for those that are left out


def check_starts(
    mission: "Reconfiguration",
    placed: Float[Array, "k d"],
    agents: Sequence[int],
    slack: float = 0.0,
    time: float = 0.0,
) -> None:
    """Refuse starts [m] in obstacles at a time [s], or out of bounds, by more than a slack [m]."""
    needed = np.array([mission.radius(i) * (1 - 1e-9) - slack for i in agents])
    names = [f"agent {i} starts" for i in agents]
    if reason := find_fault(mission, placed, needed, names, -slack, time):
        raise InputError("", f"{reason}; another start, or a smaller obstacle, would do")


def check_margin_to_obstacles(mission: "Reconfiguration") -> None:
    """Refuse starts and targets of a drawn mission that the margin puts too near to an obstacle."""
    if mission.margin <= 0:
        return
    d, start, margin = mission.axes, mission.initial_states, mission.margin
    names = [f"with a margin of {margin:.4g} m, agent {i} starts" for i in range(len(start))]
    needed = (mission.radii + margin) * (1 - 1e-9)
    cure = "farther away, or less noise, would do"
    if reason := find_fault(mission, start[:, :d], needed, names, margin):
        raise InputError("swarm.start", f"{reason}; {cure}")
    for number, leg in enumerate(mission.legs):
        radii = np.full(len(leg.targets), mission.radii.max())
        blocked = are_blocked(mission, leg.targets[:, :d], radii)
        if blocked.any():
            where = "too near to an obstacle or to the bounds"
            reason = f"with a margin of {margin:.4g} m, target {blocked.argmax()} is {where}"
            raise InputError(f"leg.{number}.shape", f"{reason}; {cure}")


def place_targets(mission: "Reconfiguration", leg: "Leg", demand: int, needed: float) -> Points:
    """Return the targets of a leg, of a shape without those that are blocked.

    There are as many as the demand, or more, and two are as far apart as is needed [m]. A list with
    a blocked target, and a shape of which too few are left, are refused.
    """
    drawn = leg.place(demand, mission.axes, needed)
    asked = len(np.asarray(drawn.positions))
    wanted = demand if leg.count else asked
    for _ in range(MAX_LEFT_OUT):
        placed = np.asarray(drawn.positions)
        is_given = mission.assignment == "given" and len(placed) == len(mission.radii)
        radii = mission.radii if is_given else np.full(len(placed), mission.radii.max())
        blocked = are_blocked(mission, placed, radii)
        if not blocked.any():
            return drawn
        if isinstance(leg.shape, Points) or is_given:
            names = [f"target {j} is" for j in range(len(placed))]
            reason = find_fault(mission, placed, radii * (1 + SEPARATION_TOLERANCE), names)
            reason = reason or f"target {blocked.argmax()} is in a margin about an obstacle"
            raise InputError("", f"{reason}; another target, or a smaller obstacle, would do")
        left = ~blocked
        if left.sum() >= wanted:
            speed = None if drawn.velocities is None else np.asarray(drawn.velocities)[left]
            return replace(drawn, positions=placed[left], velocities=speed)
        asked += wanted - int(left.sum())
        drawn = replace(leg, count=asked).place(asked, mission.axes, needed)
    raise InputError("", f"obstacles leave fewer than {wanted} targets; another place would do")


def is_free(mission: "Reconfiguration", place: Float[Array, " d"]) -> bool:
    """Tell whether any vehicle may start at a place."""
    return find_fault(mission, place[None], mission.radii.max(keepdims=True), [""]) is None


def are_blocked(
    mission: "Reconfiguration", placed: Float[Array, "k d"], radii: Float[Array, " k"]
) -> Bool[Array, " k"]:
    """Find the places that known obstacles at rest block, or that are out of bounds."""
    needed = (radii + mission.known_margin) * (1 + SEPARATION_TOLERANCE)
    blocked = ~are_inside(mission, placed, mission.known_margin)
    for obstacle in mission.obstacles:
        if obstacle.known and not obstacle.drift.any():
            blocked |= measure_distances(mission, obstacle, placed) < needed
    return blocked


def measure_distances(
    mission: "Reconfiguration", obstacle: Obstacle, placed: Float[Array, "k d"]
) -> Float[Array, " k"]:
    """Measure distances from an obstacle, of which vehicles keep R [m]."""
    if mission.separation_scale is None:
        return obstacle.distances(placed)
    return obstacle.scaled(mission.separation_scale).distances(mission.scale_separations(placed))


def are_inside(
    mission: "Reconfiguration", placed: Float[Array, "k d"], margin: float = 0.0
) -> Bool[Array, " k"]:
    """Find the places that are within the allowed positions, by a margin."""
    if mission.box is None:
        return np.ones(len(placed), dtype=bool)
    low, high = np.asarray(mission.box)
    return np.asarray(((placed >= low + margin) & (placed <= high - margin)).all(axis=1))


def find_fault(
    mission: "Reconfiguration",
    placed: Float[Array, "k d"],
    needed: Float[Array, " k"],
    names: list[str],
    margin: float = 0.0,
    time: float = 0.0,
) -> str | None:
    """Say which place is nearer to an obstacle than is needed, or out of bounds; None if none."""
    outside = np.flatnonzero(~are_inside(mission, placed, margin))
    if len(outside):
        return f"{names[outside[0]]} outside of the allowed positions, model.box_m"
    for number, obstacle in enumerate(mission.obstacles):
        away = measure_distances(mission, obstacle, placed - time * obstacle.drift)
        near = np.flatnonzero(away < needed)
        if len(near):
            i = int(near[0])
            article = "an" if obstacle.kind[0] in "aeiou" else "a"
            found = f"{names[i]} {away[i]:.8g} m from obstacle {number}, {article} {obstacle.kind}"
            return f"{found}, and has to keep {needed[i]:.8g} m"
    return None
