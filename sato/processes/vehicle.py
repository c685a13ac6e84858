"""Process of one vehicle: its state and its memory, and messages to and from others."""

import os
import signal
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from sato.network.channel import NEVER
from sato.network.flooding import Census
from sato.network.synchronous_agent import SynchronousAgent
from sato.processes.codec import decode, encode
from sato.processes.messages import Briefing, Call, Fault, Hearing, Reply, Status
from sato.processes.network import WORLD, Connection
from sato.reconfiguration.agent import Agent
from sato.reconfiguration.agent_inputs import AgentMessage
from sato.reconfiguration.agent_stages import Exchange
from sato.reconfiguration.first_commitment import find_first_commitments
from sato.reconfiguration.halfway_stages import Bending, Meeting
from sato.reconfiguration.mission import Reconfiguration
from sato.scenario.errors import InputError
from sato.scenario.file import parse

PATIENCE = 0.2  # time after which a vehicle says again that it is there [s]


def run_vehicle(port: int, number: int) -> None:
    """Run the process of one vehicle, until the world is gone.

    Args:
        port: Port at which the world listens.
        number: Number of the vehicle.

    Raises:
        InputError: There is no world, or the vehicle is there already.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the world, which ends all others
    connection = Connection(port, number)
    if connection.is_taken:
        raise InputError("", f"the process of vehicle {number} is there already")
    connection.watch(WORLD, lambda _: os._exit(0))
    with threadpool_limits(1, user_api="blas"):
        vehicle = Vehicle(number, _hear_mission(connection, number))
        while True:
            received = connection.receive(timeout=None)
            if received is None:
                continue
            try:
                connection.send(WORLD, vehicle.act(received[1]))
            except Exception as error:  # the world ends the flight, and tells the reason
                connection.send(WORLD, Fault(type(error).__name__, str(error)))


def _hear_mission(connection: Connection, number: int) -> Briefing:
    """Say that the vehicle is there, until the world answers."""
    while True:
        connection.send(WORLD, Hearing(number, os.getpid()))
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            received = connection.receive(timeout=PATIENCE)
            if received is not None and isinstance(received[1], Briefing):
                return received[1]


class Acting(NamedTuple):
    """An agent that decides, as a stage of synchronous rounds."""

    agent: Agent
    call: Call  # with which the decision began
    message: AgentMessage
    is_finished: bool

    @classmethod
    def begin(cls, agent: Agent, call: Call) -> "Acting":
        """Begin a decision."""
        _, message = agent.step(call.time, call.state, (), call.seen)
        return cls(agent, call, message, agent.is_finished)

    def update(self, inbox: Sequence[AgentMessage]) -> "Acting":
        """Act once, on the messages of all neighbors."""
        _, message = self.agent.step(self.call.time, self.call.state, inbox)
        return self._replace(message=message, is_finished=self.agent.is_finished)


class Vehicle:
    """One vehicle: an agent, and what of its memory goes into the record."""

    def __init__(self, number: int, briefing: Briefing) -> None:
        mission: Any = parse(briefing.scenario)
        mission = mission.draw(np.random.default_rng(briefing.seed))
        self.mission: Reconfiguration = mission
        self.number, self.leg = number, briefing.leg
        if briefing.leg_start is None:
            own = find_first_commitments(mission).get(number)
            self.agent = Agent(mission, number, commitment=own)
        else:
            own_leg = {"leg_start": briefing.leg_start, "leg": mission.legs[briefing.leg]}
            self.agent = Agent(mission, number, **own_leg)
        self._before, self._calls, self._solves = self.agent.memory, False, 0
        self._rounds: SynchronousAgent

    def act(self, call: Call) -> Reply:
        """Act in one round of messages."""
        agent = self.agent
        while self.leg < call.leg:
            self.leg += 1
            leg = self.mission.legs[self.leg]
            agent.set_targets(leg.shape, leg.steps, recount=leg.recount, choose=leg.choose)
            self._before = agent.memory
        if call.begins:
            repeats = agent.memory.instant == round(call.time / self.mission.step)
            agent.memory = self._before = self._before if repeats else agent.memory
            stage = Acting.begin(agent, call)
            own = self.number, stage.message.instant, stage
            self._rounds = SynchronousAgent(*own, self.mission.link.silent_rounds, NEVER)
            self._calls, self._solves = _has_called(agent), 0
        else:
            self._rounds = self._rounds.update([decode(packet) for packet in call.inbox])
        self._solves = max(self._solves, _count_solves(agent))
        status = self._report() if agent.is_finished else None
        return Reply(call.serial, encode(self._rounds.packet), status)

    def _report(self) -> Status:
        flown, i = self.agent.memory, self.number
        decision, plan = flown.decision, flown.plans.get(self.number)
        assert decision is not None and flown.control is not None
        return Status(
            control=flown.control,
            commitment=flown.committed.get(i),
            target_index=int(flown.memory.target_index[i]),
            target_count=int(flown.memory.target_count[i]),
            clock=int(flown.memory.clock[i]),
            has_plan=plan is not None and plan.target_index is not None,
            decides=decision.stage_index > 0,
            calls=self._calls,
            solves=self._solves,
            blocked=decision.blocked,
            events=decision.events,
        )


def _has_called(agent: Agent) -> bool:
    """Tell whether an agent calls for an auction, as its first message says."""
    decision = agent.memory.decision
    assert decision is not None and isinstance(decision.stage, Census)
    (hello,) = decision.stage.message.reports
    return bool(hello.joins)


def _count_solves(agent: Agent) -> int:
    """Count the programs that an agent has solved to plan among others, while it does so."""
    stage = agent.memory.decision and agent.memory.decision.stage
    return stage.planner.solve_count if isinstance(stage, Bending | Meeting | Exchange) else 0
