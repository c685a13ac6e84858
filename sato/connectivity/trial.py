"""Trial: a simulation reduced to the numbers that studies of many seeds count."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.connectivity.check.recorded import ConnectivityRecord, nearest_agent_distance
from sato.connectivity.loop import simulate
from sato.connectivity.mission import Connectivity
from sato.connectivity.obstacles import obstacle_distances

GAP_WINDOW = 1.0  # time before a loss of connectivity in which λ₃ − λ₂ is looked at [s]
IDLE_TIME = 1.0  # time after which an isolated agent must hold [s]
DISTANCE_TOLERANCE = 1e-9  # beyond the distance at which repulsion begins [m]


class ConnectivityTrial(NamedTuple):
    """Outcome of a simulation."""

    summary: dict[str, Any]  # see `ConnectivityRecord.summarize_flight`
    disconnection_time: float  # first time at which λ₂ ≤ λ₂^min [s]; NaN never
    min_eigenvalue_gap: float  # least λ₃ − λ₂ in the second before; NaN if never
    max_forget_time: float  # longest time for which a lost agent was counted on [s]
    max_idle_command: float  # largest command of isolated agents with nothing near [m/s, rad/s]

    @property
    def stayed_connected(self) -> bool:
        """True where λ₂ stayed above λ₂^min."""
        return bool(np.isnan(self.disconnection_time))


def run_trial(mission: Connectivity, rng: np.random.Generator) -> ConnectivityTrial:
    """Simulate a drawn mission and evaluate its frames."""
    record = ConnectivityRecord.from_frames(list(simulate(mission, rng)), mission)
    frames, lost, gap = record.frames, np.nan, np.nan
    below = frames.lambda2 <= mission.potential.lambda2_min
    if below.any():
        first = int(np.argmax(below))
        since = max(0, first - round(GAP_WINDOW / mission.step))
        lost = first * mission.step
        gap = float((frames.lambda3 - frames.lambda2)[since : first + 1].min())
    forget, idle = _max_forget_time(record), _max_idle_command(record)
    return ConnectivityTrial(record.summarize_flight(), lost, gap, forget, idle)


def _max_forget_time(record: ConnectivityRecord) -> float:
    frames, longest = record.frames, 0.0
    for loss in record.mission.losses:
        is_known = (frames.known_agents[..., loss.agent] & frames.alive).any(axis=1)
        times = frames.time[is_known & ~frames.alive[:, loss.agent]]
        longest = max(longest, float((times - loss.time).max(initial=0.0)))
    return longest


def _max_idle_command(record: ConnectivityRecord) -> float:
    frames, mission = record.frames, record.mission
    position = np.where(frames.alive[..., None], frames.position, np.nan)
    distance = np.nan_to_num(nearest_agent_distance(position), nan=np.inf)
    for walls in np.moveaxis(obstacle_distances(position, mission.obstacle_arrays), -1, 0):
        distance = np.fmin(distance, walls)
    is_isolated = ~frames.edge_weight.any(axis=2) & frames.alive
    idle = _durations(is_isolated, mission.step) > IDLE_TIME
    idle &= distance > mission.repulsion.max_distance + DISTANCE_TOLERANCE
    command = np.maximum(np.abs(frames.velocity_command).max(axis=2), np.abs(frames.yaw_rate))
    return float(command[idle].max(initial=0.0))


def _durations(holds: Array, step: float) -> Float[Array, "instants agents"]:
    # Time for which a condition has held without a break.
    found, time = np.zeros(holds.shape), np.zeros(holds.shape[1])
    for k, now in enumerate(holds):
        found[k] = time = np.where(now, time + step, 0.0)
    return found
