"""SYSTEM 2 as a file."""

import warnings
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import Field, model_validator

from problems.gain_matrix import GainMatrix
from sato.formation import (
    AssignmentSettings,
    CollisionAvoidance,
    ControlLaw,
    CoordinateFrames,
    Formation,
    FormationLimits,
    OperatorCommand,
    SupervisorSettings,
    draw_frames,
)
from sato.formation.mission import validate_assignment, validate_operator_command
from sato.former.file import ScenarioFile
from sato.former.formation_leg import FormationLeg
from sato.former.formation_start import Scattered, hovering
from sato.former.formation_tables import (
    PRINTED,
    Assignment,
    Clearance,
    Control,
    Judging,
    Messages,
    Reckoning,
    Stick,
    Vehicles,
    as_in_the_printed_code,
    check_clearance,
    check_rate,
    check_sticks,
)
from sato.former.refusal import refused_at
from sato.former.start import portable
from sato.network.radio import Radio

LOOK = 0.02  # between two looks of who judges the flight, as in [Lusk2020]'s trials [s]


class FormationFile(ScenarioFile):
    """Vehicles that take up one formation after another, as it stands in a file."""

    system: Literal["formation"]
    swarm: Vehicles
    control: Control = Control()
    avoidance: Clearance = Clearance()
    assignment: Assignment = Assignment()
    frames: Reckoning = Reckoning()
    radio: Messages = Messages()
    protocol: Judging = Judging()
    push: list[Stick] = Field(default=[])
    leg: Annotated[list[FormationLeg], Field(min_length=1)]

    @model_validator(mode="before")
    @classmethod
    def _as_printed(cls, data: Any) -> Any:
        avoidance = data.get("avoidance") if isinstance(data, dict) else None
        legacy = isinstance(avoidance, dict) and avoidance.get("legacy_avoidance") is True
        return as_in_the_printed_code(data) if legacy else data

    @model_validator(mode="after")
    def _hangs_together(self) -> "FormationFile":
        check_clearance(self.swarm, self.control, self.avoidance)
        check_rate(self.control, self.radio)
        check_sticks(self.push)
        with refused_at("assignment.kind"):
            validate_assignment(self._assigning, self._radio)
        for number, push in enumerate(self._pushes):
            with refused_at(f"push.{number}"):
                validate_operator_command(push, self.swarm.agents)
        return self

    def build(self, rng: np.random.Generator) -> Formation:
        """The mission. First the start is drawn, then each leg's points and graph, then frames."""
        swarm, agents = self.swarm, self.swarm.agents
        with self.building():
            with refused_at("swarm.start"):
                start = hovering(swarm.start, agents, swarm.keep_out_m, rng)
            shapes = tuple(self._shape(number, rng) for number in range(len(self.leg)))
            return Formation(
                start=start,
                gains=shapes,
                coordinate_frames=self._frames(rng),
                control_law=self._law,
                avoidance=self._rules,
                limits=self._limits,
                assignment=self._assigning,
                supervision=self._protocol,
                radio=self._radio,
                control_step=self.control.step_s,
                steps_per_frame=max(1, round(LOOK / self.control.step_s)),
                operator_commands=self._pushes,
            )

    def warn(self, mission: Formation) -> None:
        """Warn of an avoidance that does not keep vehicles apart."""
        noise, margin = mission.coordinate_frames.noise, mission.avoidance.margin
        if mission.avoidance.legacy:
            doubtful = (
                "legacy_avoidance does not keep vehicles apart: it is there to reproduce what "
                "was printed, and `sato check` will say how near they came"
            )
        elif margin < 2 * noise:
            doubtful = (
                f"avoidance.margin_m = {margin:g} is less than twice frames.noise_m = {noise:g}, "
                f"so the keep-out may be broken by as much; {2.5 * noise:g} would do"
            )
        elif mission.avoidance.braking > mission.limits.acceleration / 2:
            doubtful = (
                f"avoidance.brake_m_s2 = {mission.avoidance.braking:g} is more than half of "
                f"max_acceleration_m_s2 = {mission.limits.acceleration:g}, which leaves too little "
                "for turning: vehicles may come some centimetres too near"
            )
        elif mission.limits.speed * mission.control_step > margin:
            doubtful = (
                f"in a control step of {mission.control_step:g} s a vehicle goes "
                f"{mission.limits.speed * mission.control_step:g} m, farther than avoidance.margin_m = "
                f"{margin:g}: the keep-out may be broken by as much"
            )
        else:
            return
        warnings.warn(doubtful, stacklevel=2)

    def to_toml(self) -> str:
        """The whole scenario; of files and fonts outside of it there is what they said."""
        asked, agents = self.swarm.start, self.swarm.agents
        start = asked if isinstance(asked, Scattered) else portable(asked, agents, 3)
        swarm = self.swarm.model_copy(update={"start": start})
        with self.building():
            legs = [leg.portable(agents) for leg in self.leg]
        alone = self.model_copy(update={"leg": legs, "swarm": swarm})
        return tomli_w.dumps(alone.model_dump(exclude_none=True))

    def _shape(self, number: int, rng: np.random.Generator) -> GainMatrix:
        leg, swarm = self.leg[number], self.swarm
        with refused_at(f"leg.{number}"):
            return leg.gains.of(leg.drawn(swarm.agents, swarm.keep_out_m, rng))

    def _frames(self, rng: np.random.Generator) -> CoordinateFrames:
        asked, agents = self.frames, self.swarm.agents
        drawn = draw_frames(agents, asked.offset_m, asked.drift, asked.noise_m, rng)
        if asked.yaw == "random":
            return drawn
        return drawn._replace(rotation=np.ones(agents, dtype=complex))

    @property
    def _law(self) -> ControlLaw:
        law = PRINTED.control_law if self.avoidance.legacy_avoidance else ControlLaw()
        asked = self.control
        return law._replace(gain=asked.gain, size_rate=asked.size, upright=asked.upright)

    @property
    def _rules(self) -> CollisionAvoidance:
        rules = PRINTED.avoidance if self.avoidance.legacy_avoidance else CollisionAvoidance()
        asked = self.avoidance
        return rules._replace(
            keep_out=self.swarm.keep_out_m,
            avoidance_range=asked.notice_m,
            margin=asked.margin_m,
            braking=asked.brake_m_s2,
            right_turn_bias=asked.aside_rad,
        )

    @property
    def _limits(self) -> FormationLimits:
        asked = self.swarm
        return FormationLimits(
            speed=asked.max_speed_m_s,
            climb=asked.max_climb_m_s,
            acceleration=asked.max_acceleration_m_s2,
            climb_acceleration=asked.max_climb_acceleration_m_s2,
            per_axis=self.avoidance.legacy_avoidance,
        )

    @property
    def _assigning(self) -> AssignmentSettings:
        asked = self.assignment
        return AssignmentSettings(asked.kind, asked.first_s, asked.period_s, asked.fineness)

    @property
    def _protocol(self) -> SupervisorSettings:
        asked = self.protocol
        return SupervisorSettings(
            convergence_speed=asked.settled_m_s,
            hover_time=asked.hover_s,
            gridlock_timeout=asked.patience_s,
            time_limit=asked.limit_s,
            shape_tolerance=asked.shape_m,
        )

    @property
    def _radio(self) -> Radio:
        asked = self.radio
        bits = max(Radio.id_bits, (self.swarm.agents - 1).bit_length())  # to tell them apart
        return Radio(asked.rate_hz, asked.loss, asked.delay_s, bits)

    @property
    def _pushes(self) -> tuple[OperatorCommand, ...]:
        return tuple(
            OperatorCommand(p.vehicle, p.start_s, p.end_s, np.array(p.velocity_m_s))
            for p in self.push
        )
