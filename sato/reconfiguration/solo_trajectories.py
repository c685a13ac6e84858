"""How every agent would fly if it were alone."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel, linearize_along
from problems.auction_cost import solve_transfer
from problems.avoidance import AvoidanceProblem, empty_half_spaces
from problems.conic import Unsolved
from problems.minimum_fuel import solve_minimum_fuel
from problems.transfer import Trajectory, TransferProblem
from sato.reconfiguration.moment import DecisionContext

TIE_BREAK_RISE = 1e-3  # of the fuel's weights: burns at the ends, straight paths between


class SoloSolution(NamedTuple):
    """How an agent would fly if it were alone."""

    transfer: TransferProblem  # with its own dynamics
    trajectory: Trajectory
    is_unreachable: bool  # its goal, and no plan of before leads there either


def solve_solo_trajectories(
    moment: DecisionContext,
    steps: DiscreteModel,
    state: Float[Array, "those n"],
    goals: Float[Array, "those n"],
    rests: list[Array | None],
) -> tuple[list[SoloSolution], int]:
    """The route of every agent, and the programmes that took.

    By the shared linearisation first; where the dynamics depend on the state, about that
    once more, which leaves nothing of the first error that could be seen.
    """
    mission = moment.mission
    limits = mission.max_control, mission.max_speed
    shared = TransferProblem(
        steps, *limits, mission.fuel_norm, mission.control_norm, TIE_BREAK_RISE
    )
    found, solves = solve_solo_transfers(shared, state, goals)
    transfers = [shared] * len(state)
    if mission.nonlinear_model is not None and len(steps):
        asked = zip(found, state, goals, rests, strict=True)
        nominal = [f or _fallback_trajectory(shared, x, goal, rest) for f, x, goal, rest in asked]
        x, u = (np.stack(part) for part in zip(*(f[:2] for f in nominal), strict=True))
        own = linearize_along(mission.nonlinear_model, x, u, mission.step, moment.time)
        transfers = [replace(shared, model=own.for_agent(a)) for a in range(len(state))]
        again = [
            solve_solo_transfers(*q)
            for q in zip(transfers, state[:, None], goals[:, None], strict=True)
        ]
        found, solves = [f for (f,), _ in again], solves + sum(count for _, count in again)
    routes = []
    for transfer, flight, x, goal, rest in zip(transfers, found, state, goals, rests, strict=True):
        flown = flight or _fallback_trajectory(transfer, x, goal, rest)
        misses = flight is None and rest is None
        routes.append(SoloSolution(transfer, flown, misses))
    return routes, solves + sum(route.is_unreachable for route in routes)


def _fallback_trajectory(
    transfer: TransferProblem, start: Array, goal: Array, rest: Float[Array, "T m"] | None
) -> Trajectory:
    """Where the goal is out of reach: the plan of before, or as near as can be."""
    return (
        minimize_terminal_error(transfer, start, goal)
        if rest is None
        else transfer.simulate(start, rest)
    )


def make_relinearizer(
    moment: DecisionContext, transfer: TransferProblem
) -> Callable[[Trajectory], TransferProblem] | None:
    """What an agent does to linearise its dynamics about a flight; None where it need not."""
    model, step, time = moment.mission.nonlinear_model, moment.mission.step, moment.time
    if model is None:
        return None

    def about(flight: Trajectory) -> TransferProblem:
        return replace(transfer, model=linearize_along(model, flight.x, flight.u, step, time))

    return about


def solve_solo_transfers(
    transfer: TransferProblem, start: Float[Array, "agents n"], goals: Float[Array, "agents n"]
) -> tuple[list[Trajectory | None], int]:
    """The flight of every agent as if it were alone, and the programmes that took.

    None where the goal is out of reach.
    """
    steps = transfer.model
    if len(steps) == 0:
        return [transfer.simulate(x, np.zeros((0, steps.axes))) for x in start], 0
    if (transfer.fuel_norm, transfer.control_norm) != (1, "inf"):
        return [solve_transfer(transfer, x, g) for x, g in zip(start, goals, strict=True)], len(
            start
        )
    b = goals - steps.simulate(start, np.zeros((len(start), len(steps), steps.axes)))[:, -1]
    u = solve_minimum_fuel(steps, b, transfer.max_control, transfer.weights).u
    x = steps.simulate(start, u)
    fuel = steps.dt * np.abs(u).sum(axis=(1, 2))
    speed = np.linalg.norm(x[:, 1:-1, steps.axes :], axis=2).max(axis=1, initial=0.0)
    flights: list[Trajectory | None] = []
    for i in range(len(start)):
        reached = not np.isnan(fuel[i])
        flights.append(Trajectory(x[i], u[i], float(fuel[i])) if reached else None)
    fast = np.flatnonzero(speed > transfer.max_speed * (1 + 1e-9))
    for i in fast.tolist():
        flights[i] = solve_transfer(transfer, start[i], goals[i])
    return flights, len(fast)


def minimize_terminal_error(
    transfer: TransferProblem, start: Float[Array, " n"], goal: Float[Array, " n"]
) -> Trajectory:
    """The flight that ends as near the goal as can be; coasting if nothing better is found."""
    try:
        return (
            AvoidanceProblem(transfer)
            .solve(start, goal, empty_half_spaces(transfer), "terminal")
            .trajectory
        )
    except Unsolved:
        return transfer.simulate(start, np.zeros(transfer.model.B.shape[::2]))
