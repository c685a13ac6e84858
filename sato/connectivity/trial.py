"""What came of a flight, in a few numbers: what studies of many seeds count."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.connectivity.distance import obstacle_distances
from sato.connectivity.loop import ConnectivityFrame, simulate
from sato.connectivity.mission import Connectivity

GAP_WINDOW = 1.0  # a loss of connectivity, for which λ₃ − λ₂ is looked at [s]
IDLE_TIME = 1.0  # after which a robot that was left alone must hold [s]
DISTANCE_TOLERANCE = 1e-9  # beyond the distance at which the push of what is near begins [m]


@dataclass(frozen=True)
class ConnectivityTrial:
    """What came of a flight."""

    min_lambda2: float  # least
    disconnection_time: float  # when λ₂ first was at λ₂^min or below [s]; NaN never
    min_eigenvalue_gap: float  # least λ₃ − λ₂ in the second before; NaN if it never was
    min_separation: float  # least distance of two robots, at control steps [m]
    min_obstacle_distance: float  # least distance of a robot to an obstacle, at control steps [m]
    waypoints_reached: int  # reached by the leader
    lambda2_error: float  # |λ̂₂ − λ₂|, mean over robots that know and instants
    yaw_error_mutual: float  # |sin(Δψ/2)|, mean over pairs that see each other and instants
    yaw_error_one_sided: float  # the same, where one sees the other only, as that one has it
    max_forget_time: float  # for how long after its death a robot was counted with, the longest [s]
    max_idle_command: (
        float  # most that robots on their own ask of themselves, nothing near [m/s, rad/s]
    )

    @property
    def stayed_connected(self) -> bool:
        """Whether the swarm hung together throughout."""
        return bool(np.isnan(self.disconnection_time))


@dataclass
class _RunningMean:
    total: float = 0.0
    count: int = 0

    def add(self, values: np.ndarray) -> None:
        self.total += float(values.sum())
        self.count += values.size

    @property
    def value(self) -> float:
        return self.total / self.count if self.count else np.nan


@dataclass
class _EstimationErrors:
    lambda2_error: _RunningMean = field(default_factory=_RunningMean)
    yaw_error_mutual: _RunningMean = field(default_factory=_RunningMean)
    yaw_error_one_sided: _RunningMean = field(default_factory=_RunningMean)

    def update(self, frame: ConnectivityFrame) -> None:
        off = np.abs(frame.lambda2_estimate - frame.lambda2)[frame.alive]
        self.lambda2_error.add(off[np.isfinite(off)])
        turned = frame.relative_yaw_estimate - (frame.yaw - frame.yaw[:, None])
        wrong, sees = np.abs(np.sin(turned / 2)), frame.visibility
        self.yaw_error_mutual.add(wrong[sees & sees.T])
        self.yaw_error_one_sided.add(wrong[sees & ~sees.T])


def run_trial(mission: Connectivity, rng: np.random.Generator) -> ConnectivityTrial:
    """Fly, and judge what comes of it.

    Args:
        mission: What is flown.
        rng: Draws noise, losses, and where the power iteration begins.
    """
    return evaluate_trial(mission, simulate(mission, rng))


def evaluate_trial(mission: Connectivity, frames: Iterable[ConnectivityFrame]) -> ConnectivityTrial:
    """What came of a flight, by all its frames."""
    watch, waypoints, counted, restless = _EstimationErrors(), 0, 0.0, 0.0
    lambdas: list[tuple[float, float]] = []
    alone = np.zeros(mission.agents)  # for how long [s]
    for frame in frames:
        watch.update(frame)
        lambdas.append((frame.lambda2, frame.lambda3))
        waypoints += sum(event["kind"] == "waypoint" for event in frame.events)
        for death in mission.losses:
            if not frame.alive[death.agent] and frame.known_agents[frame.alive, death.agent].any():
                counted = max(counted, frame.time - death.time)
        alone = np.where(frame.edge_weight.any(axis=1) | ~frame.alive, 0, alone + mission.step)
        asked = np.abs(frame.command[_find_undisturbed(frame, mission, alone)])
        restless = max(restless, float(asked.max(initial=0)))
    lambda2, lambda3 = np.array(lambdas).T
    lost, gap = np.nan, np.nan
    below = lambda2 <= mission.potential.lambda2_min
    if below.any():
        first = int(np.argmax(below))
        since = max(0, first - round(GAP_WINDOW / mission.step))
        lost = first * mission.step
        gap = float((lambda3 - lambda2)[since : first + 1].min())
    return ConnectivityTrial(
        min_lambda2=float(lambda2.min()),
        disconnection_time=lost,
        min_eigenvalue_gap=gap,
        min_separation=frame.min_separation,
        min_obstacle_distance=frame.min_obstacle_distance,
        waypoints_reached=waypoints,
        lambda2_error=watch.lambda2_error.value,
        yaw_error_mutual=watch.yaw_error_mutual.value,
        yaw_error_one_sided=watch.yaw_error_one_sided.value,
        max_forget_time=counted,
        max_idle_command=restless,
    )


def _find_undisturbed(
    frame: ConnectivityFrame, mission: Connectivity, alone: Float[Array, " n"]
) -> Bool[Array, " n"]:
    # Who is alone, and has nothing near that would push.
    free = alone > IDLE_TIME
    for i in np.flatnonzero(free):
        others = np.delete(frame.position, i, axis=0)[np.delete(frame.alive, i)]
        away = np.linalg.norm(others - frame.position[i], axis=1)
        to_walls = obstacle_distances(frame.position[i], mission.obstacle_arrays)
        nearest = min(away.min(initial=np.inf), to_walls.min(initial=np.inf))
        free[i] = nearest > mission.repulsion.max_distance + DISTANCE_TOLERANCE
    return free
