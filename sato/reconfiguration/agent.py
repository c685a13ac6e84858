"""One vehicle of a reconfiguration, for a simulator or an onboard computer of the user's own."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.callbacks import freeze
from dynamics.doors import checked
from dynamics.units import Time
from problems.conic import TOLERANCE
from problems.solvers.verified import VerifiedSolver
from sato.network.graph import CommunicationGraph
from sato.reconfiguration import estimator
from sato.reconfiguration.agent_decision import Decision
from sato.reconfiguration.agent_inputs import (
    AgentMessage,
    AgentPacket,
    as_instant,
    as_state,
    check_agent,
    check_inbox,
    check_seen,
    checksum,
    list_doubts,
    select_messages,
)
from sato.reconfiguration.agent_memory import FlightMemory
from sato.reconfiguration.agent_network import NetworkDecision
from sato.reconfiguration.allowed_places import check_starts
from sato.reconfiguration.draw import draw_leg, is_drawn, with_targets
from sato.reconfiguration.first_commitment import check_stops
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.network_decision import foresee, stop_at_once
from sato.reconfiguration.plan import compute_spent, give_up_missed
from sato.reconfiguration.planning import give_up_closed
from sato.reconfiguration.state import DecisionContext, Event, begin_memory, update_believed
from sato.reconfiguration.stopping import Commitment, controls_at
from sato.reconfiguration.surroundings import Sensed, sense_surroundings
from sato.reconfiguration.tracking import add_feedback
from sato.scenario.definition import Amount, errors_in
from sato.scenario.errors import InputError, format_value


@checked
class Agent:
    """One vehicle of a reconfiguration: it reads its own memory and its inbox alone.

    At each control instant, at multiples of the mission's `step`, agents decide in rounds of
    messages. In a round each is called once, with the messages that its neighbors returned in the
    round before. The control is held until the next instant:

        while not all(agent.is_finished …):
            for each agent: control, message = agent.step(time, state, inbox)

    Rounds are in lock step and no message is lost; all neighbors within hearing hear each message,
    and hear each other. The number of rounds follows from the messages: agents measure the
    diameter of their network first. An agent that is lost is called no more. One that joins calls
    for an auction by itself.

    Where the mission's `link` loses or delays messages, an agent is called once in each round of
    the network, with all packets that have arrived since. Where rounds take time, that is at each
    multiple of `link.round`, from each instant on; agents fly on meanwhile, and `is_leg_over` tells
    when all know that all have arrived.

    Agents fly the same missions as `sato.run`, control for control, with `plan.orders = 1`.

    Args:
        mission: Mission, the same for all agents. Of `start`, an agent uses only what the margin
            follows from; its first leg is flown, without losses and joins. With
            `plan.assignment = "given"`, the only target of the leg is the agent's own; of several,
            that of its number.
        number: Number of the agent, of its own, from 0: its index in lists for each vehicle.
        target_count: Targets m that it bids on at first; that of the mission by default, 1 for an
            agent that joins.
        leg_start: Time at which the leg began, for an agent that joins [s].
        leg: The leg that it joins, if it is not the first of the mission.
        commitment: How it stops from a start in motion, clear of all others, as
            `sato.find_first_commitments` has it for each; at once by default.

    Raises:
        ValueError: The mission has no auction, tries several orders of priority, negotiates, or
            is to be passively safe; the number has no entry in its lists; or the commitment is
            none.
    """

    def __init__(
        self,
        mission: Reconfiguration,
        number: int,
        target_count: Amount | None = None,
        leg_start: Time | None = None,
        leg: Leg | None = None,
        commitment: Commitment | None = None,
    ) -> None:
        check_agent(mission, number)
        if not is_drawn(mission):
            mission = mission.draw(np.random.default_rng(0))
        believed, start = target_count or mission.target_count or mission.agent_count, None
        if leg_start is not None:
            believed, start = target_count or 1, as_instant(mission, "leg_start", leg_start)
        for sentence in list_doubts(mission):
            warnings.warn(sentence, stacklevel=3)
        self.mission, self.number = mission, number
        # Of arrays that have a row for each agent, only the row of this one counts.
        alone = np.arange(number + 1) == number
        self._graph = CommunicationGraph(np.zeros((len(alone), len(alone)), dtype=bool), alone)
        m = np.full(len(alone), believed)
        self.solver = VerifiedSolver(mission.solver, mission.tolerance or TOLERANCE)
        leg = draw_leg(mission, leg, believed, start or 0) if leg else mission.legs[0]
        if target_count and target_count > len(leg.targets):
            reason = f"{target_count} is more than the {len(leg.targets)} targets of the leg"
            raise InputError("target_count", f"{reason}; {len(leg.targets)} or less would do")
        leg = self._own_leg(leg)
        known = estimator.Estimate.none(len(alone), mission.axes)
        committed = {number: commitment} if commitment else {}
        memory, self._code = begin_memory(mission, leg, m), checksum(mission, mission.legs[0])
        begun = FlightMemory(leg, m, memory, {}, committed, known, start, mission=self._code)
        self.memory = begun

    def step(
        self,
        time: Time,
        state: Any,
        inbox: Sequence[AgentMessage | AgentPacket],
        seen: Sequence[Sensed] = (),
    ) -> tuple[Float[Array, " d"], AgentMessage | AgentPacket | None]:
        """Act in one round of messages.

        Args:
            time: Time since the start of the mission [s], by the agent's own clock; it counts as
                the nearest instant, and may be early or late by a quarter of a step.
            state: Position [m] and velocity [m/s] that the agent measures, as an array (2 d,);
                those of the first call at a control instant count.
            inbox: Messages that the neighbors returned in the last round; those of earlier
                stages are ignored. Where messages are lost or late, all that have arrived.
            seen: All that the agent has seen so far and its mission does not list as known, as it
                is now: obstacles, and the number and the state of each lost vehicle; those of the
                first call at a control instant count.

        Returns:
            The acceleration to hold until the next instant [m/s²], and a message to all neighbors;
            None from an agent that joins between two decisions.

        Raises:
            ValueError: The time is near no instant; an instant was skipped, or begins before the
                decision of the last one is made; the state is not one, or the first is too fast
                to stop within reach; or neighbors have the same number or another leg.
            OutOfTargets: The network has more agents than there are targets.
        """
        instant = as_instant(self.mission, "time", time)
        received = check_inbox(self.number, inbox, self.mission.link.is_ideal)
        before = self.memory.under_way
        if instant != self.memory.instant:
            things = check_seen(self.mission, self.number, seen)
            self.memory = self._begin_instant(instant, as_state(self.mission, state), things)
        elif self.mission.link.is_ideal:
            self.memory = self._hear(received)
        if before is not None and self.memory.under_way is before:
            self.memory = self._go_on(before, received)
        assert self.memory.control is not None
        return self.memory.control.copy(), freeze(self._message)

    def set_targets(
        self,
        targets: Any,
        steps: Amount,
        *,
        count: int | None = None,
        recount: bool = False,
        choose: Literal["prefix", "nearest"] | None = None,
    ) -> None:
        """Begin another leg at the next control instant.

        All agents that hear each other must be told, between the same two instants. Where messages
        take time, the leg begins with the next decision.

        Args:
            targets: Array of (M, d) positions or (M, 2 d) states, or a shape.
            steps: Control steps until the deadline.
            count: Number of targets of a shape, as of a `sato.Leg`; and so the next two.
            recount: Take the number of agents from the bids of the leg before.
            choose: The first targets, or any of all.

        Raises:
            ValueError: The targets are too few or too close, or a decision is not finished.
        """
        flown, later = self.memory, bool(self.mission.lag_steps)
        if not later:
            self._require_finished()
        try:
            leg = Leg(targets, steps, count=count, recount=recount, choose=choose)
        except InputError as error:
            names = {"shape": "targets", "targets": "count"}
            raise InputError(names.get(error.key, error.key), error.reason) from error
        begun = self._begin_leg(leg, 0 if flown.instant is None else flown.instant + 1)
        is_under_way = later and flown.instant is not None
        self.memory = flown._replace(next_leg=leg) if is_under_way else begun

    def _begin_leg(self, leg: Leg, begins: int) -> FlightMemory:
        flown = self.memory
        ended = flown.believed, flown.memory, flown.leg
        believed = update_believed(self.mission, *ended, leg.recount)
        leg = self._own_leg(draw_leg(self.mission, leg, int(believed[self.number]), begins))
        memory, none = begin_memory(self.mission, leg, believed), None
        begun = flown._replace(leg=leg, believed=believed, memory=memory, plans={}, next_leg=none)
        return begun._replace(leg_start=None)

    def _own_leg(self, leg: Leg) -> Leg:
        """Return a leg in which the target that is given to the agent has its number."""
        given = len(leg.targets)
        if self.mission.assignment != "given" or self.number < given:
            return leg
        if given > 1:
            raise ValueError(
                f"agent {self.number} is given none of {given} targets: its own alone, or a list "
                f"with an entry for each number, {self.number + 1} or more, would do"
            )
        return with_targets(leg, np.tile(leg.targets, (self.number + 1, 1)))

    @property
    def memory(self) -> FlightMemory:
        """Memory between two calls, which may be kept and given back."""
        return self._memory

    @memory.setter
    def memory(self, memory: Any) -> None:
        if not isinstance(memory, FlightMemory):
            raise InputError("memory", f"must be that of an agent, got {format_value(memory)}")
        if (other := len(memory.believed) - 1) != self.number:
            raise InputError("memory", f"is that of agent {other}, and this is agent {self.number}")
        if memory.mission != self._code:
            raise InputError("memory", "is that of an agent of another mission")
        self._memory = memory

    @property
    def is_finished(self) -> bool:
        """True once the decision of the last instant is made, as far as the agent has a part."""
        under_way, decision = self.memory.under_way, self.memory.decision
        if under_way is not None:
            return under_way.is_finished
        return decision is not None and decision.is_finished

    @property
    def is_leg_over(self) -> bool:
        """True once the agent knows that all of its network have arrived, or begin another leg.

        It says so with the last decision of a leg, and no more once it has new targets.
        """
        decision = self.memory.last_decision
        return decision is not None and self.memory.next_leg is None and decision.is_leg_over

    @property
    def target_index(self) -> int:
        """Index of the target that the agent holds; −1 before the first auction."""
        return int(self.memory.memory.target_index[self.number])

    @property
    def has_arrived(self) -> bool:
        """True from the deadline of the agent's plan on, if that leads to its target."""
        return self._has_arrived(self.memory)

    def _has_arrived(self, flown: FlightMemory) -> bool:
        plan, clock = flown.plans.get(self.number), flown.memory.clock[self.number]
        is_planned = plan is not None and plan.target_index is not None
        return bool(clock == flown.leg.steps and is_planned)

    @property
    def events(self) -> tuple[Event, ...]:
        """Constraints relaxed, and clocks reset, in the last decision that it took up."""
        return self.memory.events

    def _begin_instant(self, instant: int, state: Array, seen: Sequence[Sensed]) -> FlightMemory:
        mission, flown = self.mission, self.memory
        is_first, starts = flown.instant is None, (None, instant)
        joins = is_first and flown.leg_start not in starts
        if not is_first:
            self.memory = self._end_step(instant)
            flown = self._end_network_decision(instant) if mission.lag_steps else self.memory
        else:
            alone = np.array([self.number])
            with errors_in("state"):
                place, time = state[None, : mission.axes], instant * mission.step
                check_starts(mission, place, alone.tolist(), mission.margin, time)
            check_stops(mission, alone, state[None], "state", flown.committed, instant)
        measured = np.tile(state, (self.number + 1, 1))
        estimate = estimator.update(mission, flown.estimate, measured)
        begun = instant if flown.leg_start is None else flown.leg_start
        flown = flown._replace(estimate=estimate, leg_start=begun, instant=instant, heard=None)
        if is_first:  # the deadline of the leg is that of all
            clock = np.full_like(flown.memory.clock, min(instant - begun, flown.leg.steps))
            flown = flown._replace(memory=replace(flown.memory, clock=clock))
        when, solvers = (instant - begun, instant * mission.step), [self.solver] * len(measured)
        known = self._graph, estimate.reference, flown.memory
        around = sense_surroundings(mission, when[1], len(measured), seen)
        context = DecisionContext(mission, flown.leg, *known, *when, solvers, around)
        decides = not mission.lag_steps or when[0] % mission.replan_steps == 0
        known_count = flown.decided_count if decides else flown.seen_count
        sees_new = [self.number] if len(seen) > known_count else []
        plans = give_up_missed(context, flown.plans)
        closed = give_up_closed(context, plans, sees_new)
        joins |= flown.is_calling or closed.get(self.number) is not plans.get(self.number)
        flown = flown._replace(plans=closed, seen_count=len(seen), is_calling=joins)
        if decides:
            flown = self._begin_decision(flown._replace(decided_count=len(seen)), context)
        return flown._replace(control=self._control(flown))

    def _begin_decision(self, flown: FlightMemory, context: DecisionContext) -> FlightMemory:
        mission, i, instant = self.mission, self.number, context.instant
        if mission.lag_steps:
            if not flown.committed:
                stop = stop_at_once(mission, i, context.state[i], instant)
                flown = flown._replace(committed={i: stop})
            begun = np.full_like(context.memory.clock, self._has_begun(flown), dtype=bool)
            context = foresee(context, flown.committed, begun)
            flown = flown._replace(plans=give_up_missed(context, flown.plans))
        assert flown.leg_start is not None
        own = flown.plans, flown.committed, flown.spent
        shared = flown.leg_start, checksum(mission, flown.leg)
        calls = flown.is_calling, self._has_arrived(flown)
        decision = Decision.begin(i, context, *own, shared, *calls)
        flown = flown._replace(is_calling=False)
        if mission.link.is_ideal:
            return flown._replace(decision=decision)
        under_way = NetworkDecision.begin(mission, instant, decision)
        return flown._replace(under_way=under_way)

    def _has_begun(self, flown: FlightMemory) -> bool:
        """Tell whether the clock runs: from the first plan of a leg on, if rounds take time."""
        clock = flown.memory.clock[self.number]
        return bool(not self.mission.lag_steps or flown.plans or clock > 0)

    def _end_network_decision(self, instant: int) -> FlightMemory:
        """Take up what is decided, if the next decision begins now; or begin the next leg."""
        flown, under_way = self.memory, self.memory.under_way
        is_between = flown.leg_start is None or (instant - flown.leg_start) % self.mission.lag_steps
        if is_between or under_way is None:
            return flown
        events: tuple[Event, ...] = ()
        if not under_way.is_finished:
            events = ({"kind": "unconfirmed", "agents": [self.number]},)
        flown = flown._replace(under_way=None, events=events)
        if under_way.commits:
            flown = flown.take_up(under_way.decision)
        if flown.next_leg is None:
            return flown
        self.memory = flown
        later = under_way.decision.later_leg
        return self._begin_leg(flown.next_leg, instant)._replace(leg_start=later)

    def _end_step(self, instant: int) -> FlightMemory:
        """Count the cost and the time of the step that was flown."""
        flown, mission = self.memory, self.mission
        assert flown.instant is not None and flown.control is not None
        if instant != flown.instant + 1:
            raise ValueError(
                f"agent {self.number} is called at instant {instant} after instant "
                f"{flown.instant}: call it at every multiple of plan.step_s = {mission.step:g}"
            )
        if not mission.lag_steps:
            self._require_finished()
        spent = compute_spent(mission, flown.control[None])
        memory, steps = flown.memory, flown.leg.steps
        if flown.leg_start is not None and self._has_begun(flown):
            memory = replace(memory, clock=np.minimum(memory.clock + 1, steps))
        held, time = np.tile(flown.control, (self.number + 1, 1)), flown.instant * mission.step
        planned = self._planned_controls(flown)
        estimate = estimator.predict(mission, flown.estimate, held, planned, time)
        spent = flown.spent + float(spent)
        return flown._replace(memory=memory, estimate=estimate, spent=spent)

    def _require_finished(self) -> None:
        if self.memory.instant is not None and not self.is_finished:
            raise ValueError(
                f"agent {self.number} has not finished its decision of instant "
                f"{self.memory.instant}: call it again, until all agents have finished"
            )

    def _hear(self, inbox: Sequence[AgentMessage]) -> FlightMemory:
        flown, own = self.memory, self.memory.decision
        assert own is not None
        if own.is_finished:
            return flown
        now = self._message
        assert isinstance(now, AgentMessage)
        messages = select_messages(self.number, now, inbox, flown.heard)
        decision = own.update([message.content for message in messages])
        heard = frozenset(message.sender for message in messages)
        flown = flown._replace(decision=decision, heard=heard)
        if decision.is_finished:
            flown = flown.take_up(decision)
            flown = flown._replace(control=self._control(flown))
        return flown

    def _go_on(self, before: NetworkDecision, inbox: Sequence[AgentPacket]) -> FlightMemory:
        """Act on the packets that have arrived; commit at once where messages take no time."""
        after = before.update(inbox)
        flown = self.memory._replace(under_way=after)
        if self.mission.lag_steps or before.is_finished or not after.is_finished:
            return flown
        flown = flown.take_up(after.decision)
        return flown._replace(control=self._control(flown))

    @property
    def _message(self) -> AgentMessage | AgentPacket | None:
        flown = self.memory
        if flown.under_way is not None:
            return flown.under_way.message
        if flown.decision is None:
            return None
        assert flown.instant is not None
        stage = flown.decision.stage_index, flown.decision.message
        return AgentMessage(self.number, flown.instant, *stage)

    def _control(self, flown: FlightMemory) -> Float[Array, " d"]:
        planned, known = self._planned_controls(flown), flown.estimate
        control = add_feedback(self.mission, planned, known.reference, known.mean)
        return np.asarray(control[self.number])

    def _planned_controls(self, flown: FlightMemory) -> Float[Array, "rows d"]:
        alone = self._graph.alive
        if not flown.committed:
            return np.zeros((len(alone), self.mission.axes))
        assert flown.instant is not None
        return controls_at(flown.committed, flown.instant, alone, self.mission)
