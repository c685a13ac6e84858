"""One vehicle of a reconfiguration, for a simulator or an onboard computer of the user's own."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from numpy.typing import ArrayLike

from problems.conic import TOLERANCE
from problems.solvers.verified import VerifiedSolver
from sato.network.graph import CommunicationGraph
from sato.reconfiguration import estimator
from sato.reconfiguration.agent_decision import Decision
from sato.reconfiguration.agent_inputs import (
    AgentMessage,
    as_instant,
    as_state,
    check_agent,
    check_inbox,
    checksum,
    select_messages,
)
from sato.reconfiguration.draw import draw_leg, is_drawn, with_targets
from sato.reconfiguration.first_commitment import check_stops
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.plan import Plans, compute_spent
from sato.reconfiguration.planning import give_up_closed
from sato.reconfiguration.state import (
    AgentMemory,
    DecisionContext,
    Event,
    begin_memory,
    update_believed,
)
from sato.reconfiguration.stopping import Commitment, Commitments, controls_at
from sato.reconfiguration.surroundings import Sensed, sense_surroundings
from sato.reconfiguration.tracking import add_feedback


class FlightMemory(NamedTuple):
    """All that an agent remembers between two calls, besides its mission and its number."""

    leg: Leg  # under way
    believed: Int[Array, " rows"]  # number of agents it believes in
    memory: AgentMemory  # the row of its number counts
    plans: Plans  # empty, or its own
    committed: Commitments  # empty, or its own
    estimate: estimator.Estimate  # of its state
    leg_start: int | None = None  # instant at which the leg began; None before
    instant: int | None = None  # last control instant; None before the first
    spent: float = 0.0  # fuel [m/s], or energy [m²/s³]
    control: Float[Array, " d"] | None = None  # held now [m/s²]
    decision: Decision | None = None
    seen_count: int = 0  # things that it has seen
    heard: frozenset[int] | None = None  # agents in the last round of an instant; None in the first


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
        target_count: int | None = None,
        leg_start: float | None = None,
        leg: Leg | None = None,
        commitment: Commitment | None = None,
    ) -> None:
        check_agent(mission, number, target_count, leg, commitment)
        if not is_drawn(mission):
            mission = mission.draw(np.random.default_rng(0))
        believed, start = target_count or mission.target_count or mission.agent_count, None
        if leg_start is not None:
            believed, start = target_count or 1, as_instant(mission, "leg_start", leg_start)
        self.mission, self.number = mission, number
        # Of arrays that have a row for each agent, only the row of this one counts.
        alone = np.arange(number + 1) == number
        self._graph = CommunicationGraph(np.zeros((len(alone), len(alone)), dtype=bool), alone)
        m = np.full(len(alone), believed)
        self.solver = VerifiedSolver(mission.solver, mission.tolerance or TOLERANCE)
        leg = draw_leg(mission, leg, believed, start or 0) if leg else mission.legs[0]
        leg = self._own_leg(leg)
        known = estimator.Estimate.none(len(alone), mission.axes)
        committed = {number: commitment} if commitment else {}
        memory = begin_memory(mission, leg, m)
        self.memory = FlightMemory(leg, m, memory, {}, committed, known, start)

    def step(
        self,
        time: float,
        state: ArrayLike,
        inbox: Sequence[AgentMessage],
        seen: Sequence[Sensed] = (),
    ) -> tuple[Float[Array, " d"], AgentMessage]:
        """Act in one round of messages.

        Args:
            time: Time since the start of the mission [s].
            state: Position [m] and velocity [m/s] that the agent measures, as an array (2 d,);
                those of the first call at a control instant count.
            inbox: Messages that the neighbors returned in the last round; those of earlier
                stages are ignored.
            seen: All that the agent has seen so far and its mission does not list as known, as it
                is now: obstacles, and the number and the state of each lost vehicle; those of the
                first call at a control instant count.

        Returns:
            The acceleration to hold until the next instant [m/s²], and a message to all neighbors.

        Raises:
            ValueError: An instant was skipped, or begins before the decision of the last one is
                made; the state is not one, or the first is too fast to stop within reach; or
                neighbors have the same number or another leg.
            OutOfTargets: The network has more agents than there are targets.
        """
        instant = as_instant(self.mission, "time", time)
        check_inbox(self.number, inbox)
        if instant != self.memory.instant:
            self.memory = self._begin_instant(instant, as_state(self.mission, state), seen)
        else:
            self.memory = self._hear(inbox)
        assert self.memory.control is not None
        return self.memory.control, self._message

    def set_targets(
        self,
        targets: Any,
        steps: int,
        *,
        count: int | None = None,
        recount: bool = False,
        choose: Literal["prefix", "nearest"] | None = None,
    ) -> None:
        """Begin another leg at the next control instant.

        All agents that hear each other must be told, between the same two instants.

        Args:
            targets: Array of (M, d) positions or (M, 2 d) states, or a shape.
            steps: Control steps until the deadline.
            count: Number of targets of a shape, as of a `sato.Leg`; and so the next two.
            recount: Take the number of agents from the bids of the leg before.
            choose: The first targets, or any of all.

        Raises:
            ValueError: The targets are too few or too close, or a decision is not finished.
        """
        self._require_finished()
        flown = self.memory
        leg = Leg(targets, steps, count=count, recount=recount, choose=choose)
        ended = flown.believed, flown.memory, flown.leg
        believed = update_believed(self.mission, *ended, leg.recount)
        begins = 0 if flown.instant is None else flown.instant + 1
        leg = self._own_leg(draw_leg(self.mission, leg, int(believed[self.number]), begins))
        memory = begin_memory(self.mission, leg, believed)
        self.memory = flown._replace(
            leg=leg, believed=believed, memory=memory, plans={}, leg_start=None
        )

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
    def is_finished(self) -> bool:
        """True once the decision of the last instant is made."""
        decision = self.memory.decision
        return decision is not None and decision.is_finished

    @property
    def target_index(self) -> int:
        """Index of the target that the agent holds; −1 before the first auction."""
        return int(self.memory.memory.target_index[self.number])

    @property
    def has_arrived(self) -> bool:
        """True from the deadline of the agent's plan on, if that leads to its target."""
        plan, clock = self.memory.plans.get(self.number), self.memory.memory.clock[self.number]
        is_planned = plan is not None and plan.target_index is not None
        return bool(clock == self.memory.leg.steps and is_planned)

    @property
    def events(self) -> tuple[Event, ...]:
        """Constraints relaxed, and clocks reset, in the last decision."""
        return self.memory.decision.events if self.memory.decision else ()

    def _begin_instant(self, instant: int, state: Array, seen: Sequence[Sensed]) -> FlightMemory:
        flown, mission, leg = self.memory, self.mission, self.memory.leg
        joins = flown.instant is None and flown.leg_start not in (None, instant)
        if flown.instant is not None:
            flown = self._end_step(instant)
        else:
            alone = np.array([self.number])
            check_stops(mission, alone, state[None], "state", flown.committed, instant)
        measured = np.tile(state, (self.number + 1, 1))
        estimate = estimator.update(mission, flown.estimate, measured)
        begun = instant if flown.leg_start is None else flown.leg_start
        flown = flown._replace(estimate=estimate, leg_start=begun)
        if flown.instant is None:  # the deadline of the leg is that of all
            clock = np.full_like(flown.memory.clock, min(instant - begun, leg.steps))
            flown = flown._replace(memory=replace(flown.memory, clock=clock))
        when, solvers = (instant - begun, instant * mission.step), [self.solver] * len(measured)
        known = self._graph, estimate.reference, flown.memory
        around = sense_surroundings(mission, when[1], len(measured), seen)
        context = DecisionContext(mission, leg, *known, *when, solvers, around)
        sees_new = [self.number] if len(seen) > flown.seen_count else []
        closed = give_up_closed(context, flown.plans, sees_new)
        joins |= closed.get(self.number) is not flown.plans.get(self.number)
        flown = flown._replace(plans=closed, seen_count=len(seen))
        shared = begun, checksum(mission, leg)
        own = flown.plans, flown.committed, flown.spent
        decision = Decision.begin(self.number, context, *own, shared, joins)
        flown = flown._replace(instant=instant, decision=decision, heard=None)
        return flown._replace(control=self._control(flown))

    def _end_step(self, instant: int) -> FlightMemory:
        """Count the cost and the time of the step that was flown."""
        flown, mission = self.memory, self.mission
        assert flown.instant is not None and flown.control is not None
        if instant != flown.instant + 1:
            raise ValueError(
                f"agent {self.number} is called at instant {instant} after instant "
                f"{flown.instant}: call it at every multiple of plan.step_s = {mission.step:g}"
            )
        self._require_finished()
        spent = compute_spent(mission, flown.control[None])
        memory, steps = flown.memory, flown.leg.steps
        if flown.leg_start is not None:
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
        messages = select_messages(self.number, self._message, inbox, flown.heard)
        decision = own.update([message.content for message in messages])
        heard = frozenset(message.sender for message in messages)
        flown = flown._replace(decision=decision, heard=heard)
        if decision.is_finished:
            flown = flown._replace(memory=decision.context.memory, plans=decision.plans)
            flown = flown._replace(committed=decision.committed)
            flown = flown._replace(control=self._control(flown))
        return flown

    @property
    def _message(self) -> AgentMessage:
        decision, instant = self.memory.decision, self.memory.instant
        assert decision is not None and instant is not None
        return AgentMessage(self.number, instant, decision.stage_index, decision.stage.message)

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
