"""The operator's stick: what is asked of the leader, from a script."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class WaypointStick:
    """An operator who steers for one waypoint after another, and lets go now and then."""

    waypoints: Float[Array, "waypoints 3"]  # in the world frame [m]
    speed: float = 2.0  # [m/s]
    hold_time: float = 9.0  # for which the stick is held [s],
    release_time: float = 3.0  # and then let go [s]
    arrival_radius: float = 1.0  # distance at which a waypoint is reached [m]
    time_constant: float = 0.5  # time constant of coming to a waypoint [s]

    def command_velocity(
        self, time: float, position: Array, waypoints_reached: int
    ) -> Float[Array, " 3"]:
        """Velocity asked for, in the world frame [m/s].

        Args:
            time: Since the start [s].
            position: Of the leader [m].
            reached: Number of waypoints that it has reached.
        """
        if (
            waypoints_reached >= len(self.waypoints)
            or time % (self.hold_time + self.release_time) >= self.hold_time
        ):
            return np.zeros(3)
        gap = self.waypoints[waypoints_reached] - position
        return np.asarray(
            gap * self.speed / max(np.linalg.norm(gap), self.speed * self.time_constant)
        )

    def has_arrived(self, position: Array, reached: int) -> bool:
        """Whether the leader is at its next waypoint."""
        if reached >= len(self.waypoints):
            return False
        return bool(np.linalg.norm(self.waypoints[reached] - position) < self.arrival_radius)


@dataclass(frozen=True, eq=False)
class RecordedStick:
    """A stick as it was recorded; each velocity holds until the next."""

    time: Float[Array, " k"]  # increasing [s]
    velocity: Float[Array, "k 3"]  # in the world frame [m/s]

    @property
    def waypoints(self) -> Float[Array, "0 3"]:
        """None: it steers for nothing that is known."""
        return np.zeros((0, 3))

    @property
    def speed(self) -> float:
        """The largest that is asked for [m/s]."""
        return float(np.linalg.norm(self.velocity, axis=1).max(initial=0))

    def command_velocity(self, time: float, position: Array, reached: int) -> Float[Array, " 3"]:
        """Velocity asked for, in the world frame [m/s]."""
        k = int(np.searchsorted(self.time, time, side="right")) - 1
        return self.velocity[k] if k >= 0 else np.zeros(3)

    def has_arrived(self, position: Array, reached: int) -> bool:
        """Never: there are no waypoints."""
        return False


Stick = WaypointStick | RecordedStick
