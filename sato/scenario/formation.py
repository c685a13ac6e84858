"""SYSTEM 2 as a file."""

import warnings
from typing import Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import Field, model_validator

from problems.gains import Gains
from sato.formation import (
    Assigning,
    Avoidance,
    FormationFlight,
    Frames,
    Law,
    Limits,
    Protocol,
    Push,
    misaligned,
)
from sato.formation.mission import check_assigning, check_push
from sato.radio import Radio
from sato.scenario.file import ScenarioFile
from sato.scenario.formation_leg import FormationLeg
from sato.scenario.formation_start import Scattered, hovering
from sato.scenario.formation_tables import (
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
from sato.scenario.refusal import refused_at
from sato.scenario.start import portable

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
            check_assigning(self._assigning, self._radio)
        for number, push in enumerate(self._pushes):
            with refused_at(f"push.{number}"):
                check_push(push, self.swarm.agents)
        return self

    def build(self, rng: np.random.Generator) -> FormationFlight:
        """The mission. First the start is drawn, then each leg's points and graph, then frames."""
        swarm, agents = self.swarm, self.swarm.agents
        with self.building():
            with refused_at("swarm.start"):
                start = hovering(swarm.start, agents, swarm.keep_out_m, rng)
            shapes = tuple(self._shape(number, rng) for number in range(len(self.leg)))
            return FormationFlight(
                start=start,
                shapes=shapes,
                frames=self._frames(rng),
                law=self._law,
                avoidance=self._rules,
                limits=self._limits,
                assigning=self._assigning,
                protocol=self._protocol,
                radio=self._radio,
                step=self.control.step_s,
                every=max(1, round(LOOK / self.control.step_s)),
                pushes=self._pushes,
            )

    def warn(self, mission: FormationFlight) -> None:
        """Warn of an avoidance that does not keep vehicles apart."""
        noise, margin = mission.frames.noise, mission.avoidance.margin
        if mission.avoidance.printed:
            doubtful = (
                "legacy_avoidance does not keep vehicles apart: it is there to reproduce what "
                "was printed, and `sato check` will say how near they came"
            )
        elif margin < 2 * noise:
            doubtful = (
                f"avoidance.margin_m = {margin:g} is less than twice frames.noise_m = {noise:g}, "
                f"so the keep-out may be broken by as much; {2.5 * noise:g} would do"
            )
        elif mission.avoidance.brake > mission.limits.acceleration / 2:
            doubtful = (
                f"avoidance.brake_m_s2 = {mission.avoidance.brake:g} is more than half of "
                f"max_acceleration_m_s2 = {mission.limits.acceleration:g}, which leaves too little "
                "for turning: vehicles may come some centimetres too near"
            )
        elif mission.limits.speed * mission.step > margin:
            doubtful = (
                f"in a control step of {mission.step:g} s a vehicle goes "
                f"{mission.limits.speed * mission.step:g} m, farther than avoidance.margin_m = "
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

    def _shape(self, number: int, rng: np.random.Generator) -> Gains:
        leg, swarm = self.leg[number], self.swarm
        with refused_at(f"leg.{number}"):
            return leg.gains.of(leg.drawn(swarm.agents, swarm.keep_out_m, rng))

    def _frames(self, rng: np.random.Generator) -> Frames:
        asked, agents = self.frames, self.swarm.agents
        drawn = misaligned(agents, asked.offset_m, asked.drift, asked.noise_m, rng)
        if asked.yaw == "random":
            return drawn
        return drawn._replace(heading=np.ones(agents, dtype=complex))

    @property
    def _law(self) -> Law:
        law = PRINTED.law if self.avoidance.legacy_avoidance else Law()
        asked = self.control
        return law._replace(gain=asked.gain, size=asked.size, upright=asked.upright)

    @property
    def _rules(self) -> Avoidance:
        rules = PRINTED.avoidance if self.avoidance.legacy_avoidance else Avoidance()
        asked = self.avoidance
        return rules._replace(
            keep_out=self.swarm.keep_out_m,
            notice=asked.notice_m,
            margin=asked.margin_m,
            brake=asked.brake_m_s2,
            aside=asked.aside_rad,
        )

    @property
    def _limits(self) -> Limits:
        asked = self.swarm
        return Limits(
            speed=asked.max_speed_m_s,
            climb=asked.max_climb_m_s,
            acceleration=asked.max_acceleration_m_s2,
            climb_acceleration=asked.max_climb_acceleration_m_s2,
            each_axis=self.avoidance.legacy_avoidance,
        )

    @property
    def _assigning(self) -> Assigning:
        asked = self.assignment
        return Assigning(asked.kind, asked.first_s, asked.period_s, asked.fineness)

    @property
    def _protocol(self) -> Protocol:
        asked = self.protocol
        return Protocol(
            settled=asked.settled_m_s,
            hover=asked.hover_s,
            patience=asked.patience_s,
            limit=asked.limit_s,
            shape=asked.shape_m,
        )

    @property
    def _radio(self) -> Radio:
        asked = self.radio
        bits = max(Radio.number, (self.swarm.agents - 1).bit_length())  # to tell them apart
        return Radio(asked.rate_hz, asked.loss, asked.delay_s, bits)

    @property
    def _pushes(self) -> tuple[Push, ...]:
        return tuple(
            Push(p.vehicle, p.start_s, p.end_s, np.array(p.velocity_m_s)) for p in self.push
        )
