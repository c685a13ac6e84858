"""Definition of a connectivity mission: robots that follow a leader and stay connected."""

from dataclasses import dataclass, replace
from functools import cached_property
from math import hypot
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.kinematic import KinematicVehicle
from dynamics.quadrotor import Quadrotor
from dynamics.units import Key, Length, Time, Unit
from problems.interaction_graph import Camera
from sato.connectivity import feasibility, settings
from sato.connectivity.obstacles import Obstacles, Plane, RandomSpheres
from sato.connectivity.start import Poses, RandomPoses, as_poses
from sato.connectivity.stick import RecordedStick, WaypointStick
from sato.network.link import Link
from sato.obstacles import Box, Sphere
from sato.scenario.definition import (
    HALF_TURN,
    LATER,
    TURNS,
    Convert,
    Definition,
    In,
    Matrix,
    NotNegative,
    Positive,
    Vector,
    errors_in,
)
from sato.scenario.errors import InputError
from sato.scenario.file import Mission
from sato.scenario.ranges import check_memory

OMNIDIRECTIONAL = (-3.0, -2.0)  # a_min, a_max of a robot that ignores its field of view
DEFAULT_AGENTS = 6


@dataclass(frozen=True, eq=False, repr=False)
class AgentLoss(Definition):
    """Loss of a robot; what is absent is drawn."""

    agent: Annotated[int, Key("robot"), NotNegative, "index"] = LATER
    time: Annotated[Time, NotNegative, "time of the loss"] = LATER


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Connectivity(Mission):
    """Robots with cameras that follow a leader and stay connected [Bernard2023].

    Args:
        agents: Number of robots.
        start: Array of (N, 3) positions, or a definition of poses.
        yaw: Yaw of each robot, where positions are given.

    All others are explained by `sato keys connectivity`. Values are in SI units.
    """

    system: ClassVar[str] = "connectivity"

    agents: Annotated[int, In("swarm"), Ge(2), "number of robots; 6 if absent"] = LATER
    start: Annotated[RandomPoses | Poses, In("swarm"), Convert(as_poses), "initial poses"] = (
        RandomPoses()
    )
    yaw: Annotated[Vector, In("swarm"), Unit("rad"), TURNS, "yaw of each robot at the start"] = (
        LATER
    )
    yaw_error: Annotated[
        Annotated[float, NotNegative, HALF_TURN] | Matrix,
        In("swarm"),
        Unit("rad"),
        TURNS,
        "error of the first estimates of relative yaw: one for each pair, or drawn up to a bound",
    ] = 0.5

    camera: Annotated[Camera, "cameras"] = Camera()
    range_only: Annotated[
        bool, In("camera"), Key("blind"), "weigh edges by range alone, not by the field of view"
    ] = False
    occlusion: Annotated[bool, In("camera"), "robots and obstacles block the line of sight"] = False
    body_radius: Annotated[
        Length, In("camera"), Key("body"), Positive, "radius of a robot that blocks it"
    ] = 0.3

    potential: Annotated[settings.Potential, "potential of λ₂"] = settings.Potential()
    repulsion: Annotated[settings.Repulsion, "repulsion of robots and obstacles"] = (
        settings.Repulsion()
    )
    tracking: Annotated[settings.YawTracking, "estimator of relative yaw"] = settings.YawTracking()
    limits: Annotated[settings.CommandLimits, "limits of what a robot commands"] = (
        settings.CommandLimits()
    )
    link: Annotated[Link, "messages, all as late as any"] = Link()
    estimator: Annotated[
        Literal["flood", "exact", "power_pi"], In("estimator"), Key("kind"), "estimator of λ₂"
    ] = "flood"
    power_iteration: Annotated[
        settings.PowerIterationGains, Key("estimator"), "gains of power_pi"
    ] = settings.PowerIterationGains()
    plant: Annotated[KinematicVehicle | Quadrotor, "motion that is flown"] = KinematicVehicle()
    camera_noise: Annotated[
        Length, In("noise"), Key("camera"), NotNegative, "of each coordinate that a camera measures"
    ] = 0.0
    stick: Annotated[WaypointStick | RecordedStick, "stick of the operator"] = WaypointStick()
    random_obstacles: Annotated[RandomSpheres, Key("obstacles"), "random ones"] = RandomSpheres()
    obstacles: Annotated[tuple[Sphere | Box | Plane, ...], Key("obstacle"), "obstacles"] = ()
    losses: Annotated[tuple[AgentLoss, ...], Key("death"), "robots that are lost"] = ()
    duration: Annotated[Time, In("run"), Positive, "duration, to the nearest step"] = 150.0
    step: Annotated[Time, In("run"), Positive, "control step"] = 0.02

    def completed(self) -> dict[str, Any]:
        """Return the number of agents, the yaw of listed poses, and a unit optical axis.

        Raises:
            InputError: The yaw is given twice, or without positions.
        """
        values: dict[str, Any] = {}
        if isinstance(self.start, Poses):
            if self.start.yaw is not None:
                if self.yaw is not None:
                    raise InputError("swarm.yaw_rad", "is given twice; the start has it too")
                values |= {"start": replace(self.start, yaw=None), "yaw": self.start.yaw}
        elif self.yaw is not None:
            raise InputError("swarm.yaw_rad", "needs a start with positions")
        if self.agents is None:
            listed = isinstance(self.start, Poses)
            values["agents"] = len(self.start.positions) if listed else DEFAULT_AGENTS
        size = hypot(*self.camera.optical_axis)
        # A unit vector stays what it is to the last bit, so that a file gives the same mission.
        if 1e-6 < size < 1e6 and abs(size - 1) > 1e-12:
            axis = tuple(a / size for a in self.camera.optical_axis)
            values["camera"] = self.camera._replace(optical_axis=axis)
        return values

    def choices(self) -> dict[str, Any]:
        """Return the potential of what the estimator knows, where it is not given."""
        if self.potential.of is not None:
            return {}
        of = "lambda2" if self.estimator == "power_pi" else "spectrum"
        return {"potential": self.potential._replace(of=of)}

    def check(self) -> None:
        """Refuse fields that contradict each other."""
        feasibility.check_settings(self)
        feasibility.check_sampling(self)
        feasibility.check_losses(self)
        feasibility.check_obstacles(self)
        if np.ndim(self.yaw_error) and np.shape(self.yaw_error) != (self.agents, self.agents):
            raise InputError("swarm.yaw_error_rad", f"needs {self.agents} x {self.agents} errors")
        if isinstance(self.start, Poses):
            feasibility.check_start(self)

    def draw(self, rng: np.random.Generator) -> "Connectivity":
        """Return the mission with drawn poses, yaw errors, waypoints, obstacles and losses."""
        n, error, poses = self.agents, self.yaw_error, self.start
        check_memory(n, lambda agents: feasibility.memory_demand(self, agents))
        if isinstance(poses, RandomPoses):
            with errors_in("swarm.start"):
                poses = poses.draw(n, self.camera, rng)
        posed = replace(self, start=poses, **self.choices())
        start = posed.initial_position
        if not np.ndim(error):
            error = rng.uniform(-error, error, (n, n))
        with errors_in("stick"):
            stick = self.stick.draw(start[0], rng)
            if isinstance(stick, RecordedStick):
                stick.require_command(self.duration)
        with errors_in("obstacles"):
            nearest = self.repulsion.min_distance
            places = np.zeros((0, 3)) if stick.waypoints is None else stick.waypoints
            spheres = self.random_obstacles.draw(start, places, nearest, rng)
        return replace(
            posed,
            yaw_error=error,
            stick=stick,
            random_obstacles=replace(self.random_obstacles, count=0),
            obstacles=(*self.obstacles, *spheres),
            losses=self._draw_losses(rng),
            power_iteration=self.gains,
        )

    def warnings(self) -> list[str]:
        """List doubts about a drawn mission, a sentence each."""
        return feasibility.doubts(self)

    def without_files(self) -> "Connectivity":
        """Return the same mission with the contents of a recorded stick's file."""
        if isinstance(self.stick, WaypointStick):
            return self
        with errors_in("stick"):
            return replace(self, stick=self.stick.without_file())

    @property
    def initial_position(self) -> Float[Array, "agents 3"]:
        """Initial positions [m], once the mission is drawn."""
        if not isinstance(self.start, Poses):
            raise ValueError("the start is known once the mission is drawn: mission.draw(rng)")
        return self.start.positions

    @property
    def initial_relative_yaw(self) -> Float[Array, "agents agents"]:
        """First estimates of relative yaw [rad], once the mission is drawn."""
        return np.asarray(self.yaw - self.yaw[:, None] + self.yaw_error)

    @property
    def gains(self) -> settings.PowerIterationGains:
        """Gains of the power iteration, with those that are not given."""
        return settings.complete_gains(self.power_iteration, self.agents)

    @cached_property
    def timed_link(self) -> Link:
        """Link with the time that a round of messages takes."""
        return self.link.over(self.link.period_steps * self.step)

    @cached_property
    def obstacle_arrays(self) -> Obstacles:
        """Obstacles as arrays, once the mission is drawn."""
        return Obstacles.of(self.obstacles)

    @cached_property
    def assumed_camera(self) -> Camera:
        """Camera that robots assume; it sees all around where they ignore the field of view."""
        a_min, a_max = OMNIDIRECTIONAL
        return self.camera._replace(a_min=a_min, a_max=a_max) if self.range_only else self.camera

    def _draw_losses(self, rng: np.random.Generator) -> tuple[AgentLoss, ...]:
        named = [loss.agent for loss in self.losses]
        left = [i for i in range(self.agents) if i not in named]
        drawn = []
        for loss in self.losses:
            agent = left.pop(int(rng.integers(len(left)))) if loss.agent is None else loss.agent
            time = rng.uniform(0, self.duration) if loss.time is None else loss.time
            drawn.append(replace(loss, agent=agent, time=float(time)))
        return tuple(drawn)
