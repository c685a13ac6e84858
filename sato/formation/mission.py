"""A formation flight: the frozen scenario of SYSTEM 2."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.distance import pdist

from problems.desired_formation import DesiredFormation
from problems.gain_matrix import GainMatrix
from sato.formation.avoidance import CollisionAvoidance
from sato.formation.control_law import ControlLaw
from sato.formation.kernel import CoordinateFrames, FormationLimits
from sato.network.radio import Radio


class AssignmentSettings(NamedTuple):
    """Who takes which point, and when that is asked again."""

    method: Literal["cbaa", "vsdaa", "hungarian", "none"] = "vsdaa"
    first_delay: float = 1.5  # after a shape is called for [s]
    period: float = 2.0  # between two auctions [s]
    relative_epsilon: float = 0.04  # least raise of a bid of "vsdaa", of the extent of the shape


class SupervisorSettings(NamedTuple):
    """When a shape counts as taken up, and when a swarm as stuck [Lusk2020's trials]."""

    convergence_speed: float = 0.15  # commanded speed below which a vehicle has arrived [m/s]
    averaging_window: float = 1.0  # over which speeds and avoidance are averaged [s]
    convergence_time: float = 1.0  # for which all must have arrived [s]
    gridlock_share: float = 0.95  # share of the window for which a gridlocked vehicle avoids others
    gridlock_timeout: float = 90.0  # in one gridlock [s]
    hover_time: float = 5.0  # before the first shape, and in each [s]
    time_limit: float = 600.0  # of the whole flight [s]
    shape_tolerance: float = 0.1  # error of shape with which it counts as taken up [m]


class OperatorCommand(NamedTuple):
    """What an operator asks of one vehicle for a while."""

    agent: int
    start: float  # after the start of the flight [s]
    end: float  # [s]
    velocity: Float[Array, " 3"]  # in the vehicle's own frame [m/s]


@dataclass(frozen=True, eq=False)
class Formation:
    """Vehicles that take up one shape after another, anywhere and at any heading."""

    start: Float[Array, "agents 3"]  # [m]
    gains: tuple[GainMatrix, ...]  # each with its formation
    coordinate_frames: CoordinateFrames
    control_law: ControlLaw = field(default_factory=ControlLaw)
    avoidance: CollisionAvoidance = field(default_factory=CollisionAvoidance)
    limits: FormationLimits = field(default_factory=FormationLimits)
    assignment: AssignmentSettings = field(default_factory=AssignmentSettings)
    supervision: SupervisorSettings = field(default_factory=SupervisorSettings)
    radio: Radio = field(default_factory=Radio)
    control_step: float = 0.02  # of control [s]
    steps_per_frame: int = (
        1  # control steps from one frame, and look of the supervisor, to the next
    )
    operator_commands: tuple[OperatorCommand, ...] = field(default=())

    def __post_init__(self) -> None:
        for gains in self.gains:
            validate_formation(gains.formation, self.agents, self.avoidance.keep_out)
        validate_assignment(self.assignment, self.radio)
        for push in self.operator_commands:
            validate_operator_command(push, self.agents)

    @property
    def agents(self) -> int:
        """Number of vehicles."""
        return len(self.start)

    @property
    def frame_period(self) -> float:
        """Time from one frame to the next [s]."""
        return self.steps_per_frame * self.control_step


def validate_formation(formation: DesiredFormation, agents: int, collision_radius: float) -> None:
    """A swarm can take up a formation, and keep it.

    Raises:
        ValueError: It has more or fewer points than there are vehicles, or two are too near.
    """
    points = formation.points
    if len(points) != agents:
        raise ValueError(f"{agents} vehicles cannot take up a shape of {len(points)} points")
    closest = pdist(points[:, :2]).min()
    if closest < collision_radius:
        raise ValueError(
            f"two points of the formation are {closest:.3g} m apart in the plane, nearer "
            f"than the keep-out of {collision_radius:g} m: no swarm could hold it"
        )


def validate_assignment(assigning: AssignmentSettings, radio: Radio) -> None:
    """The auction can end with such a radio.

    Raises:
        ValueError: It waits for messages that may be lost.
    """
    if assigning.method == "vsdaa" and radio.loss_probability > 0:
        raise ValueError(
            f'"vsdaa" ends when nothing new is heard, which needs every message, and a share of '
            f'{radio.loss_probability:g} is lost; "cbaa" goes on telling and would do'
        )


def validate_operator_command(push: OperatorCommand, agents: int) -> None:
    """There is somebody to push, and a time for it.

    Raises:
        ValueError: There is not.
    """
    if not 0 <= push.agent < agents:
        raise ValueError(f"there is no vehicle {push.agent}; they are 0 to {agents - 1}")
    if not push.start < push.end:
        raise ValueError(f"a push from {push.start:g} s to {push.end:g} s never begins")


def aligned_frames(agents: int, noise: float = 0.0) -> CoordinateFrames:
    """Frames that agree with each other and do not drift."""
    return CoordinateFrames(
        np.ones(agents, dtype=complex), np.zeros((agents, 3)), np.zeros((agents, 3)), noise
    )


def draw_frames(
    agents: int, origin_range: float, drift: float, noise: float, rng: np.random.Generator
) -> CoordinateFrames:
    """Frames with any yaw and origins anywhere in a box, whose reckoning drifts.

    Args:
        agents: Number of vehicles.
        spread: Half the side of the box of origins [m].
        drift: Error of the reckoning for each metre flown; its direction is drawn.
        noise: Standard deviation of every measured coordinate [m].
        rng: Draws yaws, origins and directions of drift.
    """
    direction = rng.standard_normal((agents, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    yaw = rng.uniform(-np.pi, np.pi, agents)
    offset = rng.uniform(-origin_range, origin_range, (agents, 3))
    return CoordinateFrames(np.exp(1j * yaw), offset, drift * direction, noise)


def legacy_formation(
    start: Float[Array, "agents 3"],
    shapes: tuple[GainMatrix, ...],
    method: Literal["cbaa", "hungarian", "none"],
    *,
    unwrapped_angles: bool = True,
) -> Formation:
    """The flight as [Lusk2020]'s code has it, so that its tables can be reproduced.

    Args:
        start: Where the vehicles are [m].
        shapes: To take up.
        kind: How points are assigned; Hungarian sees everything at once.
        linear: Avoidance compares angles as if they did not wrap around, as that code does.
    """
    return Formation(
        start,
        shapes,
        aligned_frames(len(start), noise=0.01),
        control_law=ControlLaw(upright=False, legacy=True),
        avoidance=CollisionAvoidance(
            avoidance_range=1.5, legacy=True, unwrapped_angles=unwrapped_angles
        ),
        limits=FormationLimits(per_axis=True),
        assignment=AssignmentSettings(method),
        supervision=SupervisorSettings(convergence_speed=1.0),
        control_step=0.01,
        steps_per_frame=2,
    )
