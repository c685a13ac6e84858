"""Keeping together: the frozen scenario of SYSTEM 3."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.kinematic import Kinematic
from dynamics.quadrotor import Quadrotor
from problems.graph import Sight, connectivity, graph
from sato.connectivity.mail import Link
from sato.connectivity.obstacles import Obstacles
from sato.connectivity.potential import Potential, Repulsion
from sato.connectivity.power import Power
from sato.connectivity.stick import Stick
from sato.connectivity.swarm import EXACT, FLOOD, POWER, Limits, Team
from sato.connectivity.yaw import Tracking
from sato.network import parts

ESTIMATORS = {"exact": EXACT, "flood": FLOOD, "power_pi": POWER}
ANYWHERE = (-3.0, -2.0)  # a_min, a_max of who is blind to the field of view: below any cosine


class Death(NamedTuple):
    """A robot that is lost."""

    robot: int
    time: float  # [s]


@dataclass(frozen=True, eq=False)
class ConnectivityFlight:
    """Robots that follow a leader, and must not lose each other [Bernard2023]."""

    start: Float[Array, "agents 3"]  # [m]
    yaw: Float[Array, " agents"]  # [rad]
    believed: Float[Array, "agents agents"]  # relative yaws, as each takes them at first [rad]
    stick: Stick  # of the first robot, the leader
    duration: float = 60.0  # [s]
    step: float = 0.02  # of control [s]
    camera: Sight = field(default_factory=Sight)
    blind: bool = False  # to the field of view: weights by range alone
    potential: Potential = field(default_factory=Potential)
    repulsion: Repulsion = field(default_factory=Repulsion)
    tracking: Tracking = field(default_factory=Tracking)
    limits: Limits = field(default_factory=Limits)
    link: Link = field(default_factory=Link)
    estimator: Literal["exact", "flood", "power_pi"] = "flood"
    power: Power = field(default_factory=Power)
    plant: Kinematic | Quadrotor = field(default_factory=Kinematic)
    obstacles: Obstacles = field(default_factory=Obstacles.none)
    noise: float = 0.0  # standard deviation of each coordinate that a camera measures [m]
    occlusion: bool = False  # robots and obstacles stand in the line of sight
    body: float = 0.3  # radius of a robot that stands there [m]
    deaths: tuple[Death, ...] = ()

    def __post_init__(self) -> None:
        camera, potential, repulsion = self.camera, self.potential, self.repulsion
        for low, high, order in (
            (camera.d_min, camera.d_near, "camera.d_min < camera.d_near"),
            (camera.d_near, camera.d_far, "camera.d_near < camera.d_far"),
            (camera.d_far, camera.d_max, "camera.d_far < camera.d_max"),
            (camera.a_min, camera.a_max, "camera.a_min < camera.a_max"),
            (potential.least, potential.most, "potential.least < potential.most"),
            (repulsion.nearest, repulsion.farthest, "repulsion.nearest < repulsion.farthest"),
            (0.0, self.step, "0 < step"),
        ):
            if not low < high:
                raise ValueError(f"{order} must hold, got {low:g} and {high:g}")
        weight = graph(self.start, self.yaw, self.camera).weight
        found = connectivity(weight).lambda2
        if found <= self.potential.least:
            raise ValueError(
                f"the swarm does not hang together at the start: λ₂ is {found:.3g}, and must be "
                f"above λ₂^min = {self.potential.least:g}"
            )

    @property
    def agents(self) -> int:
        """Number of robots."""
        return len(self.start)

    @property
    def team(self) -> Team:
        """What the robots work with."""
        sight = self.camera
        if self.blind:
            sight = sight._replace(a_min=ANYWHERE[0], a_max=ANYWHERE[1])
        tilts = isinstance(self.plant, Quadrotor)
        return Team(
            self.camera, sight, self.potential, self.repulsion, self.tracking, self.limits,
            self.link, self.power,
            self.plant if isinstance(self.plant, Kinematic) else Kinematic(),
            self.plant if isinstance(self.plant, Quadrotor) else Quadrotor(),
            tilts, self.obstacles, ESTIMATORS[self.estimator], self.noise, self.occlusion,
            self.body, self.step,
        )  # fmt: skip


def components(weight: Float[Array, "n n"]) -> list[list[int]]:
    """The parts that a graph falls into, each as a list of its robots."""
    label = parts(weight > 0, np.ones(len(weight), dtype=bool))
    return [np.flatnonzero(label == part).tolist() for part in range(label.max() + 1)]
