"""Trajectories of the agents without regard to each other: iterate 0 of conflict resolution."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel, linearize_along
from problems.auction_cost import solve_transfer
from problems.minimum_fuel import solve_minimum_fuel
from problems.solvers.verified import solve_program
from problems.transfer import Solver, Trajectory, TransferProblem, compute_fuel
from sato.reconfiguration.state import DecisionContext
from sato.scp.planner import minimize_terminal_error

TIE_BREAK_RISE = 1e-3  # of the fuel's weights: burns at the ends, straight trajectories between


def solve_solo_trajectories(
    context: DecisionContext,
    model: DiscreteModel,
    agents: list[int],
    previous: list[Float[Array, "T m"] | None],
) -> tuple[list[TransferProblem], list[Trajectory], list[int], int]:
    """Solve the transfers of some agents with equal limits to their targets.

    The shared linear model comes first; where the dynamics are nonlinear, the trajectories are
    linearized about that solution once more, after which the remaining error is negligible.
    Previous plans are given by their remaining controls, if they still reach the targets. Found
    are each agent's own dynamics, and its trajectory; the numbers of those that neither a
    trajectory nor the previous plan takes to their targets; the number of programs solved.
    """
    mission, state = context.mission, context.state[agents]
    targets = context.leg.targets[context.memory.target_index[agents]]
    solvers = [context.solver_of(i) for i in agents]
    shared = context.make_transfer(model, agents[0], tie_break_rise=TIE_BREAK_RISE)
    found: list[Trajectory | None] = [None] * len(agents)
    if mission.keeps_plans:
        found = _keep_plans(shared, state, previous)
    new = [row for row, kept in enumerate(found) if kept is None]
    own = state[new], targets[new], [solvers[row] for row in new]
    solved, solves = solve_solo_transfers(shared, *own)
    for row, one in zip(new, solved, strict=True):
        found[row] = one
    problems = [shared] * len(agents)
    each = list(zip(state, targets, previous, solvers, strict=True))
    if mission.nonlinear_model is not None and len(model):
        nominal = [f or _fallback(shared, *own) for f, own in zip(found, each, strict=True)]
        x, u = (np.stack(part) for part in zip(*(f[:2] for f in nominal), strict=True))
        steps = linearize_along(mission.nonlinear_model, x, u, mission.step, context.time)
        problems = [replace(shared, model=steps.for_agent(i)) for i in range(len(agents))]
        found, count = solve_solo_transfers(replace(shared, model=steps), state, targets, solvers)
        solves += count
    each_found = list(zip(agents, problems, found, each, strict=True))
    trajectories = [f or _fallback(problem, *own) for _, problem, f, own in each_found]
    unreachable = [i for i, _, f, (_, _, rest, _) in each_found if f is None and rest is None]
    return problems, trajectories, unreachable, solves + len(unreachable)


def _keep_plans(
    transfer: TransferProblem,
    start: Float[Array, "agents n"],
    previous: list[Float[Array, "T m"] | None],
) -> list[Trajectory | None]:
    """Return the rests of previous plans; None where there is none."""
    kept: list[Trajectory | None] = [None] * len(previous)
    rows = [row for row, rest in enumerate(previous) if rest is not None]
    if rows:
        u = np.stack([rest for rest in previous if rest is not None])
        x = transfer.model.simulate(start[rows], u)
        fuel = np.asarray(compute_fuel(u, transfer.model.dt, transfer.fuel_norm))
        for row, states, own, spent in zip(rows, x, u, fuel.tolist(), strict=True):
            kept[row] = Trajectory(states, own, spent)
    return kept


def solve_solo_transfers(
    transfer: TransferProblem,
    start: Float[Array, "agents n"],
    targets: Float[Array, "agents n"],
    solvers: Sequence[Solver] = (),
) -> tuple[list[Trajectory | None], int]:
    """Solve one transfer for many agents, and count the programs solved one by one.

    The dynamics are the same for all, or those of each. Trajectories are None where the target is
    out of reach.
    """
    model, solvers = transfer.model, solvers or [solve_program] * len(start)
    if len(model) == 0:
        return [transfer.simulate(x, np.zeros((0, model.axes))) for x in start], 0
    alone = [transfer] * len(start)
    if model.A.ndim > 3:
        alone = [replace(transfer, model=model.for_agent(i)) for i in range(len(start))]
    if not transfer.is_linear:
        each = zip(alone, start, targets, solvers, strict=True)
        return [solve_transfer(*own) for own in each], len(start)
    b = targets - model.coast_to_end(start)
    u = solve_minimum_fuel(model, b, transfer.max_control, transfer.weights).u
    x = model.simulate(start, u)
    fuel = model.dt * np.abs(u).sum(axis=(1, 2))
    found = [
        None if np.isnan(fuel[i]) else Trajectory(x[i], u[i], float(fuel[i]))
        for i in range(len(start))
    ]
    too_fast = np.flatnonzero(transfer.is_too_fast(x).any(axis=1))
    for i in too_fast.tolist():
        found[i] = solve_transfer(alone[i], start[i], targets[i], solvers[i])
    return found, len(too_fast)


def relinearize(
    context: DecisionContext, transfer: TransferProblem, nominal: Trajectory
) -> TransferProblem:
    """Linearize an agent's nonlinear dynamics about a trajectory."""
    model, step = context.mission.nonlinear_model, context.mission.step
    assert model is not None
    return replace(transfer, model=linearize_along(model, nominal.x, nominal.u, step, context.time))


def _fallback(
    transfer: TransferProblem,
    start: Array,
    target: Array,
    rest: Float[Array, "T m"] | None,
    solver: Solver,
) -> Trajectory:
    # Where the target is out of reach: the rest of the previous plan, or as near as can be.
    if rest is None:
        return minimize_terminal_error(transfer, start, target, solver)
    return transfer.simulate(start, rest)
