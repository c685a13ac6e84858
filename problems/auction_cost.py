"""Auction costs: least fuel or energy of every agent for every target [Morgan2016, Problem 6]."""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from problems.avoidance import AvoidanceProblem
from problems.conic import Unsolved
from problems.minimum_fuel import reachability_matrix, solve_minimum_fuel
from problems.solvers.verified import solve_program
from problems.transfer import Solver, Trajectory, TransferProblem, compute_energy, tie_break_weights

TIE_BREAK_RISE = 1e-7  # makes optima unique, at the cost of at most this part of the fuel
MAX_COORDINATES = 500_000  # of controls that are simulated at once


class TransferCosts(NamedTuple):
    """Least fuel or energy for every agent and target, without collision avoidance."""

    cost: Float[Array, "agents targets"]  # [m/s] or [m²/s³]; above all others where unreachable
    is_reachable: Bool[Array, "agents targets"]
    is_exact: Bool[Array, "agents targets"]  # else a lower bound: its path breaks a limit


def compute_transfer_costs(
    transfer: TransferProblem,
    start: Float[Array, "agents n"],
    targets: Float[Array, "targets n"],
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
        start: States of the agents.
        targets: Terminal states.
        solvers: Solver of each agent; the default where None.

    Raises:
        ValueError: A state is not finite, or no step is left.
    """
    steps, shape = transfer.model, (len(start), len(targets))
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
    b = compute_displacements(steps, start, targets).reshape(-1, start.shape[1])
    weight = tie_break_weights(len(steps), TIE_BREAK_RISE)
    # One batch an agent: its costs must not depend on the states of others in the last bit.
    solved = solve_minimum_fuel(steps, b, transfer.max_control, weight, batches=len(start))
    fuel, u = solved.fuel.reshape(shape), solved.u.reshape(*shape, len(steps), steps.axes)
    reachable, exact = np.isfinite(fuel), np.ones(shape, dtype=bool)
    if isfinite(transfer.speed_limit.most):
        exact, count = ~reachable, max(1, MAX_COORDINATES * len(u) // max(1, u.size))
        for first in range(0, len(start), count):
            few = slice(first, first + count)
            x0 = np.broadcast_to(start[few, None], (*u[few].shape[:2], start.shape[1]))
            exact[few] |= ~transfer.is_too_fast(steps.simulate(x0, u[few])).any(axis=2)
    if transfer.control_norm != "inf":
        exact &= ~(reachable & transfer.control_limit.is_exceeded(u).any(axis=2))
    return TransferCosts(np.where(reachable, fuel, unreachable), reachable, exact)


def _compute_energy_costs(
    transfer: TransferProblem, start: Float[Array, "agents n"], targets: Float[Array, "targets n"]
) -> TransferCosts:
    model, U = transfer.model, transfer.control_limit.most
    shape = len(start), len(targets)
    energy, exact = np.zeros(shape), np.zeros(shape, dtype=bool)
    for i, x0 in enumerate(start):
        _, u, exact[i] = transfer.solve_without_limits(x0, targets)
        energy[i] = compute_energy(u, model.dt)
    reachable, b = exact.copy(), compute_displacements(model, start, targets)
    for i in range(len(start)):
        # The box of r = ∞ contains the balls of the other norms.
        found = solve_minimum_fuel(
            model, b[i, ~exact[i]], transfer.max_control, np.ones(len(model))
        )
        reachable[i, ~exact[i]] = np.isfinite(found.fuel)
    # Twice the most energy.
    energy = np.where(reachable, energy, U * unreachable_cost(model, U))
    return TransferCosts(energy, reachable, exact | ~reachable)


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
    steps: DiscreteModel, start: Float[Array, "agents n"], targets: Float[Array, "targets n"]
) -> Float[Array, "agents targets n"]:
    """Compute target minus terminal state of the free motion, for every pair."""
    free = steps.simulate(start, np.zeros((len(start), len(steps), steps.axes)))[:, -1]
    return np.asarray(targets[None] - free[:, None])


def compute_distances(
    steps: DiscreteModel, start: Float[Array, "agents n"], targets: Float[Array, "targets n"]
) -> Float[Array, "agents targets"]:
    """Compute straight distances, the cost of [Morgan2016, Remark 3] [m]."""
    d = steps.axes
    return np.asarray(np.linalg.norm(targets[None, :, :d] - start[:, None, :d], axis=2))


def compute_energies(
    steps: DiscreteModel, start: Float[Array, "agents n"], targets: Float[Array, "targets n"]
) -> Float[Array, "agents targets"]:
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
