"""Definition of a formation flight: start, formations, control, messages and supervision."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.units import Acceleration, Length, Speed, Time
from sato.formation import feasibility
from sato.formation.leg import FormationLeg
from sato.formation.settings import (
    AssignmentSettings,
    CollisionAvoidance,
    ControlLaw,
    CoordinateFrames,
    FrameSettings,
    OperatorCommand,
    SupervisorSettings,
)
from sato.formation.start import AnyStart, draw_start, place_level
from sato.network.link import Link
from sato.network.radio import Radio
from sato.scenario.definition import LATER, Convert, In, Key, Positive, errors_in, map_numbered
from sato.scenario.file import Mission
from sato.scenario.ranges import check_memory
from sato.scenario.table import find_key, write_table
from sato.shapes import Points, Shape
from sato.shapes.shape import as_points

if TYPE_CHECKING:
    from problems.gain_matrix import GainMatrix

FRAME_PERIOD = 0.02  # between two observations by the supervisor, as in [Lusk2020]'s trials [s]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Formation(Mission):
    """Vehicles that take up one formation after another, anywhere and at any heading.

    Args:
        start: Array of (N, 2) or (N, 3) positions [m], a random start or a shape.
        legs: Formations, one after another.

    All others are explained by `sato keys formation`. Values are in SI units.
    """

    system: ClassVar[str] = "formation"

    agents: Annotated[int, In("swarm"), Ge(3), "number; as the start lists, if absent"] = LATER
    start: Annotated[AnyStart, In("swarm"), Convert(as_points), "initial positions, at rest"]
    keep_out: Annotated[Length, In("swarm"), Positive, "least distance in the plane"] = 1.2
    max_speed: Annotated[Speed, In("swarm"), Positive, "largest speed in the plane"] = 0.5
    max_climb: Annotated[Speed, In("swarm"), Positive, "largest vertical speed"] = 0.3
    max_acceleration: Annotated[Acceleration, In("swarm"), Positive, "largest in the plane"] = 0.5
    max_climb_acceleration: Annotated[
        Acceleration, In("swarm"), Positive, "largest vertical acceleration"
    ] = 0.8

    step: Annotated[Time, In("control"), Positive, "control step"] = 0.02
    control_law: Annotated[ControlLaw, Key("control"), "control law"] = ControlLaw()
    avoidance: Annotated[CollisionAvoidance, "collision avoidance"] = CollisionAvoidance()
    assignment: Annotated[AssignmentSettings, "assignment of points"] = AssignmentSettings()
    frames: Annotated[FrameSettings, "coordinate frames and sensors"] = FrameSettings()
    radio: Annotated[Radio, "messages"] = Radio()
    link: Annotated[Link, "faults of messages, in rounds of the radio"] = Link()
    supervision: Annotated[SupervisorSettings, Key("protocol"), "convergence and gridlock"] = (
        SupervisorSettings()
    )

    operator_commands: Annotated[
        tuple[OperatorCommand, ...], Key("push"), "velocities commanded by an operator"
    ] = ()
    legs: Annotated[tuple[FormationLeg, ...], Key("leg"), "formations in turn"]

    @classmethod
    def with_defaults(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Return the keys of a file; with `legacy_avoidance`, defaults are the paper's."""
        avoidance = data.get("avoidance")
        if not isinstance(avoidance, dict) or avoidance.get("legacy_avoidance") is not True:
            return data
        points = Points(np.eye(3))
        legacy = write_table(legacy_formation(points, [FormationLeg(points)]))
        filled = dict(data)
        for table in ("control", "avoidance", "assignment", "frames", "protocol"):
            given = data.get(table, {})
            if isinstance(given, dict):
                keys = {find_key(key, legacy[table]) for key in given}
                filled[table] = given | {k: v for k, v in legacy[table].items() if k not in keys}
        return filled

    def completed(self) -> dict[str, Any]:
        """Return the number of agents, and identifiers that tell all of them apart."""
        agents, radio = self.agents, self.radio
        for points in (self.start, *(leg.formation for leg in self.legs)):
            if agents is None and isinstance(points, Points):
                agents = len(points.listed)
        bits = max(radio.id_bits, (agents - 1).bit_length() if agents else 0)
        return {"agents": agents, "radio": replace(radio, id_bits=bits)}

    def check(self) -> None:
        """Refuse fields that contradict each other."""
        feasibility.check_swarm(self)
        feasibility.check_clearance(self)
        feasibility.check_messages(self)
        feasibility.check_operator_commands(self)

    def draw(self, rng: np.random.Generator) -> "Formation":
        """Return the mission with its start, formations, gains and coordinate frames drawn."""
        check_memory(self.agents, lambda agents: feasibility.memory_demand(self, agents))
        with errors_in("swarm.start"):
            start = draw_start(self.start, self.agents, self.keep_out, rng)
        with errors_in("leg"):
            legs = map_numbered(lambda leg: leg.draw(self.agents, self.keep_out, rng), self.legs)
        with errors_in("frames"):
            frames = self.frames.draw(self.agents, rng)
        return replace(self, start=Points(start, keep_order=True), legs=legs, frames=frames)

    def warnings(self) -> list[str]:
        """List doubts about a drawn mission, a sentence each."""
        return feasibility.separation_doubts(self) + feasibility.duration_doubts(self)

    def without_files(self) -> "Formation":
        """Return the same mission with the contents of files and fonts."""
        start = self.start
        if isinstance(start, Shape) and start.uses_files:
            shape = replace(start, keep_order=True) if isinstance(start, Points) else start
            start = Points(place_level(shape, self.agents, 0.0), keep_order=True)
        with errors_in("leg"):
            legs = map_numbered(lambda leg: leg.without_files(self.agents), self.legs)
        return replace(self, start=start, legs=legs)

    @cached_property
    def timed_link(self) -> Link:
        """Link with the faults that the radio has, and the time that a round of it takes."""
        radio, link = self.radio, self.link
        loss = link.loss_probability or radio.loss_probability
        both = replace(link, loss_probability=loss, late=link.late or radio.delay_rounds)
        return both.over(1 / radio.message_rate)

    @cached_property
    def initial_positions(self) -> Float[Array, "agents 3"]:
        """Initial position of every agent [m], once drawn."""
        if not isinstance(self.start, Points):
            raise ValueError("the start is known once the mission is drawn: mission.draw(rng)")
        return place_level(replace(self.start, keep_order=True), self.agents, 0.0)

    @cached_property
    def gains(self) -> "tuple[GainMatrix, ...]":
        """Gains of each leg, once drawn, each with its formation."""
        return tuple(leg.gain_matrix for leg in self.legs)

    @cached_property
    def coordinate_frames(self) -> CoordinateFrames:
        """Coordinate frame of each agent, once drawn."""
        frames = self.frames
        if isinstance(frames.yaw, str):
            raise ValueError("the frames are known once the mission is drawn: mission.draw(rng)")
        rotation = np.exp(1j * frames.yaw)
        return CoordinateFrames(rotation, np.array(frames.offset), np.array(frames.drift))

    @property
    def steps_per_frame(self) -> int:
        """Control steps from one recorded frame, and observation, to the next."""
        return max(1, round(FRAME_PERIOD / self.step))

    @property
    def frame_period(self) -> float:
        """Time from one recorded frame to the next [s]."""
        return self.steps_per_frame * self.step


@checked
def legacy_formation(start: Any, legs: Sequence[FormationLeg], **changed: Any) -> Formation:
    """Return the flight as [Lusk2020]'s code has it, so that its tables can be reproduced.

    Start and legs are as of a `Formation`; fields that are changed differ from those of the paper.
    """
    paper: dict[str, Any] = {
        "step": 0.01,
        "control_law": ControlLaw(upright=False),
        "avoidance": CollisionAvoidance(avoidance_range=1.5, legacy=True, unwrapped_angles=True),
        "assignment": AssignmentSettings("cbaa"),
        "frames": FrameSettings("aligned", 0.0, 0.0, 0.01),
        "supervision": SupervisorSettings(convergence_speed=1.0),
    }
    return Formation(start=start, legs=tuple(legs), **(paper | changed))
