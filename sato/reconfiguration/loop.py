"""Loop of a reconfiguration: bid, plan, fly, repeat [Morgan2016, Method 3]."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy import ndarray as Array

from problems.conic import TOLERANCE
from problems.solvers.verified import VerifiedSolver
from sato.network.channel import NEVER, Channel
from sato.network.graph import CommunicationGraph
from sato.network.load import PURPOSES, Load
from sato.reconfiguration import estimator, planning, state
from sato.reconfiguration.assignment import assign_targets, claim_targets
from sato.reconfiguration.census import count_census
from sato.reconfiguration.clock import announce_clock
from sato.reconfiguration.commitment import CommitmentChoice, commit
from sato.reconfiguration.disturbances import disturb_control, draw_losses, measure
from sato.reconfiguration.first_commitment import Traffic, find_first_commitments
from sato.reconfiguration.leg import longest_leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.network_decision import (
    DecisionsUnderWay,
    Outcome,
    foresee,
    stop_at_once,
    whole_steps,
)
from sato.reconfiguration.orbital_commitment import commit_in_orbit
from sato.reconfiguration.plan import (
    Plans,
    bids_on_change,
    compute_spent,
    give_up_missed,
    has_changed_network,
    have_decided_apart,
    is_auction_due,
    is_planning_due,
    remaining_cost,
)
from sato.reconfiguration.stopping import Commitment, Commitments, controls_at
from sato.reconfiguration.surroundings import find_surroundings
from sato.reconfiguration.tracking import add_feedback


def simulate(
    mission: Reconfiguration, rng: np.random.Generator
) -> Iterator[state.ReconfigurationFrame]:
    """Simulate every leg of a drawn mission; yield a frame at every control instant.

    The generator draws losses, disturbances and noise.
    """
    flight = _Flight(mission, rng)
    for number in range(len(mission.legs)):
        yield from flight.fly_leg(number)
    none = np.full((len(mission.initial_states), mission.axes), np.nan)
    yield flight.make_frame(flight.make_graph(), none, none, None)


class _Flight:
    """Flight under way: true states of the agents, and all that they remember."""

    def __init__(self, mission: Reconfiguration, rng: np.random.Generator) -> None:
        self.mission, self.rng = mission, rng
        self.leg, self.leg_index, self.step_index = mission.legs[0], 0, 0
        self.events: list[state.Event] = []  # since the last frame
        self.x, self.alive = mission.initial_states.copy(), mission.alive
        self.estimate = estimator.Estimate.none(len(self.x), mission.axes)
        # An agent that joins later knows of itself alone, and learns m from those that it meets.
        m = np.where(self.alive, mission.target_count or int(self.alive.sum()), 1)
        self.believed, self.memory = m, state.AgentMemory.initial(m)
        self.plans: Plans = {}
        self.committed: Commitments = find_first_commitments(mission)
        self.surroundings = find_surroundings(mission)
        self.sees_new = np.zeros(len(m), dtype=bool)  # since the last decisions began
        self.waiting: list[int] = []  # agents that join as soon as there is room
        self.called: list[int] = []  # agents that call for an auction when they decide next
        self.pending: DecisionsUnderWay | None = None  # decisions that are under way
        self.lost_at: dict[int, int] = {}  # instant at which each agent was lost
        self.link_rng = rng.spawn(1)[0]  # draws losses and delays of messages, and clocks
        # Clocks are behind by a time, and what agents fly by whole steps of it.
        self.clock_delay = self.link_rng.uniform(0.0, mission.link.skew, len(m))  # [s]
        if steps := whole_steps(mission, self.clock_delay):
            self.events.append({"kind": "clocks", "agents": list(range(len(m))), "steps": steps})
        self.errors = list[str]()  # of solvers of the user's own
        chosen = mission.solver, mission.tolerance or TOLERANCE, self.errors
        self.solvers = [VerifiedSolver(*chosen) for _ in m]  # its own each
        self.spent = np.zeros(len(m))  # fuel [m/s], or energy [m²/s³]
        self.loads = [Load.none(len(m)) for _ in PURPOSES]  # at this instant
        self.received = np.zeros((2, len(m), len(PURPOSES)), dtype=np.int64)  # until now

    def fly_leg(self, number: int) -> Iterator[state.ReconfigurationFrame]:
        """Fly until all agents have arrived."""
        mission, flown = self.mission, self.leg
        self.leg, self.leg_index = mission.legs[number], number
        steps, recount = self.leg.steps, self.leg.recount
        self.believed = state.update_believed(mission, self.believed, self.memory, flown, recount)
        self.memory, self.plans = state.begin_memory(mission, self.leg, self.believed), {}
        self.left_out: set[int] = set()  # targets that some agents know to be blocked
        self.pending = None
        self._note("leg_start", self.alive, leg=number)
        longest = longest_leg(steps, mission.lag_steps)
        for k in range(longest + 1):
            is_known = self._end_decisions(k)
            joined = self._admit_joins(k)
            self._apply_losses(k)
            if not joined and is_known and (mission.lag_steps or self._have_arrived(k).all()):
                break
            if k == longest:
                what = f"the leg is given up after {longest} steps"
                self._note("infeasible", self.alive, what=what)
                break
            graph, measured = self.make_graph(), measure(mission, self.x, self.rng)
            self.estimate = estimator.update(mission, self.estimate, measured)
            known = self.estimate.reference
            decides = not mission.lag_steps or k % mission.replan_steps == 0
            seen_by = self._look_around(decides)
            rest = self.memory, k, self.step_index * mission.step, self.solvers, self.surroundings
            context = state.DecisionContext(mission, self.leg, graph, known, *rest)
            self.plans = give_up_missed(context, self.plans)
            closed = planning.give_up_closed(context, self.plans, seen_by)
            alarmed = [i for i, plan in closed.items() if plan is not self.plans[i]]
            self.plans = closed
            if alarmed:
                self.events.append({"kind": "closed", "agents": alarmed})
            self.called += [*joined, *alarmed]
            if decides:
                self.loads[0] = count_census(context)
            if not mission.lag_steps:
                for deciding, bids in self._schedule_decisions(context, self.called):
                    own = context._replace(graph=deciding, memory=self.memory)
                    self._take_up(self._decide(own, bids))
                self.called = []
            elif decides:
                self._begin_decisions(context)
            planned = controls_at(self.committed, self.step_index, self.alive, mission)
            control = add_feedback(mission, planned, known, self.estimate.mean)
            applied = disturb_control(mission, control, self.rng)
            seen = measured if mission.position_noise or mission.velocity_noise else None
            yield self.make_frame(graph, control, applied, seen)
            self._propagate(planned, control, applied)
        if number == len(mission.legs) - 1 and self.waiting:
            self.events.append({"kind": "refused", "agents": self.waiting})
        memory, component = self.memory, self.make_graph().component.tolist()
        held, believed = memory.target_index.tolist(), memory.target_count.tolist()
        ended = {"leg": number, "target": held, "believed": believed, "component": component}
        self._note("leg_end", self.alive, **ended)

    def _look_around(self, decides: bool) -> list[int]:
        """Let agents see what is near; return those whose plans were made without some of it.

        Over a network, they take up a plan that was made before they saw what has come since.
        """
        before = self.surroundings
        if before is None:
            return []
        self.surroundings = before.seen_from(self.mission, self.x)
        is_new = self.alive & (self.surroundings.is_known & ~before.is_known).any(axis=1)
        self.sees_new |= is_new
        if decides:
            is_new, self.sees_new = self.sees_new, np.zeros_like(is_new)
        return np.flatnonzero(is_new & self.alive).tolist()

    def _have_arrived(self, k: int) -> Array:
        # Agents whose last plan was not clear may not be where their clocks have them.
        is_due = any(at_step > k for _, at_step in self.mission.joining(self.leg_index))
        # It may be something that passes, and no agent, for which one waits to join.
        nobody = self._traffic._replace(alive=np.zeros_like(self.alive), committed={})
        if is_due or not all(map(nobody.has_room, self.waiting)):
            return np.zeros(1, dtype=bool)
        live, plans = np.flatnonzero(self.alive), self.plans
        is_planned = [i in plans and plans[i].target_index is not None for i in live.tolist()]
        return np.asarray((self.memory.clock[live] >= self.leg.steps) & np.array(is_planned, bool))

    @property
    def _traffic(self) -> Traffic:
        own = self.x, self.alive, self.committed, self.step_index, self.surroundings
        return Traffic(self.mission, *own)

    def _note(self, kind: str, agents: Array, **more: object) -> None:
        self.events.append({"kind": kind, "agents": np.flatnonzero(agents).tolist(), **more})

    def make_graph(self) -> CommunicationGraph:
        """Connect all live agents within hearing."""
        position = self.x[:, : self.mission.axes]
        return CommunicationGraph.from_positions(position, self.mission.comm_radius, self.alive)

    def _admit_joins(self, k: int) -> list[int]:
        """Return the agents that join at a step of the leg: over a network, when others decide."""
        mission = self.mission
        for agents, at_step in mission.joining(self.leg_index):
            self.waiting += agents if at_step == k else []
        if mission.lag_steps and k % mission.replan_steps:
            return []
        joined, waits = self._traffic.admit(self.waiting), mission.waits
        self.alive = self.alive.copy()
        self.alive[joined] = True
        if joined:  # the deadline of the leg is that of all
            clock = self.memory.clock.copy()
            clock[joined] = min(max(k - mission.lag_steps, 0), self.leg.steps)
            self.memory = replace(self.memory, clock=clock)
        refused = [i for i in self.waiting if not (self.alive[i] or waits[i])]
        self.waiting = [i for i in self.waiting if waits[i] and not self.alive[i]]
        for kind, those in (("join", joined), ("refused", refused)):
            if those:
                self.events.append({"kind": kind, "agents": those})
        return joined

    def _apply_losses(self, k: int) -> None:
        """Lose the agents that are lost at a step of the leg."""
        for loss in self.leg.losses:
            if loss.at_step == k:
                lost = draw_losses(loss, self.x[:, : self.mission.axes], self.alive, self.rng)
                self.alive = self.alive.copy()
                self.alive[lost] = False
                self.lost_at |= dict.fromkeys(lost, self.step_index)
                self.memory = replace(
                    self.memory, target_index=np.where(self.alive, self.memory.target_index, -1)
                )
                event: state.Event = {"kind": "loss", "agents": sorted(lost)}
                if loss.body == "coast" and self.surroundings is not None:
                    gone = sorted(lost)
                    self.surroundings = self.surroundings.with_lost(gone, self.x[gone])
                    event |= {"body": "coast"}
                self.events.append(event)

    def _schedule_decisions(
        self, context: state.DecisionContext, called: list[int]
    ) -> list[tuple[CommunicationGraph, bool]]:
        """Return the components that plan at a step, and whether they bid first.

        An agent that joins, or sees that its plan is closed, calls for an auction in its component
        at once; a loss is silence, and is noticed when agents plan next. A component that is about
        to arrive keeps its plans: with so few steps left, a small correction takes much control.
        """
        decisions, graph = list[tuple[CommunicationGraph, bool]](), context.graph
        is_central = self.mission.assignment == "central"
        if called:
            beside = np.isin(graph.component, graph.component[called]) | is_central
            decisions, graph = [(graph.subgraph(beside), True)], graph.subgraph(~beside)
        if context.step_index % self.mission.replan_steps:
            return decisions
        is_new = np.zeros(len(self.x), dtype=bool)
        if bids_on_change(self.mission):
            together = graph.component[:, None] == graph.component
            is_new = has_changed_network(self.memory.claim_step, together)
            is_new |= have_decided_apart(self.memory.claim_step, graph)
        is_due = graph.component_any(is_planning_due(context, self.plans) | is_new)
        is_due |= is_central and bool(is_due[graph.alive].any())
        bids = graph.component_any(is_auction_due(context, self.plans) | is_new)
        parts = (graph.alive & is_due & bids, True), (graph.alive & is_due & ~bids, False)
        return decisions + [(graph.subgraph(some), bid) for some, bid in parts if some.any()]

    def _decide(self, context: state.DecisionContext, bids: bool) -> Outcome:
        solves, counted, error_count = 0, self._count_faults(), len(self.errors)
        memory, blocked = context.memory, None
        auction = Load.none(len(self.x))
        was_reset = np.zeros(len(self.x), dtype=bool)
        heard = memory.clock
        if bids:
            cost = remaining_cost(self.plans, context)
            is_due = is_planning_due(context, self.plans)
            announced = announce_clock(is_due, memory.clock, self.leg.steps)
            decision = assign_targets(context, cost, -context.graph.component_max(-announced))
            memory, solves = decision.memory, decision.solve_count
            was_reset, blocked, auction = decision.was_reset, decision.blocked, decision.load
        elif bids_on_change(self.mission):
            memory = claim_targets(context, memory)
        context = context._replace(memory=memory)
        own = context, self.spent, self.plans, solves, heard
        planned, events, exchange = planning.plan_trajectories(*own)
        if self.mission.printed:
            now = context.instant
            committed = {i: Commitment(now, plan.trajectory.u) for i, plan in planned.items()}
            found = CommitmentChoice(committed, planned, [], Load.none(len(self.x)))
        elif self.mission.is_point_mass:
            found = commit(context, planned, self.committed)
        else:
            found = commit_in_orbit(context, planned, self.committed, self.plans, heard)
        if found.cautious:
            events.append({"kind": "cautious", "agents": found.cautious})
        rejected, failed = self._count_faults() - counted
        reasons = {self.solvers[i].last_rejection for i in np.flatnonzero(rejected)}
        faults = {"fallback": (rejected, reasons)}
        faults["solver_error"] = failed, set(self.errors[error_count:])
        for kind, (counts, said) in faults.items():
            if counts.any():
                more = {"programs": int(counts.sum()), "reasons": sorted(said)}
                events.append({"kind": kind, "agents": np.flatnonzero(counts).tolist(), **more})
        made = found.plans, found.committed, events, was_reset, blocked
        loads = auction, exchange, found.load
        self.loads[1:] = [a.plus(b) for a, b in zip(self.loads[1:], loads, strict=True)]
        return Outcome(context.graph.alive, memory, *made, loads, waits=found.waits)

    def _count_faults(self) -> Array:
        # Of the solver of each agent: answers that were rejected, and errors.
        return np.array([(own.fallback_count, own.error_count) for own in self.solvers]).T

    def _take_up(self, outcome: Outcome) -> None:
        """Let agents take up what they have decided."""
        before, self.memory = self.memory, self.memory.with_rows(outcome.memory, outcome.agents)
        moved = self.alive & (before.target_index != self.memory.target_index)
        if outcome.was_reset.any():
            self._note("reset", outcome.was_reset)
        self._note_blocked(outcome.blocked)
        if moved.any():
            self._note("assignment", moved, target=self.memory.target_index[moved].tolist())
        self.plans, self.committed = self.plans | outcome.plans, self.committed | outcome.committed
        self.events += outcome.events

    def _begin_decisions(self, context: state.DecisionContext) -> None:
        """Begin to decide what is flown from the next decision on."""
        mission = self.mission
        for i in np.flatnonzero(self.alive).tolist():
            if i not in self.committed:
                self.committed[i] = stop_at_once(mission, i, context.state[i], self.step_index)
        later = foresee(context._replace(memory=self.memory), self.committed, self._has_begun)
        self.plans = give_up_missed(later, self.plans)  # that end before they are flown again
        outcomes = []
        for deciding, bids in self._schedule_decisions(later, self.called):
            outcomes.append(self._decide(later._replace(graph=deciding, memory=later.memory), bids))
        self.called, graph = [], context.graph
        enters = mission.link.count_rounds(self.clock_delay)
        channel = Channel(mission.link, graph, self.link_rng.spawn(1)[0])
        have_arrived = bool(self._have_arrived(context.step_index).all()) and not outcomes
        self.pending = DecisionsUnderWay(outcomes, graph, channel, enters, have_arrived)

    @property
    def _has_begun(self) -> Array:
        """True for agents whose clocks run: from their first plan in a leg on, over a network."""
        has_plan = np.isin(np.arange(len(self.x)), list(self.plans))
        return np.asarray(has_plan | (self.memory.clock > 0) | (self.mission.lag_steps == 0))

    def _end_decisions(self, k: int) -> bool:
        """Let agents that got through take up what they decided.

        Those that join later have to be clear of that. True where all know that all have arrived,
        if they have: over a network that takes time, they know it of each other; else at once.
        """
        mission, pending = self.mission, self.pending
        if not mission.lag_steps:
            return k > 0
        if pending is None or k % mission.replan_steps:
            return False
        self.pending, stops = None, np.full(len(self.x), NEVER)
        begun = self.step_index - mission.lag_steps
        for i, instant in self.lost_at.items():
            flown = max(0, instant - begun) * mission.step
            stops[i] = pending.enters[i] + mission.link.count_rounds(flown)
        each, has_heard = pending.finish(mission, stops)
        late = self.alive & ~has_heard
        for outcome, through in zip(pending.outcomes, each, strict=True):
            late |= outcome.agents & self.alive & ~through
            self._take_up(outcome.of(through & self.alive))
        if late.any():
            self._note("unconfirmed", late)
        return pending.have_arrived and not late.any()

    def _note_blocked(self, blocked: Array | None) -> None:
        """Note the targets that are left out from now on."""
        if blocked is None:
            return
        new = np.asarray(blocked.any(axis=0))
        new[list(self.left_out)] = False
        if new.any():
            self.left_out.update(np.flatnonzero(new).tolist())
            agents = np.asarray(blocked[:, new].any(axis=1))
            self._note("blocked", agents, targets=np.flatnonzero(new).tolist())

    def _propagate(self, planned: Array, control: Array, applied: Array) -> None:
        mission, steps, clock = self.mission, self.leg.steps, self.memory.clock
        commanded, time = np.nan_to_num(control)[:, None], self.step_index * mission.step
        self.estimate = estimator.predict(mission, self.estimate, control, planned, time)
        flown = mission.flown_plant.propagate(self.x, np.nan_to_num(applied), time, mission.step)
        around, moves = self.surroundings, self.alive.copy()
        if around is not None:
            moves[around.vehicle[around.is_lost]] = True
        self.x = np.where(moves[:, None], flown[1], self.x)
        self.surroundings = around and around.after(mission, self.x)
        self.spent = self.spent + compute_spent(mission, commanded)
        later = np.where(self._has_begun, np.minimum(clock + 1, steps), clock)
        later = np.where(self.alive, later, 0)
        arrived = self.alive & (later == steps) & (clock < steps)
        if arrived.any():
            self._note("arrival", arrived)
        self.memory = replace(self.memory, clock=later)
        self.step_index += 1

    def make_frame(
        self, graph: CommunicationGraph, control: Array, applied: Array, measured: Array | None
    ) -> state.ReconfigurationFrame:
        """Record this instant, and the events since the last one."""
        d, events = self.mission.axes, tuple(self.events)
        rounds, *received = (np.stack(part, axis=1) for part in zip(*self.loads, strict=True))
        self.received = self.received + received
        self.events, self.loads = [], [Load.none(len(self.x)) for _ in PURPOSES]
        return state.ReconfigurationFrame(
            time=self.step_index * self.mission.step,
            position=self.x[:, :d],
            velocity=self.x[:, d:],
            alive=self.alive,
            component=graph.component,
            control=control,
            applied_control=applied,
            leg_index=self.leg_index,
            target_index=np.where(self.alive, self.memory.target_index, -1),
            target_count=self.memory.target_count,
            measured_position=None if measured is None else measured[:, :d],
            measured_velocity=None if measured is None else measured[:, d:],
            rounds=rounds.max(axis=0),
            received=self.received,
            events=events,
        )
