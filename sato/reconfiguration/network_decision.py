"""Decisions over a network that takes time: who gets through, and takes up what it has chosen.

The outcome of a decision is that of synchronous rounds among all that hear each other when it
begins. An agent that gets through them before the next decision begins takes it up, if what it has
chosen is clear of all that its neighbors may go on flying. It says so, and those that wait for it
may follow. All others keep what they had. No agreement on the last message is needed.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.network.channel import NEVER, Channel
from sato.network.flooding import census_rounds
from sato.network.graph import CommunicationGraph, Pairs
from sato.network.load import Load
from sato.network.synchronizer import Synchronizer
from sato.reconfiguration import stopping
from sato.reconfiguration.commitment import NOBODY
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.plan import Plans
from sato.reconfiguration.state import AgentMemory, DecisionContext, Event


@dataclass(frozen=True, eq=False)
class Outcome:
    """Decision of the agents of some networks: what those that get through take up."""

    agents: Bool[Array, " agents"]  # that have decided
    memory: AgentMemory
    plans: Plans
    committed: stopping.Commitments
    events: list[Event]
    was_reset: Bool[Array, " agents"]  # the clock was set back
    blocked: Bool[Array, "agents targets"] | None  # targets that were left out
    loads: tuple[Load, ...]  # of each purpose, after the census
    # Pairs of which the first commits only once it knows that the second does.
    waits: Pairs = (NOBODY, NOBODY)

    def of(self, some: Bool[Array, " agents"]) -> "Outcome":
        """Return what some of the agents have decided, with the events that are theirs."""
        agents, events = self.agents & some, []
        for event in self.events:
            theirs = [i for i in event["agents"] if some[i]]
            if theirs or (not event["agents"] and agents.any()):
                events.append({**event, "agents": theirs})
        return replace(
            self,
            agents=agents,
            plans={i: plan for i, plan in self.plans.items() if some[i]},
            committed={i: own for i, own in self.committed.items() if some[i]},
            events=events,
            was_reset=self.was_reset & some,
            blocked=None if self.blocked is None else self.blocked & some[:, None],
        )


@dataclass(frozen=True, eq=False)
class DecisionsUnderWay:
    """Decisions of an instant, while they are under way."""

    outcomes: list[Outcome]
    graph: CommunicationGraph  # of all, when they began
    channel: Channel
    enters: Int[Array, " agents"]  # rounds of the network in which they begin, by their clocks
    have_arrived: bool  # all agents, when it began

    def finish(
        self, mission: Reconfiguration, stops: Int[Array, " agents"]
    ) -> tuple[list[Bool[Array, " agents"]], Bool[Array, " agents"]]:
        """Find out who gets through; an agent falls silent in a round, NEVER if it does not.

        For each outcome, that is the agents that take up what they have chosen; and those that have
        heard of all in their component, or were lost.
        """
        ends = np.minimum(stops, self.enters + mission.decision_rounds)
        synchronizer = Synchronizer(self.channel, ends)
        alive, none = self.graph.alive, np.zeros(len(ends), dtype=int)
        discovered = synchronizer.advance(self.enters, none + 1)
        begun = np.maximum(discovered, self.enters + mission.link.discovery_rounds)
        begun = np.where(alive & (begun < ends), begun, NEVER)
        counted = synchronizer.advance(
            begun, np.where(alive, census_rounds(self.graph.diameter) - 1, 0)
        )
        through = []
        for outcome in self.outcomes:
            deciding = outcome.agents
            chosen = synchronizer.advance(
                counted, np.where(deciding, sum(load.rounds for load in outcome.loads), 0)
            )
            chosen[~deciding] = NEVER
            through.append(confirm(synchronizer, chosen, outcome.waits) < ends)
        return through, ~alive | (counted < ends)


def confirm(
    synchronizer: Synchronizer, chosen: Int[Array, " agents"], waits: Pairs
) -> Int[Array, " agents"]:
    """Return the round in which each agent says that it commits; NEVER if it does not.

    Each has chosen in a round before. Of the pairs that wait, the first waits until it hears that
    of the second.
    """
    first, second = waits
    promised, edge = chosen.copy(), synchronizer.find_edges(second, first)
    promised[first] = NEVER
    while True:
        after = chosen.copy()
        np.maximum.at(after, first, synchronizer.hear(promised)[edge])
        if np.array_equal(after, promised):
            return after
        promised = after


def whole_steps(mission: Reconfiguration, delay: Float[Array, " agents"]) -> list[int]:
    """Return by how many whole steps clocks are behind by delays [s]; nothing where none is."""
    most = int(mission.link.skew / mission.step + 1e-9)
    return np.minimum(np.rint(delay / mission.step), most).astype(int).tolist() if most else []


def stop_at_once(
    mission: Reconfiguration, number: int, state: Array, instant: int
) -> stopping.Commitment:
    """Return the commitment of an agent that has made none: it stops."""
    alone, velocity = np.array([number]), state[None, mission.axes :]
    (u,), (steps,) = stopping.held_controls(mission, alone, velocity, {}, instant)
    return stopping.Commitment(instant, u[:steps])


def foresee(
    context: DecisionContext, committed: stopping.Commitments, has_begun: Bool[Array, " agents"]
) -> DecisionContext:
    """Return the context in which agents find themselves when they take up a decision.

    Until then they fly what they have committed to, and their clocks run where these have begun.
    """
    mission, lag, around = context.mission, context.mission.lag_steps, context.surroundings
    each, instant = range(len(context.state)), context.instant
    held = [stopping.committed_controls(mission, i, committed, instant)[:lag] for i in each]
    model = mission.discretize(lag, context.time)
    x = model.simulate(context.state, stopping.pad_controls(held, lag))[:, -1]
    if around is not None:
        state, d = around.state.copy(), mission.axes
        state[:, :d] += lag * mission.step * state[:, d:]
        around = around._replace(state=state)
    clock = np.minimum(context.memory.clock + lag * has_begun, context.leg.steps)
    time, step_index = context.time + lag * mission.step, context.step_index + lag
    memory = replace(context.memory, clock=clock)
    return context._replace(
        state=x, memory=memory, step_index=step_index, time=time, surroundings=around
    )
