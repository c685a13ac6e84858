"""How to get there: a flight for every agent, first alone, then among its neighbours."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from math import ceil, isfinite
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretise import Steps, follow, hold
from dynamics.path import missed
from problems.auction_cost import price_within_speed
from problems.avoidance import Avoidance, no_spaces
from problems.conic import Unsolved
from problems.convexify import Horizon
from problems.least_fuel import least_fuel
from problems.transfer import Flight, Transfer, fuel_spent
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.moment import Moment
from sato.reconfiguration.pricing import Minds
from sato.scp import STILL, Planner, settle

SLOPE = 1e-3  # of the fuel's weights: burns at the ends, straight paths between
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
    left = moment.leg.steps - int(minds.clock[network.alive].min(initial=moment.leg.steps))
    horizon = look_ahead(mission, moment.time, left)
    planners: dict[int, Planner] = {}
    late: list[int] = []
    for clock in np.unique(minds.clock[network.alive]):
        those = np.flatnonzero(network.alive & (minds.clock == clock)).tolist()
        steps = moment.steps_left(int(clock))
        goals = moment.leg.targets[minds.target[those]]
        rests = {i: before.rest(i, int(minds.target[i]), moment.step, len(steps)) for i in those}
        routes, counted = _undisturbed(moment, steps, state[those], goals, list(rests.values()))
        solves += counted
        paths = horizon.path(
            *(np.stack(part) for part in zip(*(r.flight[:2] for r in routes), strict=True))
        )
        for i, goal, route, path in zip(those, goals, routes, paths, strict=True):
            rank = (len(steps) > 0, -float(spent[i]), i)
            free, about = route.flight, _linearisation(moment, route.transfer)
            planner = Planner(rank, goal, route.transfer, horizon, free, free, path, about)
            planners[i] = _as_before(planner, rests[i])
            late += [i] if route.misses else []
    planners, exchanges = settle(planners, network)
    solves += sum(p.solves for p in planners.values())
    events: list[Event] = [
        {"kind": "replan", "agents": [], "solves": solves, "exchanges": exchanges}
    ]
    events += _what_gave_way(mission, planners, late)
    chosen = {i: p.flight for i, p in planners.items()}
    astray = {i for event in events for i in event["agents"]}
    ends = {i: int(minds.target[i]) for i in planners if i not in astray}
    return before.but(Plans(chosen, ends, dict.fromkeys(planners, moment.step))), events


class _Route(NamedTuple):
    """How an agent would fly if it were alone."""

    transfer: Transfer  # with its own dynamics
    flight: Flight
    misses: bool  # its goal, and no plan of before leads there either


def _undisturbed(
    moment: Moment,
    steps: Steps,
    state: Float[Array, "those n"],
    goals: Float[Array, "those n"],
    rests: list[Array | None],
) -> tuple[list[_Route], int]:
    """The route of every agent, and the programmes that took.

    By the shared linearisation first; where the dynamics depend on the state, about that
    once more, which leaves nothing of the first error that could be seen.
    """
    mission = moment.mission
    limits = mission.max_control, mission.max_speed
    shared = Transfer(steps, *limits, mission.fuel_norm, mission.control_norm, SLOPE)
    found, solves = alone(shared, state, goals)
    transfers = [shared] * len(state)
    if mission.nonlinear is not None and len(steps):
        asked = zip(found, state, goals, rests, strict=True)
        nominal = [f or _stand_in(shared, x, goal, rest) for f, x, goal, rest in asked]
        x, u = (np.stack(part) for part in zip(*(f[:2] for f in nominal), strict=True))
        own = follow(mission.nonlinear, x, u, mission.step, moment.time)
        transfers = [replace(shared, steps=own.of(a)) for a in range(len(state))]
        again = [alone(*q) for q in zip(transfers, state[:, None], goals[:, None], strict=True)]
        found, solves = [f for (f,), _ in again], solves + sum(count for _, count in again)
    routes = []
    for transfer, flight, x, goal, rest in zip(transfers, found, state, goals, rests, strict=True):
        flown = flight or _stand_in(transfer, x, goal, rest)
        misses = flight is None and rest is None
        routes.append(_Route(transfer, flown, misses))
    return routes, solves + sum(route.misses for route in routes)


def _as_before(agent: Planner, rest: Float[Array, "T m"] | None) -> Planner:
    """Begin with the plan of before, where that kept clear of somebody by going another way."""
    if rest is None:
        return agent
    prior = agent.transfer.flight(agent.free.x[0], rest)
    if float(np.abs(prior.x - agent.free.x).max()) <= STILL * agent.horizon.radius:
        return agent
    path = agent.horizon.path(prior.x, prior.u)
    return agent._replace(flight=prior, path=path, steady=False)


def _stand_in(
    transfer: Transfer, start: Array, goal: Array, rest: Float[Array, "T m"] | None
) -> Flight:
    """Where the goal is out of reach: the plan of before, or as near as can be."""
    return nearest(transfer, start, goal) if rest is None else transfer.flight(start, rest)


def _linearisation(moment: Moment, transfer: Transfer) -> Callable[[Flight], Transfer] | None:
    """What an agent does to linearise its dynamics about a flight; None where it need not."""
    model, step, time = moment.mission.nonlinear, moment.mission.step, moment.time
    if model is None:
        return None

    def about(flight: Flight) -> Transfer:
        return replace(transfer, steps=follow(model, flight.x, flight.u, step, time))

    return about


def look_ahead(mission: Reconfiguration, time: float, left: int) -> Horizon:
    """The avoidance horizon from a time on, when the last agent has some steps left.

    T_H steps, or as far as is foreseen among agents in earshot, but not past the last
    arrival. A step is cut so finely that two agents at full speed move by about R_col in a piece.
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


def alone(
    transfer: Transfer, start: Float[Array, "agents n"], goals: Float[Array, "agents n"]
) -> tuple[list[Flight | None], int]:
    """The flight of every agent as if it were alone, and the programmes that took.

    None where the goal is out of reach.
    """
    steps = transfer.steps
    if len(steps) == 0:
        return [transfer.flight(x, np.zeros((0, steps.axes))) for x in start], 0
    if (transfer.fuel_norm, transfer.control_norm) != (1, "inf"):
        return [price_within_speed(transfer, x, g) for x, g in zip(start, goals, strict=True)], len(
            start
        )
    b = goals - steps.roll(start, np.zeros((len(start), len(steps), steps.axes)))[:, -1]
    u = least_fuel(steps, b, transfer.max_control, transfer.weight).u
    x = steps.roll(start, u)
    fuel = steps.dt * np.abs(u).sum(axis=(1, 2))
    speed = np.linalg.norm(x[:, 1:-1, steps.axes :], axis=2).max(axis=1, initial=0.0)
    flights: list[Flight | None] = []
    for i in range(len(start)):
        reached = not np.isnan(fuel[i])
        flights.append(Flight(x[i], u[i], float(fuel[i])) if reached else None)
    fast = np.flatnonzero(speed > transfer.max_speed * (1 + 1e-9))
    for i in fast.tolist():
        flights[i] = price_within_speed(transfer, start[i], goals[i])
    return flights, len(fast)


def nearest(transfer: Transfer, start: Float[Array, " n"], goal: Float[Array, " n"]) -> Flight:
    """The flight that ends as near the goal as can be; coasting if nothing better is found."""
    try:
        return Avoidance(transfer).solve(start, goal, no_spaces(transfer), "arrival").flight
    except Unsolved:
        return transfer.flight(start, np.zeros(transfer.steps.B.shape[::2]))


def _what_gave_way(
    mission: Reconfiguration, planners: dict[int, Planner], late: list[int]
) -> list[Event]:
    tight = 1e-6 * mission.collision_radius
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
