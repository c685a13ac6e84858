"""Missions that several tests of connectivity fly."""

import numpy as np

from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.connectivity.loop import simulate
from sato.connectivity.mission import Connectivity
from sato.connectivity.obstacles import Sphere
from sato.connectivity.stick import RecordedStick

IDLE = RecordedStick(np.zeros(1), np.zeros((1, 3)))


def posed(position, yaw, estimate=None, stick=IDLE, **settings):
    """Build a mission from poses and the first estimates of relative yaw; exact if absent."""
    error = np.zeros((len(yaw), len(yaw)))
    if estimate is not None:
        error = estimate - (yaw - yaw[:, None])
    return Connectivity(start=position, yaw=yaw, yaw_error=error, stick=stick, **settings)


def connected_poses(rng, camera=None, agents=6):
    """Draw poses apart from each other whose graph is connected."""
    while True:
        position = rng.uniform(0, 1, (agents, 3)) * [8, 8, 3] + [0, 0, 3]
        yaw = rng.uniform(-np.pi, np.pi, agents)
        gap = np.linalg.norm(position[:, None] - position, axis=2) + 9 * np.eye(agents)
        weights = interaction_graph(position, yaw, camera or Camera()).weights
        if gap.min() > 1.8 and algebraic_connectivity(weights).lambda2 > 0.05:
            return position, yaw


def spheres(rows):
    """Turn rows of center and radius into obstacles."""
    return tuple(Sphere(tuple(row[:3]), row[3]) for row in rows)


def fly(mission, seed=0):
    """Fly a mission; return its frames."""
    return list(simulate(mission, np.random.default_rng(seed)))
