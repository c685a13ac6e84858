"""Trajectories of the agents without regard to each other: iterate 0 of conflict resolution."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel, linearize_along
from problems.auction_cost import solve_transfer
from problems.minimum_fuel import solve_minimum_fuel
from problems.transfer import Trajectory, TransferProblem
from sato.reconfiguration.state import DecisionContext
from sato.scp.planner import minimize_terminal_error

TIE_BREAK_RISE = 1e-3  # of the fuel's weights: burns at the ends, straight trajectories between


class SoloSolution(NamedTuple):
    """Trajectory of one agent without the others."""

    transfer: TransferProblem  # with the agent's own dynamics
    trajectory: Trajectory
    is_unreachable: bool  # the target is, and no previous plan leads there either


def solve_solo_trajectories(
    context: DecisionContext,
    model: DiscreteModel,
    state: Float[Array, "k n"],
    targets: Float[Array, "k n"],
    previous: list[Array | None],
) -> tuple[list[SoloSolution], int]:
    """Solve the transfers of some agents, and count the programs that took.

    The shared linear model comes first; where the dynamics are nonlinear, the trajectories are
    linearized about that solution once more, after which the remaining error is negligible.

    Args:
        context: Mission and time.
        model: Shared model over the steps that remain.
        state: Initial state of each agent.
        targets: Target state of each agent.
        previous: Remaining controls of each agent's previous plan, if they still reach its target.
    """
    mission = context.mission
    limits = mission.max_control, mission.max_speed
    shared = TransferProblem(
        model, *limits, mission.fuel_norm, mission.control_norm, TIE_BREAK_RISE
    )
    found, solves = solve_solo_transfers(shared, state, targets)
    problems = [shared] * len(state)
    if mission.nonlinear_model is not None and len(model):
        each = zip(found, state, targets, previous, strict=True)
        nominal = [f or _fallback(shared, x, target, rest) for f, x, target, rest in each]
        x, u = (np.stack(part) for part in zip(*(f[:2] for f in nominal), strict=True))
        own = linearize_along(mission.nonlinear_model, x, u, mission.step, context.time)
        problems = [replace(shared, model=own.for_agent(i)) for i in range(len(state))]
        arguments = zip(problems, state[:, None], targets[:, None], strict=True)
        again = [solve_solo_transfers(*each) for each in arguments]
        found, solves = [f for (f,), _ in again], solves + sum(count for _, count in again)
    solutions = []
    for problem, solution, x, target, rest in zip(
        problems, found, state, targets, previous, strict=True
    ):
        trajectory = solution or _fallback(problem, x, target, rest)
        solutions.append(SoloSolution(problem, trajectory, solution is None and rest is None))
    return solutions, solves + sum(solution.is_unreachable for solution in solutions)


def solve_solo_transfers(
    transfer: TransferProblem, start: Float[Array, "agents n"], targets: Float[Array, "agents n"]
) -> tuple[list[Trajectory | None], int]:
    """Solve one transfer for many agents, and count the programs solved one by one.

    Returns:
        Trajectories; None where the target is out of reach.
    """
    model = transfer.model
    if len(model) == 0:
        return [transfer.simulate(x, np.zeros((0, model.axes))) for x in start], 0
    if (transfer.fuel_norm, transfer.control_norm) != (1, "inf"):
        each = zip(start, targets, strict=True)
        return [solve_transfer(transfer, x, target) for x, target in each], len(start)
    b = targets - model.simulate(start, np.zeros((len(start), len(model), model.axes)))[:, -1]
    u = solve_minimum_fuel(model, b, transfer.max_control, transfer.weights).u
    x = model.simulate(start, u)
    fuel = model.dt * np.abs(u).sum(axis=(1, 2))
    found = [
        None if np.isnan(fuel[i]) else Trajectory(x[i], u[i], float(fuel[i]))
        for i in range(len(start))
    ]
    too_fast = np.flatnonzero(transfer.is_too_fast(x).any(axis=1))
    for i in too_fast.tolist():
        found[i] = solve_transfer(transfer, start[i], targets[i])
    return found, len(too_fast)


def make_relinearizer(
    context: DecisionContext, transfer: TransferProblem
) -> Callable[[Trajectory], TransferProblem] | None:
    """Return a function that linearizes an agent's dynamics; None where they are linear."""
    model, step, time = context.mission.nonlinear_model, context.mission.step, context.time
    if model is None:
        return None

    def about(nominal: Trajectory) -> TransferProblem:
        return replace(transfer, model=linearize_along(model, nominal.x, nominal.u, step, time))

    return about


def _fallback(
    transfer: TransferProblem, start: Array, target: Array, rest: Float[Array, "T m"] | None
) -> Trajectory:
    # Where the target is out of reach: the rest of the previous plan, or as near as can be.
    if rest is None:
        return minimize_terminal_error(transfer, start, target)
    return transfer.simulate(start, rest)
