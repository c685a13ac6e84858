"""Vehicle of a process: an agent, and what of its memory goes into the record."""

from typing import Any

import numpy as np

from sato.network.flooding import Census
from sato.processes.codec import decode
from sato.processes.messages import Briefing, Measured, Status
from sato.reconfiguration.agent import Agent
from sato.reconfiguration.agent_network import NetworkDecision
from sato.reconfiguration.agent_stages import Exchange
from sato.reconfiguration.first_commitment import find_first_commitments
from sato.reconfiguration.halfway_stages import Bending, Meeting
from sato.reconfiguration.leg import longest_leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.stopping import Commitment
from sato.scenario.file import parse_embedded


class Vehicle:
    """One vehicle: its agent, its mission, and the leg that it flies."""

    def __init__(self, number: int, briefing: Briefing) -> None:
        """Begin, with a mission as text."""
        mission: Any = parse_embedded(briefing.scenario)
        mission = mission.draw(np.random.default_rng(briefing.seed))
        self.mission: Reconfiguration = mission
        self.number, self.leg = number, briefing.leg
        if briefing.leg_start is None:
            own = find_first_commitments(mission).get(number)
            self.agent = Agent(mission, number, commitment=own)
        else:
            own_leg = {"leg_start": briefing.leg_start, "leg": mission.legs[briefing.leg]}
            self.agent = Agent(mission, number, **own_leg)
        self._is_leg_over, self._calls, self._solves = False, False, 0
        self._ended: NetworkDecision | None = None  # at the last instant

    def begin_leg(self, number: int) -> None:
        """Take up the targets of the legs up to one."""
        while self.leg < number:
            self.leg += 1
            leg = self.mission.legs[self.leg]
            self.agent.set_targets(leg.shape, leg.steps, recount=leg.recount, choose=leg.choose)

    def begin(self, measured: Measured, inbox: list[Any]) -> Any:
        """Begin a control instant; return the packet to others."""
        under_way = self.agent.memory.under_way
        if self._gives_up(measured.instant):
            self.begin_leg(min(self.leg + 1, len(self.mission.legs) - 1))
        self._ended, self._calls, self._solves = None, False, 0
        time = measured.instant * self.mission.step
        _, packet = self.agent.step(time, measured.state, inbox, measured.seen)
        if under_way is not None and begun_at(self.agent) != under_way.agent.instant:
            self._ended = under_way
        if not self.mission.lag_steps:
            self._calls = _has_called(self.agent)
        return packet

    def _gives_up(self, instant: int) -> bool:
        """Tell whether its leg has taken too long; it tells nobody, as all know when it began."""
        lag, began = self.mission.lag_steps, self.agent.memory.leg_start
        longest = longest_leg(self.mission.legs[self.leg].steps, lag)
        return bool(lag) and began is not None and instant == began + longest

    def act(self, measured: Measured, inbox: list[Any]) -> Any:
        """Act in a round after the first of an instant; return the packet to others."""
        time = measured.instant * self.mission.step
        _, packet = self.agent.step(time, measured.state, inbox)
        self._solves = max(self._solves, _count_solves(self.agent))
        if self.mission.lag_steps and self.agent.is_leg_over:
            self._is_leg_over = self.leg == len(self.mission.legs) - 1
            self.begin_leg(min(self.leg + 1, len(self.mission.legs) - 1))
        return packet

    @property
    def intended(self) -> Commitment | None:
        """Trajectory that is flown from the next decision on, once the vehicle commits to it."""
        under_way = self.agent.memory.under_way
        if under_way is None or not under_way.commits:
            return None
        return under_way.decision.committed.get(self.number)

    def report(self) -> Status:
        """Report for the record."""
        flown, i = self.agent.memory, self.number
        decision, plan = flown.last_decision, flown.plans.get(i)
        assert flown.control is not None
        has_ended, decides = True, decision is not None and decision.stage_index > 0
        if self.mission.lag_steps:
            has_ended = self._ended is not None
            decides = self._ended is not None and self._ended.commits
        return Status(
            leg=self.leg,
            is_leg_over=self._is_leg_over,
            control=flown.control,
            commitment=flown.committed.get(i),
            intended=self.intended,
            target_index=int(flown.memory.target_index[i]),
            target_count=int(flown.memory.target_count[i]),
            clock=int(flown.memory.clock[i]),
            has_plan=plan is not None and plan.target_index is not None,
            decides=decides,
            calls=self._calls,
            solves=self._solves,
            blocked=() if decision is None else decision.blocked,
            events=flown.events if has_ended else (),
        )


def open_packet(sender: int, data: bytes) -> Any:
    """Decode the packet of a vehicle; a `ValueError` refuses one in the name of another."""
    packet = decode(data)
    if getattr(packet, "sender", None) != sender:
        name = getattr(packet, "sender", type(packet).__name__)
        raise ValueError(f"vehicle {sender} sends a packet in the name of {name}")
    return packet


def begun_at(agent: Agent) -> int | None:
    """Return the instant at which the decision began that is under way over a network."""
    under_way = agent.memory.under_way
    return None if under_way is None else under_way.agent.instant


def _has_called(agent: Agent) -> bool:
    """Tell whether an agent calls for an auction, as its first message says."""
    decision = agent.memory.last_decision
    assert decision is not None and isinstance(decision.stage, Census)
    (hello,) = decision.stage.message.reports
    return bool(hello.joins)


def _count_solves(agent: Agent) -> int:
    """Count the programs that an agent has solved to plan among others, while it does so."""
    stage = agent.memory.last_decision and agent.memory.last_decision.stage
    return stage.planner.solve_count if isinstance(stage, Bending | Meeting | Exchange) else 0
