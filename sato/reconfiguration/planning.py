"""How to get there: a flight for every agent among its neighbours."""

from functools import lru_cache
from math import ceil, isfinite
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretise import hold
from dynamics.path import missed
from problems.convexify import Horizon
from problems.transfer import Flight, fuel_spent
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.moment import Moment
from sato.reconfiguration.pricing import Minds
from sato.reconfiguration.routes import linearisation, undisturbed
from sato.scp import STILL, TIGHT, Planner, come_to_terms

MOST_PIECES = 12  # in a step

Event = dict[str, Any]


class Plans(NamedTuple):
    """What each agent is about to fly, and since when."""

    flights: dict[int, Flight]
    ends: dict[int, int]  # the target that a flight ends at; absent where it ends elsewhere
    made: dict[int, int]  # steps since the start of the leg

    def control(self, k: int, alive: Bool[Array, " agents"], axes: int) -> Float[Array, "agents m"]:
        """Controls at a step of the leg; none once a flight is over, NaN for the dead."""
        control = np.full((len(alive), axes), np.nan)
        for i in np.flatnonzero(alive).tolist():
            u = self.flights[i].u[k - self.made[i] :]
            control[i] = u[0] if len(u) else 0.0
        return control

    def rest(self, i: int, target: int, k: int, T: int) -> Float[Array, "T m"] | None:
        """What is left of an agent's controls, if they still lead to its target in T steps."""
        if self.ends.get(i) != target:
            return None
        u = self.flights[i].u[k - self.made[i] :]
        return u if len(u) == T else None

    def lead_there(
        self, minds: Minds, k: int, left: Int[Array, " agents"]
    ) -> Bool[Array, " agents"]:
        """Who has a plan that leads to its target in the steps that it has left."""
        there = [
            self.rest(i, int(target), k, int(left[i])) is not None
            for i, target in enumerate(minds.target)
        ]
        return np.array(there, dtype=bool)

    def fuel_left(self, moment: Moment, minds: Minds) -> Float[Array, " agents"]:
        """Fuel in what is left of each agent's plan; infinite where none serves it [m/s]."""
        mission, fuel = moment.mission, np.full(len(minds.target), np.inf)
        for i in self.ends:
            left = moment.leg.steps - int(minds.clock[i])
            u = self.rest(i, int(minds.target[i]), moment.step, left)
            if u is not None:
                fuel[i] = fuel_spent(u, mission.step, mission.fuel_norm)
        return fuel

    def but(self, newer: "Plans") -> "Plans":
        """These plans, with those of some agents replaced by newer ones."""
        ends = {i: target for i, target in self.ends.items() if i not in newer.flights}
        return Plans(
            {**self.flights, **newer.flights}, {**ends, **newer.ends}, {**self.made, **newer.made}
        )


NO_PLANS = Plans({}, {}, {})


def plan(
    moment: Moment,
    minds: Minds,
    spent: Float[Array, " agents"],
    before: Plans,
    solves: int = 0,
) -> tuple[Plans, list[Event]]:
    """Plan for every agent that decides.

    Args:
        moment: What there is to decide with.
        minds: What the agents remember: their targets and clocks.
        spent: Fuel that each has burnt [m/s]; who has more left gives way.
        before: The plans flown so far.
        solves: Programmes that were solved for this replan already.
    """
    mission, network, state = moment.mission, moment.network, moment.state
    horizon = look_ahead(mission, moment.time, moment.leg.steps - moment.step)
    planners: dict[int, Planner] = {}
    late: list[int] = []
    # Who goes first may have given way by little in a bargain, and others count on it.
    same = (TIGHT if mission.bargains else STILL) * horizon.radius
    for clock in np.unique(minds.clock[network.alive]):
        those = np.flatnonzero(network.alive & (minds.clock == clock)).tolist()
        steps = moment.steps_left(int(clock))
        goals = moment.leg.targets[minds.target[those]]
        rests = {i: before.rest(i, int(minds.target[i]), moment.step, len(steps)) for i in those}
        routes, counted = undisturbed(moment, steps, state[those], goals, list(rests.values()))
        solves += counted
        paths = horizon.path(
            *(np.stack(part) for part in zip(*(r.flight[:2] for r in routes), strict=True))
        )
        for i, goal, route, path in zip(those, goals, routes, paths, strict=True):
            rank = (len(steps) > 0, -float(spent[i]), i)
            free, about = route.flight, linearisation(moment, route.transfer)
            planner = Planner(rank, goal, route.transfer, horizon, free, free, path, about)
            planners[i] = _as_before(planner, rests[i], same)
            late += [i] if route.misses else []
    settled = come_to_terms(planners, network, mission.orders, mission.bargains)
    planners, solves = settled.planners, solves + settled.solves
    events: list[Event] = [
        {"kind": "replan", "agents": [], "solves": solves, "exchanges": settled.exchanges}
    ]
    events += _what_gave_way(mission, planners, late)
    chosen = {i: p.flight for i, p in planners.items()}
    # Who comes too close to somebody may still arrive.
    astray = {i for event in events if event["kind"] != "slack" for i in event["agents"]}
    ends = {i: int(minds.target[i]) for i in planners if i not in astray}
    return before.but(Plans(chosen, ends, dict.fromkeys(planners, moment.step))), events


def _as_before(agent: Planner, rest: Float[Array, "T m"] | None, same: float) -> Planner:
    """Begin with the plan of before, where that kept clear of somebody by going another way."""
    if rest is None:
        return agent
    prior = agent.transfer.flight(agent.free.x[0], rest)
    if float(np.abs(prior.x - agent.free.x).max()) <= same:
        return agent
    path = agent.horizon.path(prior.x, prior.u)
    return agent._replace(flight=prior, path=path, steady=False)


def look_ahead(mission: Reconfiguration, time: float, left: int) -> Horizon:
    """The avoidance horizon from a time on, when so many steps of the leg are left as asked for.

    T_H steps, or as far as is foreseen among agents in earshot, but not past the end of a
    leg that takes the time asked for, which all agents know. A step is cut so finely that
    two agents at full speed move by about R_col in a piece.
    """
    fast = mission.max_speed if isfinite(mission.max_speed) else 0.0
    S = min(MOST_PIECES, max(1, ceil(2 * fast * mission.step / mission.collision_radius)))
    T = max(mission.horizon_steps, min(mission.foresight_steps, left))
    return Horizon(
        hold(mission.model, mission.step, T, time),
        hold(mission.model, mission.step / S, T * S, time),
        mission.collision_radius + mission.margin + _margin(mission, mission.step / S),
    )


@lru_cache(maxsize=8)  # the same at every replan of a mission
def _margin(mission: Reconfiguration, h: float) -> float:
    # What the pieces of two agents could miss, at the states that the mission begins and
    # ends with and under full control, twice over for what lies between.
    ends = np.concatenate([mission.start, *(leg.targets for leg in mission.legs)])
    x = np.stack([ends, ends], axis=1)
    u = np.full((len(ends), 1, mission.model.axes), mission.max_control)
    return 4 * missed(mission.model, x, u, h)


def _what_gave_way(
    mission: Reconfiguration, planners: dict[int, Planner], late: list[int]
) -> list[Event]:
    tight = TIGHT * mission.collision_radius
    slack = {i: p.slack for i, p in planners.items() if p.slack > tight}
    failed = [i for i, p in planners.items() if p.failed]
    braked = [i for i, p in planners.items() if i in late or p.failed or _stops_short(mission, p)]
    events: list[Event] = []
    if slack:
        events.append({"kind": "slack", "agents": list(slack), "amount_m": list(slack.values())})
    if braked:
        events.append({"kind": "braked", "agents": braked})
    if late:
        what = "the target is out of reach in the time that is left"
        events.append({"kind": "infeasible", "agents": late, "what": what})
    if failed:
        what = "no flight keeps clear of those that go before"
        events.append({"kind": "infeasible", "agents": failed, "what": what})
    return events


def _stops_short(mission: Reconfiguration, planner: Planner) -> bool:
    d = mission.model.axes
    miss = np.abs(planner.flight.x[-1] - planner.goal)
    off = (miss[:d] > mission.position_tolerance).any()
    return planner.late > 0 and bool(off or (miss[d:] > mission.velocity_tolerance).any())
