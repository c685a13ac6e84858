"""Auction costs: least fuel or energy of every agent for every target [Morgan2016, Problem 6]."""

from collections.abc import Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from dynamics.doors import checked
from problems.avoidance import AvoidanceProblem
from problems.bang_off_bang import Burns, solve_burns
from problems.conic import Unsolved
from problems.minimum_fuel import reachability_matrix, solve_minimum_fuel
from problems.solvers.verified import solve_program
from problems.transfer import Solver, Trajectory, TransferProblem, compute_energy, tie_break_weights

TIE_BREAK_RISE = 1e-7  # makes optima unique, at the cost of at most this part of the fuel
MAX_COORDINATES = 500_000  # of controls of all pairs that are computed at once

Starts = Float[Array, "agents n"]  # states of agents [m, m/s]
Costs = Float[Array, "agents targets"]
Targets = Float[Array, "targets n"]  # states to reach [m, m/s]


@checked
class TransferCosts(NamedTuple):
    """Least fuel or energy for every agent and target, without collision avoidance."""

    cost: Costs  # [m/s] or [m²/s³]; above all others where unreachable
    is_reachable: Bool[Array, "agents targets"]
    is_exact: Bool[Array, "agents targets"]  # else a lower bound: its path breaks a limit


@checked
def compute_transfer_costs(
    transfer: TransferProblem,
    start: Starts,
    targets: Targets,
    solvers: Sequence[Solver] | None = None,
) -> TransferCosts:
    """Compute the least fuel or energy of every pair of agent and target.

    Energy has a closed form without limits. A pair that breaks one keeps it as a lower bound,
    and is not exact; which of these are out of reach the program of the least fuel tells.

    Fuel: with fuel norm 1 all pairs are solved together, without the speed limit and with the
    control norm inf, see `minimum_fuel`. A pair whose cheapest path breaks a limit keeps that fuel,
    which is a lower bound, and is not exact; `solve_transfer` solves it with the limits. With other
    fuel norms every pair is solved by itself, which takes about ten milliseconds.

    Args:
        transfer: The remaining steps, limits and norms, the same for all agents.
        start: Positions [m] and velocities [m/s] of the agents.
        targets: Positions [m] and velocities [m/s] to reach.
        solvers: Solver of each agent; the default where None.

    Raises:
        ValueError: A state is not finite, or no step is left.
    """
    steps, shape = transfer.model, (len(start), len(targets))
    transfer.require_steps()
    unreachable = unreachable_cost(steps, transfer.control_limit.most)
    if transfer.objective == "energy":
        return _compute_energy_costs(transfer, start, targets)
    if not transfer.has_signed_controls:
        fuel, reachable = np.full(shape, unreachable), np.zeros(shape, dtype=bool)
        for i, j in np.ndindex(*shape):
            own = solvers[i] if solvers else solve_program
            if found := solve_transfer(transfer, start[i], targets[j], own):
                fuel[i, j], reachable[i, j] = found.fuel, True
        return TransferCosts(fuel, reachable, np.ones(shape, dtype=bool))
    cost, (reachable, exact) = np.empty(shape), np.empty((2, *shape), dtype=bool)
    count = max(1, MAX_COORDINATES // max(1, len(targets) * len(steps) * steps.axes))
    free = steps.coast_to_end(start)
    for first in range(0, len(start), count):
        few = slice(first, first + count)
        b = np.asarray(targets - free[few, None])
        cost[few], reachable[few], exact[few] = _compute_fuel(transfer, start[few], targets, b)
    cost[~reachable] = unreachable
    return TransferCosts(cost, reachable, exact)


def _compute_fuel(
    transfer: TransferProblem, start: Starts, targets: Targets, b: Float[Array, "agents targets n"]
) -> tuple[Any, Any, Any]:
    """Return the fuel of every displacement, and where it is reachable, and where it is exact."""
    steps, d, shape = transfer.model, transfer.model.axes, b.shape[:2]
    U, weight = transfer.max_control, tie_break_weights(len(steps), TIE_BREAK_RISE)
    fuel, (is_priced, is_kept) = np.zeros(shape), np.zeros((2, *shape), dtype=bool)
    reachable, is_asked = np.ones((2, *shape), dtype=bool)
    if steps.is_double_integrator:
        burns = solve_burns(b[..., :d], b[..., d:], steps, U)
        fuel = steps.dt * (burns.length * np.asarray(U)).sum(axis=2)
        reachable, is_priced = burns.is_reachable.all(axis=2), burns.is_certified.all(axis=2)
        is_kept, is_known = _check_limits(transfer, start, targets, burns)
        is_asked = ~is_priced | (reachable & ~is_known)
    # One batch an agent: its costs must not depend on the states of others in the last bit.
    found = solve_minimum_fuel(steps, b[is_asked], U, weight, batches=len(start))
    reachable[is_asked] = np.isfinite(found.fuel)
    fuel[is_asked] = np.where(is_priced[is_asked], fuel[is_asked], found.fuel)
    exact, (i, j) = is_kept | ~reachable, np.nonzero(is_asked & reachable)
    u = found.u[np.isfinite(found.fuel)]
    exact[i, j] = ~transfer.control_limit.is_exceeded(u).any(axis=1)
    if isfinite(transfer.speed_limit.most):
        exact[i, j] &= ~transfer.is_too_fast(steps.simulate(start[i], u)).any(axis=1)
    return fuel, reachable, exact


def _check_limits(
    transfer: TransferProblem, start: Starts, targets: Targets, burns: Burns
) -> tuple[Bool[Array, "agents targets"], Bool[Array, "agents targets"]]:
    """Return True where burns keep the limits of speed and control, and where that is known.

    On each axis no speed is above those before, between and after the burns. The speed between
    is flown where the burns of all axes leave an instant.
    """
    steps, d, limit = transfer.model, transfer.model.axes, transfer.speed_limit
    if transfer.control_norm != "inf" or steps.z.any():
        none = np.zeros(burns.first.shape[:2], dtype=bool)
        return none, none
    between = start[:, None, d:] + steps.dt * np.asarray(transfer.max_control) * burns.first
    ends = np.maximum(np.abs(start[:, None, d:]), np.abs(targets[:, d:]))
    is_kept = ~limit.is_exceeded(np.maximum(ends, np.abs(between)))
    first, last = (np.ceil(np.abs(burn).max(axis=2)) for burn in (burns.first, burns.last))
    is_flown = np.maximum(first, 1) <= len(steps) - np.maximum(last, 1)
    return is_kept, is_kept | (is_flown & limit.is_exceeded(between))


def _compute_energy_costs(
    transfer: TransferProblem, start: Starts, targets: Targets
) -> TransferCosts:
    model, U = transfer.model, transfer.control_limit.most
    shape = len(start), len(targets)
    energy, exact = np.zeros(shape), np.zeros(shape, dtype=bool)
    for i, x0 in enumerate(start):
        _, u, exact[i] = transfer.solve_without_limits(x0, targets)
        energy[i] = compute_energy(u, model.dt)
    reachable, b = exact.copy(), compute_displacements(model, start, targets)[~exact]
    # The box of r = ∞ contains the balls of the other norms.
    found = solve_minimum_fuel(model, b, transfer.max_control, np.ones(len(model)), len(start))
    reachable[~exact] = np.isfinite(found.fuel)
    # Twice the most energy.
    energy = np.where(reachable, energy, U * unreachable_cost(model, U))
    return TransferCosts(energy, reachable, exact | ~reachable)


@checked
def solve_transfer(
    transfer: TransferProblem,
    start: Float[Array, " n"],
    target: Float[Array, " n"],
    solver: Solver = solve_program,
) -> Trajectory | None:
    """Solve one transfer, with the speed limit.

    Returns:
        The trajectory; None where the target is unreachable, or where neither a trajectory nor
        its infeasibility can be certified, which has been seen at the very edge of reach only.
    """
    try:
        return AvoidanceProblem.alone(transfer, start, target, solver).solve().trajectory
    except Unsolved:
        return None


def unreachable_cost(steps: DiscreteModel, max_control: float) -> float:
    """Compute a finite cost above that of every trajectory: twice the most fuel [m/s]."""
    return 2 * steps.dt * max(len(steps), 1) * steps.axes * max_control


def compute_displacements(
    steps: DiscreteModel, start: Starts, targets: Targets
) -> Float[Array, "agents targets n"]:
    """Compute target minus terminal state of the free motion, for every pair."""
    return np.asarray(targets - steps.coast_to_end(start)[:, None])


@checked
def compute_distances(steps: DiscreteModel, start: Starts, targets: Targets) -> Costs:
    """Compute straight distances, the cost of [Morgan2016, Remark 3] [m]."""
    d = steps.axes
    return np.asarray(np.linalg.norm(targets[None, :, :d] - start[:, None, :d], axis=2))


@checked
def compute_energies(steps: DiscreteModel, start: Starts, targets: Targets) -> Costs:
    """Compute the least control energy, Δt Σ ‖u‖₂² = bᵀ (C Cᵀ)⁻¹ b Δt, without limits [m²/s³].

    It is strictly convex in the displacement b: in the assignment of least energy, trajectories
    of least energy do not cross, whatever the linear dynamics.
    """
    b = compute_displacements(steps, start, targets)
    return least_energies(steps, b.reshape(-1, b.shape[2])).reshape(b.shape[:2])


def least_energies(
    steps: DiscreteModel, displacement: Float[Array, "many n"]
) -> Float[Array, " many"]:
    """Compute the least control energy of displacements, without limits [m²/s³].

    With too few steps to reach every state it is the energy of coming nearest.
    """
    C = reachability_matrix(steps).reshape(2 * steps.axes, -1)
    rows = displacement.T
    if np.linalg.matrix_rank(C) == len(C):
        u = np.linalg.solve(np.linalg.qr(C.T)[1].T, rows)  # of the same norm as the controls
    else:
        u = np.linalg.pinv(C) @ rows
    return np.asarray(steps.dt * (u**2).sum(axis=0))
