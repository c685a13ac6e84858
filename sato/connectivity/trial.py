"""What came of a flight, in a few numbers: what studies of many seeds count."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.connectivity.distance import to_obstacles
from sato.connectivity.flight import Frame, fly
from sato.connectivity.mission import ConnectivityFlight

BEFORE = 1.0  # a loss of connectivity, for which λ₃ − λ₂ is looked at [s]
SETTLED = 1.0  # after which a robot that was left alone must hold [s]
CLEAR = 1e-9  # beyond the distance at which the push of what is near begins [m]


@dataclass(frozen=True)
class Trial:
    """What came of a flight."""

    lambda2: float  # least
    lost: float  # when λ₂ first was at λ₂^min or below [s]; NaN never
    gap: float  # least λ₃ − λ₂ in the second before; NaN if it never was
    robots: float  # least distance of two robots, at control steps [m]
    obstacles: float  # least distance of a robot to an obstacle, at control steps [m]
    waypoints: int  # reached by the leader
    error: float  # |λ̂₂ − λ₂|, mean over robots that know and instants
    mutual: float  # |sin(Δψ/2)|, mean over pairs that see each other and instants
    one_sided: float  # the same, where one sees the other only, as that one has it
    counted: float  # for how long after its death a robot was counted with, the longest [s]
    restless: float  # most that robots on their own ask of themselves, nothing near [m/s, rad/s]

    @property
    def kept(self) -> bool:
        """Whether the swarm hung together throughout."""
        return bool(np.isnan(self.lost))


@dataclass
class _Mean:
    total: float = 0.0
    count: int = 0

    def add(self, values: np.ndarray) -> None:
        self.total += float(values.sum())
        self.count += values.size

    @property
    def value(self) -> float:
        return self.total / self.count if self.count else np.nan


@dataclass
class _Watch:
    error: _Mean = field(default_factory=_Mean)
    mutual: _Mean = field(default_factory=_Mean)
    one_sided: _Mean = field(default_factory=_Mean)

    def look(self, frame: Frame) -> None:
        off = np.abs(frame.lambda2_estimate - frame.lambda2)[frame.alive]
        self.error.add(off[np.isfinite(off)])
        turned = frame.turned - (frame.yaw - frame.yaw[:, None])
        wrong, sees = np.abs(np.sin(turned / 2)), frame.sees
        self.mutual.add(wrong[sees & sees.T])
        self.one_sided.add(wrong[sees & ~sees.T])


def fly_trial(mission: ConnectivityFlight, rng: np.random.Generator) -> Trial:
    """Fly, and judge what comes of it.

    Args:
        mission: What is flown.
        rng: Draws noise, losses, and where the power iteration begins.
    """
    return judged(mission, fly(mission, rng))


def judged(mission: ConnectivityFlight, frames: Iterable[Frame]) -> Trial:
    """What came of a flight, by all its frames."""
    watch, waypoints, counted, restless = _Watch(), 0, 0.0, 0.0
    lambdas: list[tuple[float, float]] = []
    alone = np.zeros(mission.agents)  # for how long [s]
    for frame in frames:
        watch.look(frame)
        lambdas.append((frame.lambda2, frame.lambda3))
        waypoints += sum(event["kind"] == "waypoint" for event in frame.events)
        for death in mission.deaths:
            if not frame.alive[death.robot] and frame.counts[frame.alive, death.robot].any():
                counted = max(counted, frame.time - death.time)
        alone = np.where(frame.edge_weight.any(axis=1) | ~frame.alive, 0, alone + mission.step)
        asked = np.abs(frame.command[_undisturbed(frame, mission, alone)])
        restless = max(restless, float(asked.max(initial=0)))
    lambda2, lambda3 = np.array(lambdas).T
    lost, gap = np.nan, np.nan
    below = lambda2 <= mission.potential.least
    if below.any():
        first = int(np.argmax(below))
        since = max(0, first - round(BEFORE / mission.step))
        lost = first * mission.step
        gap = float((lambda3 - lambda2)[since : first + 1].min())
    return Trial(
        lambda2=float(lambda2.min()),
        lost=lost,
        gap=gap,
        robots=frame.robot_distance,
        obstacles=frame.obstacle_distance,
        waypoints=waypoints,
        error=watch.error.value,
        mutual=watch.mutual.value,
        one_sided=watch.one_sided.value,
        counted=counted,
        restless=restless,
    )


def _undisturbed(
    frame: Frame, mission: ConnectivityFlight, alone: Float[Array, " n"]
) -> Bool[Array, " n"]:
    # Who is alone, and has nothing near that would push.
    free = alone > SETTLED
    for i in np.flatnonzero(free):
        others = np.delete(frame.position, i, axis=0)[np.delete(frame.alive, i)]
        away = np.linalg.norm(others - frame.position[i], axis=1)
        to_walls = to_obstacles(frame.position[i], mission.obstacles)
        nearest = min(away.min(initial=np.inf), to_walls.min(initial=np.inf))
        free[i] = nearest > mission.repulsion.farthest + CLEAR
    return free
