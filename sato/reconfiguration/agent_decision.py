"""Decision of one agent at a control instant, by messages alone [Morgan2016, Method 3].

All agents of a component go through the same stages, and enter each in the same round. D is the
diameter; the agents know it, and each other's reports, from the first stage on.

    stage      message                          ends for all                      rounds
    census     reports `Hello`                  all know D                        3 D + 1
    terms      reports `AuctionTerms`           all have heard all                D
    auction    bids, reports `AuctionReport`    D rounds after the last stopped
    bending    path                             D + 1 rounds after the last moved
    meeting    trajectory                       6; only where plans are kept, as bending
    exchange   trajectory, reports              D rounds after the last was final
    holding    committed trajectory, in orbit   all have heard their neighbors    1
    choice     offer                            D + 1 rounds after the last change
    reports    reports `ChoiceReport`           all have heard all                D
    turns      committed trajectory             each cautious agent has had one   as many
    evasion    reports `EvasionReport`          all have heard all                D

Nothing rests in orbit, where the choice is the last stage. Evasion follows where something comes
over what an agent has chosen; from the reports all compute the same changes.
Terms and auction are left out where plans are kept and no agent calls for an auction.
The auction begins again from its terms where a target that is left over is dear, where a winner's
cost was only a lower bound, where the clock is reset, and where a target out of reach was won. An
instant at which none of the component is due to plan ends with the census.

`assign_targets` and `plan_trajectories` compute the same for all agents at once. Here the same
functions are called with the agent alone alive: of every array, only the row of its number counts.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.auctions.bidder import VsdaaBidder, WinningBids
from sato.auctions.vsdaa import Opening, VsdaaAuction
from sato.network.flooding import Census, CensusMessage, Flood, Reports
from sato.reconfiguration import assignment, commitment, evasion, planning, stopping, target_costs
from sato.reconfiguration.agent_stages import (
    AuctionTerms,
    Bidding,
    ChoiceReport,
    Choosing,
    Exchange,
    Holding,
    Turns,
    extend,
)
from sato.reconfiguration.auction_opening import (
    count_targets,
    counts_members,
    forecast_alone,
    has_dear_leftovers,
    is_forecast,
)
from sato.reconfiguration.bidding_rules import (
    apply_bidding_rules,
    compute_epsilon,
    firm_penalty,
    least_penalty,
)
from sato.reconfiguration.blocked_targets import find_all_blocked, order_targets
from sato.reconfiguration.census import (
    Hello,
    check_census,
    checksum_members,
    has_changed_network,
    has_later_leg,
)
from sato.reconfiguration.clock import announce_clock
from sato.reconfiguration.halfway_stages import Bending, Meeting
from sato.reconfiguration.offers import Offers, is_kept, make_offers
from sato.reconfiguration.orbital_commitment import keep_previous, make_orbital_offers, refuse_start
from sato.reconfiguration.plan import (
    Plan,
    Plans,
    bids_on_change,
    is_auction_due,
    is_planning_due,
    remaining_cost,
)
from sato.reconfiguration.state import DecisionContext, Event
from sato.scenario.errors import InputError
from sato.scp.halfway import come_after
from sato.scp.planner import Planner


class Decision(NamedTuple):
    """Memory of one agent while it decides."""

    number: int
    context: DecisionContext  # of the agent alone
    plans: Plans  # empty, or the agent's own
    committed: stopping.Commitments  # empty, or the agent's own
    spent: Float[Array, " rows"]  # fuel [m/s], or energy [m²/s³]
    stage: Any  # Census, Flood, Bidding, Bending, Meeting, Exchange, Holding, Choosing, Turns
    stage_index: int = 0
    is_finished: bool = False
    diameter: int = 0
    members: tuple[int, ...] = ()  # numbers of the agents of its component
    has_claims: bool = False  # True once it knows the claims of all of these
    blocked: tuple[int, ...] = ()  # targets that it knows to be blocked, and then any of these
    heard_clock: int = 0  # the clock with the most time left among these
    attempt: Literal["first", "reset", "firm"] = "first"  # of the auction
    table: target_costs.CostTable | None = None  # of the auction
    is_unpriced: bool = False  # it begins without prices
    planned_cost: Float[Array, " rows"] | None = None  # to the target that it holds
    unreachable: tuple[int, ...] = ()  # its number, if its target is out of reach
    previous: Plan | None = None  # in orbit: its plan before this decision
    is_unclear: bool = False  # in orbit: what it has committed to is not clear of others
    choosing: Choosing | None = None  # once it has chosen
    is_evading: bool = False  # something comes over what an agent of its component has chosen
    turns: Turns | None = None  # once all have had theirs, if they evade then
    # Neighbors that have to commit before it can, where it may meet what they committed to before.
    waits: frozenset[int] = frozenset()
    events: tuple[Event, ...] = ()

    @classmethod
    def begin(
        cls,
        number: int,
        context: DecisionContext,
        plans: Plans,
        committed: stopping.Commitments,
        spent: float,
        leg: tuple[int, int],
        joins: bool,
        has_arrived: bool = False,
    ) -> "Decision":
        """Begin with the census.

        The leg is given by the instant at which it began, and a checksum of its targets. An agent
        that joins calls for an auction at once.
        """
        memory = context.memory
        due, auction_due = is_planning_due(context, plans), is_auction_due(context, plans)
        step, clock = int(memory.claim_step[number, number]), int(memory.clock[number])
        is_due = bool(due[number]), bool(auction_due[number])
        hello = Hello(number, leg, *is_due, joins, clock, has_arrived=has_arrived)
        if step >= 0:
            others = np.flatnonzero(memory.claim_step[number] == step).tolist()
            hello = hello._replace(claim_step=step, together=checksum_members(others))
        stage = Census(CensusMessage(frozenset([hello])))
        return cls(number, context, plans, committed, np.full(len(due), spent), stage)

    @property
    def message(self) -> Any:
        """Message to the neighbors."""
        return self.stage.message

    @property
    def has_decided(self) -> bool:
        """True once the agent has chosen what it commits to; never where nothing is due."""
        return self.is_finished and not isinstance(self.stage, Census)

    @property
    def hellos(self) -> Reports:
        """Reports with which the instant began, where nothing is due."""
        is_over = self.is_finished and isinstance(self.stage, Census)
        return self.stage.message.reports if is_over else frozenset()

    @property
    def later_leg(self) -> int | None:
        """Instant at which others began a later leg than the agent's; None where none did."""
        began = {hello.agent: hello.leg[0] for hello in self.hellos}
        latest = max(began.values(), default=-1)
        return latest if began and latest > began[self.number] else None

    @property
    def is_leg_over(self) -> bool:
        """True once all agents of the component know that all have arrived."""
        hellos = self.hellos
        have_arrived = bool(hellos) and all(hello.has_arrived for hello in hellos)
        return self.later_leg is not None or (have_arrived and not has_later_leg(hellos))

    def update(self, inbox: Sequence[Any]) -> "Decision":
        """Act once, on the messages that neighbors sent in this stage."""
        if self.is_finished:
            return self
        decision = self._replace(stage=self.stage.update(inbox))
        while decision.stage.is_finished and not decision.is_finished:
            decision = decision._enter_next_stage()
        return decision

    def _enter_next_stage(self) -> "Decision":
        if isinstance(self.stage, Census):
            return self._after_census(self.stage)
        if isinstance(self.stage, Flood):
            if self.turns is not None:
                return self._after_evasion(self.turns, self.stage.message)
            if self.choosing is not None:
                return self._begin_turns(self.stage.message)
            return self._begin_auction(self.stage)
        if isinstance(self.stage, Bidding):
            return self._after_auction(self.stage)
        if isinstance(self.stage, Bending):
            return self._enter(Meeting(self.stage.planner))
        if isinstance(self.stage, Meeting):
            return self._exchange(come_after(self.stage.planner))
        if isinstance(self.stage, Exchange):
            return self._after_exchange(self.stage.planner)
        if isinstance(self.stage, Holding):
            held = self.stage
            return self._replace(is_unclear=held.is_unclear)._begin_choice(held.kept_offers)
        if isinstance(self.stage, Choosing) and not self.context.mission.is_point_mass:
            return self._commit_in_orbit(self.stage)
        if isinstance(self.stage, Choosing):
            return self._report_choice(self.stage)
        return self._begin_evasion(self.stage) if self.is_evading else self._commit(self.stage)

    def _after_exchange(self, planner: Planner) -> "Decision":
        planners, lost = {self.number: planner}, self.unreachable
        count = len(self.context.mission.initial_states)
        hears_all = self.diameter <= 1 and len(self.members) == count
        plans, events = planning.make_plans(self.context, planners, lost, self.plans, hears_all)
        decision = self._replace(plans=plans, events=(*self.events, *events))
        if not self.context.mission.is_point_mass:
            own = self.context, plans, self.committed, self.heard_clock
            offers, detours = make_orbital_offers(*own)
            holding = Holding(offers, detours.get(0))
            return decision._replace(previous=self.plans.get(self.number))._enter(holding)
        return decision._begin_choice(make_offers(self.context, plans, self.committed))

    def _begin_choice(self, offers: Offers) -> "Decision":
        priority, choice = self.plans[self.number].priority, int(offers.is_allowed[0].argmax())
        is_confirmed = self.context.mission.lag_steps > 0
        return self._enter(Choosing(offers, priority, self.diameter, choice, is_confirmed))

    def _check_start(self, choosing: Choosing) -> None:
        """Refuse a start that is nearer to a neighbor than two keep, by more than the margin."""
        mission, i, place = self.context.mission, self.number, choosing.message.path[0, 0]
        for other in choosing.neighbors:
            apart = float(np.linalg.norm(place - other.path[0, 0]))
            kept = (mission.radius(i) + mission.radius(other.agent)) / 2
            if apart < kept * (1 - 1e-9) - mission.margin:
                found = f"agent {i} starts {apart:.8g} m from agent {other.agent}"
                reason = f"{found}, closer than the collision radius of {kept:.8g} m"
                raise InputError("state", f"{reason}; agents farther apart would do")

    def _report_choice(self, choosing: Choosing) -> "Decision":
        if self.context.instant == 0:
            self._check_start(choosing)
        is_cautious = choosing.choice == choosing.offers.last and not is_kept(
            self.context, self.plans[self.number]
        )
        priority = choosing.priority if is_cautious else None
        offers, steps = choosing.offers, int(choosing.offers.steps[0])
        is_met = evasion.is_met(self.context, offers, 0, choosing.choice)
        report = ChoiceReport(self.number, priority, steps, is_met)
        flood = Flood(len(self.members), self.diameter, frozenset([report]))
        return self._enter(flood, choosing=choosing)

    def _begin_turns(self, reports: Reports) -> "Decision":
        assert self.choosing is not None
        offers, choice = self.choosing.offers, self.choosing.choice
        cautious = sorted((r.priority, r.agent) for r in reports if r.priority is not None)
        steps = max(report.steps for report in reports)
        horizon = stopping.stopping_horizon(self.context.mission, steps)
        (u,) = stopping.pad_controls([offers.u[0, choice]], steps)
        path = extend(offers.paths[0, choice], len(horizon.fine_model))
        order, own = tuple(agent for _, agent in cautious), (self.number, self.plans[self.number])
        rest = float(offers.clearance[0]), offers.plan_steps[choice], self.choosing.kept_below
        turns = Turns(self.context, own[1], own[0], order, horizon, u, path, *rest)
        return self._enter(turns, is_evading=any(report.is_met for report in reports))

    def _commit_in_orbit(self, choosing: Choosing) -> "Decision":
        choice, plan, i = choosing.choice, self.plans[self.number], self.number
        if self.context.instant == 0 and (met := choosing.find_met()) is not None:
            radius = (choosing.message.clearance + met.clearance) / 2
            refuse_start(min(i, met.agent), max(i, met.agent), radius)
        committed = {i: stopping.Commitment(self.context.instant, choosing.offers.u[0, choice])}
        is_kept = choice == choosing.offers.last
        if choice == 0 or (is_kept and self.is_unclear):
            return self._replace(committed=committed, is_finished=True)
        is_left, flown = True, commitment.leave(self.context, plan)
        if is_kept:
            is_left, flown = commitment.leaves_plan(plan), keep_previous(plan, self.previous)
        cautious = {"kind": "cautious", "agents": [i]}
        events = (*self.events, cautious) if is_left else self.events
        return self._replace(committed=committed, plans={i: flown}, events=events, is_finished=True)

    def _begin_evasion(self, turns: Turns) -> "Decision":
        own = turns.agent, turns.plan.priority, turns.horizon, turns.u, turns.path, turns.clearance
        reports = frozenset([evasion.make_report(self.context, *own)])
        return self._enter(Flood(len(self.members), self.diameter, reports), turns=turns)

    def _after_evasion(self, turns: Turns, reports: Reports) -> "Decision":
        mission, horizon = self.context.mission, turns.horizon
        changed = evasion.find_evasions(mission, horizon, list(reports)).get(self.number)
        if changed is None:
            return self._commit(turns)
        return self._commit(turns._replace(path=changed.path), changed.u)

    def _commit(self, turns: Turns, evading: Float[Array, "T m"] | None = None) -> "Decision":
        u, is_cautious = turns.u, self.number in turns.order and turns.plan_steps == 0
        plan, events = commitment.follow(self.context, turns.plan, turns.plan_steps, u), self.events
        if evading is not None:
            u, plan, is_cautious = evading, commitment.leave(self.context, turns.plan), True
        committed = {self.number: stopping.Commitment(self.context.instant, u)}
        if is_cautious and commitment.leaves_plan(turns.plan, plan):
            events = (*events, {"kind": "cautious", "agents": [self.number]})
        return self._replace(
            plans={self.number: plan},
            committed=committed,
            events=events,
            waits=self._find_waits(turns),
            is_finished=True,
        )

    def _find_waits(self, turns: Turns) -> frozenset[int]:
        """Find the neighbors that could meet the agent if they did not commit to what is new."""
        assert self.choosing is not None
        if not self.choosing.is_confirmed:
            return frozenset()
        own = self.choosing
        return frozenset(
            other.agent
            for other in own.neighbors
            if not own.keeps_clear_of_held(other.kept, turns.path)
        )

    def _enter(self, stage: Any, **changes: Any) -> "Decision":
        return self._replace(stage=stage, stage_index=self.stage_index + 1, **changes)

    def _after_census(self, census: Census) -> "Decision":
        mission, k = self.context.mission, self.context.step_index
        reports = sorted(census.message.reports)
        if mission.lag_steps and has_later_leg(reports):
            return self._replace(is_finished=True)
        check_census(reports)
        has_joined, is_new = any(hello.joins for hello in reports), False
        if k % mission.replan_steps == 0:
            is_new = bids_on_change(mission) and has_changed_network(reports)
        elif not has_joined:
            return self._replace(is_finished=True)
        if not (has_joined or is_new or any(hello.is_due for hello in reports)):
            return self._replace(is_finished=True)
        members = tuple(hello.agent for hello in reports)
        diameter = census.message.max_eccentricity
        heard_clock = min(hello.clock for hello in reports)
        decision = self._replace(members=members, diameter=diameter, heard_clock=heard_clock)
        if not (has_joined or is_new or any(hello.is_auction_due for hello in reports)):
            if bids_on_change(mission):  # all claim again what they hold, as in `claim_targets`
                target = self.context.memory.claimed_target[self.number, list(members)]
                decision = decision._claim(dict(zip(members, target.tolist(), strict=True)))
            return decision._begin_exchange()
        if mission.assignment == "given":
            return decision._take_given(reports)._begin_exchange()
        known, i = find_all_blocked(self.context), self.number
        blocked = () if known is None else tuple(np.flatnonzero(known[i]).tolist())
        return decision._replace(blocked=blocked)._share_clock()._announce_terms("first")

    def _take_given(self, reports: list[Hello]) -> "Decision":
        """Hold the target that is given, and reset the clock where it is out of reach."""
        cost = remaining_cost(self.plans, self.context)
        steps = self.context.leg.steps
        due, clock = (
            np.array(part) for part in zip(*((r.is_due, r.clock) for r in reports), strict=True)
        )
        heard = np.full_like(self.context.memory.clock, announce_clock(due, clock, steps).min())
        taken = assignment.assign_targets(self.context, cost, heard)
        decision = self._replace(context=self.context._replace(memory=taken.memory))
        return decision._note_reset() if taken.was_reset[self.number] else decision

    def _note_reset(self) -> "Decision":
        return self._replace(events=({"kind": "reset", "agents": [self.number]},))

    def _share_clock(self) -> "Decision":
        """Take over the clock with the most time left, as `share_claims`."""
        shared = self._replace(planned_cost=remaining_cost(self.plans, self.context))
        clock = self.heard_clock
        is_own = clock == self.context.memory.clock[self.number]
        return shared if is_own else shared._set_clock(clock)

    def _share_claims(self, reports: Reports) -> "Decision":
        """Take over the newest claims, as `share_claims`, and blocked targets."""
        memory = self.context.memory
        claims = sorted(claim for terms in reports for claim in terms.claims)
        newest = {a: (step, j) for a, step, j in claims}
        rows, others = len(memory.clock), max([*self.members, *newest]) + 1
        target, step = np.full((2, rows, others), -1)
        for a, claim in newest.items():
            step[self.number, a], target[self.number, a] = claim
        memory = replace(memory, claimed_target=target, claim_step=step)
        blocked = tuple(sorted({j for terms in reports for j in terms.blocked}))
        return self._replace(
            context=self.context._replace(memory=memory), blocked=blocked, has_claims=True
        )

    def _set_clock(self, clock: int) -> "Decision":
        clocks = np.full_like(self.context.memory.clock, clock)
        memory = replace(self.context.memory, clock=clocks)
        return self._replace(
            context=self.context._replace(memory=memory), planned_cost=np.full(len(clocks), np.inf)
        )._note_reset()

    def _announce_terms(self, attempt: Literal["first", "reset", "firm"]) -> "Decision":
        assert self.planned_cost is not None
        table = target_costs.compute_costs(self.context)
        table = target_costs.trust_plans(self.context, table, self.planned_cost)
        return self._replace(attempt=attempt, table=table, is_unpriced=False)._repeat_terms()

    def _repeat_terms(self) -> "Decision":
        assert self.table is not None
        m, i = int(self.context.memory.target_count[self.number]), self.number
        state = tuple(self.context.state[i].tolist())
        terms = AuctionTerms(i, m, target_costs.cost_range(self.table, i)[1], state)
        if not self.has_claims:
            memory = self.context.memory
            step, target = (c[i].tolist() for c in (memory.claim_step, memory.claimed_target))
            claims = tuple((a, step[a], target[a]) for a in range(len(step)) if step[a] >= 0)
            terms = terms._replace(claims=claims, blocked=self.blocked)
        return self._enter(Flood(len(self.members), self.diameter, frozenset([terms])))

    def _begin_auction(self, flood: Flood) -> "Decision":
        if not self.has_claims:
            return self._share_claims(flood.message)._begin_auction(flood)
        mission, table, memory = self.context.mission, self.table, self.context.memory
        assert table is not None
        epsilon = compute_epsilon(mission, self.context.leg)
        least = least_penalty(epsilon)
        firm, ranges = None, [terms.cost_range for terms in flood.message]
        if self.attempt == "firm":
            firm = firm_penalty(ranges, least)
        is_near = np.isin(np.arange(memory.claim_step.shape[1]), self.members)
        cost = apply_bidding_rules(table, memory, self.number, is_near, firm, least=least)
        count = np.array(max(terms.target_count for terms in flood.message))
        order = np.arange(len(cost))
        if self.blocked:
            order, count = order_targets(count, np.isin(order, self.blocked))
        if counts_members(mission):
            count = count_targets(count, np.array(len(self.members)), len(cost))
        cost, m = cost[order], int(count)
        VsdaaAuction(cost[None], None, count[None], epsilon)  # checks its data
        opening = Opening.empty(1, len(cost))
        if is_forecast(mission, self.context.leg) and not self.is_unpriced:
            states = {terms.agent: terms.state for terms in sorted(flood.message)}
            told = self.context, self.number, states
            opening = forecast_alone(*told, firm is not None, order, m)
        (price,), (first,) = opening
        bids = WinningBids.empty(len(cost))._replace(price=price)
        rules = epsilon, mission.bidder_ids, 2 * self.diameter, m
        bidder = VsdaaBidder(self.number, cost, *rules, bids, first_target=int(first))
        reports = Flood(len(self.members), self.diameter)
        return self._enter(Bidding(self.context, table, bidder, order, reports))

    def _after_auction(self, bidding: Bidding) -> "Decision":
        reports, won = bidding.flood.message, bidding.target_index
        if bidding.bidder.first_target >= 0 and has_dear_leftovers(bidding.bidder.bids.price):
            return self._replace(is_unpriced=True)._repeat_terms()
        if not all(report.is_exact for report in reports):
            table = target_costs.CostTable(*(part.copy() for part in bidding.table))
            if not table.is_exact[self.number, won]:
                target_costs.refine_cost(self.context, table, self.number, won)
            return self._replace(table=table)._repeat_terms()
        if self.attempt == "first" and any(report.needs_reset for report in reports):
            return self._set_clock(0)._announce_terms("reset")
        if self.attempt != "firm" and any(report.won_unreachable for report in reports):
            return self._announce_terms("firm")
        return self._remember(bidding, reports)._begin_exchange()

    def _remember(self, bidding: Bidding, reports: Reports) -> "Decision":
        memory, bidder = self.context.memory, bidding.bidder
        memory = replace(
            memory,
            target_index=np.full_like(memory.clock, bidding.target_index),
            target_count=np.maximum(memory.target_count, bidder.target_count),
            bidder_count=np.full_like(memory.clock, bidder.bids.winner_count),
        )
        decision = self._replace(context=self.context._replace(memory=memory))
        return decision._claim({report.agent: report.target_index for report in reports})

    def _claim(self, held: dict[int, int]) -> "Decision":
        """Note the targets that all agents of the component hold now."""
        memory = self.context.memory
        target, step = memory.claimed_target.copy(), memory.claim_step.copy()
        target[self.number, list(held)] = list(held.values())
        step[self.number, list(held)] = self.context.step_index
        memory = replace(memory, claimed_target=target, claim_step=step)
        return self._replace(context=self.context._replace(memory=memory))

    def _begin_exchange(self) -> "Decision":
        heard = np.full_like(self.context.memory.clock, self.heard_clock)
        planners, unreachable, _ = planning.plan_alone(self.context, self.spent, self.plans, heard)
        planner, decision = planners[self.number], self._replace(unreachable=tuple(unreachable))
        if self.context.mission.keeps_plans:
            return decision._enter(Bending(planner, self.diameter))
        return decision._exchange(planner)

    def _exchange(self, planner: Planner) -> "Decision":
        return self._enter(Exchange(planner, Flood(len(self.members), self.diameter)))
