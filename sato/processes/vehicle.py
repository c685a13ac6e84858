"""Process of one vehicle: its state and its memory, and messages to and from others."""

import os
import signal
import time
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from sato.network.flooding import Census
from sato.processes.codec import decode, encode
from sato.processes.messages import Briefing, Call, Fault, Hearing, Reply, Status
from sato.processes.network import WORLD, Connection
from sato.reconfiguration.agent import Agent
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
            _, message = agent.step(call.time, call.state, (), call.seen)
            self._calls, self._solves = _has_called(agent), 0
        else:
            inbox = [decode(packet) for packet in call.inbox]
            _, message = agent.step(call.time, call.state, inbox)
        self._solves = max(self._solves, _count_solves(agent))
        status = self._report() if agent.is_finished else None
        return Reply(call.serial, encode(message), status)

    def _report(self) -> Status:
        flown, i = self.agent.memory, self.number
        decision, plan = flown.last_decision, flown.plans.get(self.number)
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
    decision = agent.memory.last_decision
    assert decision is not None and isinstance(decision.stage, Census)
    (hello,) = decision.stage.message.reports
    return bool(hello.joins)


def _count_solves(agent: Agent) -> int:
    """Count the programs that an agent has solved to plan among others, while it does so."""
    decision = agent.memory.last_decision
    stage = decision and decision.stage
    return stage.planner.solve_count if isinstance(stage, Bending | Meeting | Exchange) else 0
