"""A formation flight: the frozen scenario of SYSTEM 2."""

from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.distance import pdist

from problems.formation import Formation
from problems.gains import Gains
from sato.formation.avoidance import Avoidance
from sato.formation.law import Law
from sato.formation.swarm import Frames, Limits
from sato.radio import Radio


class Assigning(NamedTuple):
    """Who takes which point, and when that is asked again."""

    kind: Literal["cbaa", "vsdaa", "hungarian", "none"] = "vsdaa"
    first: float = 1.5  # after a shape is called for [s]
    period: float = 2.0  # between two auctions [s]
    fineness: float = 0.04  # least raise of a bid of "vsdaa", of the extent of the shape


class Protocol(NamedTuple):
    """When a shape counts as taken up, and when a swarm as stuck [Lusk2020's trials]."""

    settled: float = 0.15  # commanded speed below which a vehicle has arrived [m/s]
    window: float = 1.0  # over which speeds and avoidance are averaged [s]
    hold: float = 1.0  # for which all must have arrived [s]
    stuck: float = 0.95  # share of the window for which a gridlocked vehicle avoids others
    patience: float = 90.0  # in one gridlock [s]
    hover: float = 5.0  # before the first shape, and in each [s]
    limit: float = 600.0  # of the whole flight [s]
    shape: float = 0.1  # error of shape with which it counts as taken up [m]


class Push(NamedTuple):
    """What an operator asks of one vehicle for a while."""

    vehicle: int
    start: float  # after the start of the flight [s]
    end: float  # [s]
    velocity: Float[Array, " 3"]  # in the vehicle's own frame [m/s]


@dataclass(frozen=True, eq=False)
class FormationFlight:
    """Vehicles that take up one shape after another, anywhere and at any heading."""

    start: Float[Array, "agents 3"]  # [m]
    shapes: tuple[Gains, ...]  # each with its formation
    frames: Frames
    law: Law = field(default_factory=Law)
    avoidance: Avoidance = field(default_factory=Avoidance)
    limits: Limits = field(default_factory=Limits)
    assigning: Assigning = field(default_factory=Assigning)
    protocol: Protocol = field(default_factory=Protocol)
    radio: Radio = field(default_factory=Radio)
    step: float = 0.02  # of control [s]
    every: int = 1  # control steps from one frame, and look of the supervisor, to the next
    pushes: tuple[Push, ...] = field(default=())

    def __post_init__(self) -> None:
        for gains in self.shapes:
            check_formation(gains.formation, self.agents, self.avoidance.keep_out)
        check_assigning(self.assigning, self.radio)
        for push in self.pushes:
            check_push(push, self.agents)

    @property
    def agents(self) -> int:
        """Number of vehicles."""
        return len(self.start)

    @property
    def sample(self) -> float:
        """Time from one frame to the next [s]."""
        return self.every * self.step


def check_formation(formation: Formation, agents: int, keep_out: float) -> None:
    """A swarm can take up a formation, and keep it.

    Raises:
        ValueError: It has more or fewer points than there are vehicles, or two are too near.
    """
    points = formation.points
    if len(points) != agents:
        raise ValueError(f"{agents} vehicles cannot take up a shape of {len(points)} points")
    closest = pdist(points[:, :2]).min()
    if closest < keep_out:
        raise ValueError(
            f"two points of the formation are {closest:.3g} m apart in the plane, nearer "
            f"than the keep-out of {keep_out:g} m: no swarm could hold it"
        )


def check_assigning(assigning: Assigning, radio: Radio) -> None:
    """The auction can end with such a radio.

    Raises:
        ValueError: It waits for messages that may be lost.
    """
    if assigning.kind == "vsdaa" and radio.loss > 0:
        raise ValueError(
            f'"vsdaa" ends when nothing new is heard, which needs every message, and a share of '
            f'{radio.loss:g} is lost; "cbaa" goes on telling and would do'
        )


def check_push(push: Push, agents: int) -> None:
    """There is somebody to push, and a time for it.

    Raises:
        ValueError: There is not.
    """
    if not 0 <= push.vehicle < agents:
        raise ValueError(f"there is no vehicle {push.vehicle}; they are 0 to {agents - 1}")
    if not push.start < push.end:
        raise ValueError(f"a push from {push.start:g} s to {push.end:g} s never begins")


def aligned(agents: int, noise: float = 0.0) -> Frames:
    """Frames that agree with each other and do not drift."""
    return Frames(
        np.ones(agents, dtype=complex), np.zeros((agents, 3)), np.zeros((agents, 3)), noise
    )


def misaligned(
    agents: int, spread: float, drift: float, noise: float, rng: np.random.Generator
) -> Frames:
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
    offset = rng.uniform(-spread, spread, (agents, 3))
    return Frames(np.exp(1j * yaw), offset, drift * direction, noise)


def as_printed(
    start: Float[Array, "agents 3"],
    shapes: tuple[Gains, ...],
    kind: Literal["cbaa", "hungarian", "none"],
    *,
    linear: bool = True,
) -> FormationFlight:
    """The flight as [Lusk2020]'s code has it, so that its tables can be reproduced.

    Args:
        start: Where the vehicles are [m].
        shapes: To take up.
        kind: How points are assigned; Hungarian sees everything at once.
        linear: Avoidance compares angles as if they did not wrap around, as that code does.
    """
    return FormationFlight(
        start,
        shapes,
        aligned(len(start), noise=0.01),
        law=Law(upright=False, printed=True),
        avoidance=Avoidance(notice=1.5, printed=True, linear=linear),
        limits=Limits(each_axis=True),
        assigning=Assigning(kind),
        protocol=Protocol(settled=1.0),
        step=0.01,
        every=2,
    )
