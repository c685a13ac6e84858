"""Keeping together: the frozen scenario of SYSTEM 3."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.kinematic import KinematicVehicle
from dynamics.quadrotor import Quadrotor
from problems.interaction_graph import Camera, algebraic_connectivity, interaction_graph
from sato.connectivity.kernel import EXACT, FLOOD, POWER, CommandLimits, SwarmParameters
from sato.connectivity.messages import CommunicationLink
from sato.connectivity.obstacles import Obstacles
from sato.connectivity.potential import Potential, Repulsion
from sato.connectivity.power_iteration import PowerIterationGains
from sato.connectivity.stick import Stick
from sato.connectivity.yaw_estimator import YawTracking
from sato.network.graph import label_components

ESTIMATORS = {"exact": EXACT, "flood": FLOOD, "power_pi": POWER}
OMNIDIRECTIONAL = (
    -3.0,
    -2.0,
)  # a_min, a_max of who is blind to the field of view: below any cosine


class AgentLoss(NamedTuple):
    """A robot that is lost."""

    agent: int
    time: float  # [s]


@dataclass(frozen=True, eq=False)
class Connectivity:
    """Robots that follow a leader, and must not lose each other [Bernard2023]."""

    start: Float[Array, "agents 3"]  # [m]
    start_yaw: Float[Array, " agents"]  # [rad]
    start_yaw_estimate: Float[
        Array, "agents agents"
    ]  # relative yaws, as each takes them at first [rad]
    stick: Stick  # of the first robot, the leader
    duration: float = 60.0  # [s]
    step: float = 0.02  # of control [s]
    camera: Camera = field(default_factory=Camera)
    range_only: bool = False  # to the field of view: weights by range alone
    potential: Potential = field(default_factory=Potential)
    repulsion: Repulsion = field(default_factory=Repulsion)
    tracking: YawTracking = field(default_factory=YawTracking)
    limits: CommandLimits = field(default_factory=CommandLimits)
    link: CommunicationLink = field(default_factory=CommunicationLink)
    estimator: Literal["exact", "flood", "power_pi"] = "flood"
    power_iteration: PowerIterationGains = field(default_factory=PowerIterationGains)
    plant: KinematicVehicle | Quadrotor = field(default_factory=KinematicVehicle)
    obstacles: Obstacles = field(default_factory=Obstacles.empty)
    camera_noise: float = 0.0  # standard deviation of each coordinate that a camera measures [m]
    occlusion: bool = False  # robots and obstacles stand in the line of sight
    body_radius: float = 0.3  # radius of a robot that stands there [m]
    losses: tuple[AgentLoss, ...] = ()

    def __post_init__(self) -> None:
        camera, potential, repulsion = self.camera, self.potential, self.repulsion
        for low, high, order in (
            (camera.d_min, camera.d_near, "camera.d_min < camera.d_near"),
            (camera.d_near, camera.d_far, "camera.d_near < camera.d_far"),
            (camera.d_far, camera.d_max, "camera.d_far < camera.d_max"),
            (camera.a_min, camera.a_max, "camera.a_min < camera.a_max"),
            (potential.lambda2_min, potential.lambda2_max, "potential.least < potential.most"),
            (
                repulsion.min_distance,
                repulsion.max_distance,
                "repulsion.nearest < repulsion.farthest",
            ),
            (0.0, self.step, "0 < step"),
        ):
            if not low < high:
                raise ValueError(f"{order} must hold, got {low:g} and {high:g}")
        weight = interaction_graph(self.start, self.start_yaw, self.camera).weights
        found = algebraic_connectivity(weight).lambda2
        if found <= self.potential.lambda2_min:
            raise ValueError(
                f"the swarm does not hang together at the start: λ₂ is {found:.3g}, and must be "
                f"above λ₂^min = {self.potential.lambda2_min:g}"
            )

    @property
    def agents(self) -> int:
        """Number of robots."""
        return len(self.start)

    @property
    def parameters(self) -> SwarmParameters:
        """What the robots work with."""
        sight = self.camera
        if self.range_only:
            sight = sight._replace(a_min=OMNIDIRECTIONAL[0], a_max=OMNIDIRECTIONAL[1])
        tilts = isinstance(self.plant, Quadrotor)
        return SwarmParameters(
            self.camera, sight, self.potential, self.repulsion, self.tracking, self.limits,
            self.link, self.power_iteration,
            self.plant if isinstance(self.plant, KinematicVehicle) else KinematicVehicle(),
            self.plant if isinstance(self.plant, Quadrotor) else Quadrotor(),
            tilts, self.obstacles, ESTIMATORS[self.estimator], self.camera_noise, self.occlusion,
            self.body_radius, self.step,
        )  # fmt: skip


def component_members(weight: Float[Array, "n n"]) -> list[list[int]]:
    """The parts that a graph falls into, each as a list of its robots."""
    label = label_components(weight > 0, np.ones(len(weight), dtype=bool))
    return [np.flatnonzero(label == part).tolist() for part in range(label.max() + 1)]
