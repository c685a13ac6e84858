"""How every agent would fly if it were alone."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretise import Steps, follow
from problems.auction_cost import price_within_speed
from problems.avoidance import Avoidance, no_spaces
from problems.conic import Unsolved
from problems.least_fuel import least_fuel
from problems.transfer import Flight, Transfer
from sato.reconfiguration.moment import Moment

SLOPE = 1e-3  # of the fuel's weights: burns at the ends, straight paths between


class Route(NamedTuple):
    """How an agent would fly if it were alone."""

    transfer: Transfer  # with its own dynamics
    flight: Flight
    misses: bool  # its goal, and no plan of before leads there either


def undisturbed(
    moment: Moment,
    steps: Steps,
    state: Float[Array, "those n"],
    goals: Float[Array, "those n"],
    rests: list[Array | None],
) -> tuple[list[Route], int]:
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
        routes.append(Route(transfer, flown, misses))
    return routes, solves + sum(route.misses for route in routes)


def _stand_in(
    transfer: Transfer, start: Array, goal: Array, rest: Float[Array, "T m"] | None
) -> Flight:
    """Where the goal is out of reach: the plan of before, or as near as can be."""
    return nearest(transfer, start, goal) if rest is None else transfer.flight(start, rest)


def linearisation(moment: Moment, transfer: Transfer) -> Callable[[Flight], Transfer] | None:
    """What an agent does to linearise its dynamics about a flight; None where it need not."""
    model, step, time = moment.mission.nonlinear, moment.mission.step, moment.time
    if model is None:
        return None

    def about(flight: Flight) -> Transfer:
        return replace(transfer, steps=follow(model, flight.x, flight.u, step, time))

    return about


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
