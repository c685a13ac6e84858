"""What it costs every agent to take up every target, all at once [Morgan2016, Problem 6]."""

from contextlib import suppress
from math import inf, isfinite
from threading import local
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics import DiscreteModel
from problems.avoidance import AvoidanceProblem, empty_half_spaces
from problems.conic import TOLERANCE, Unsolved
from problems.minimum_fuel import MinimumFuelSolutions, reachability_matrix, solve_minimum_fuel
from problems.speed_limited import SpeedLimitedSolver
from problems.transfer import Trajectory, TransferProblem, tie_break_weights

# A slope of the weights that keeps optima unique and costs no more than this part of the fuel.
TIE_BREAK_RISE = 1e-7


class TransferCosts(NamedTuple):
    """Least fuel for every agent and target, no collisions."""

    fuel: Float[Array, "agents targets"]  # [m/s]; where out of reach, above every feasible price
    is_reachable: Bool[Array, "agents targets"]
    is_exact: Bool[Array, "agents targets"]  # else a lower bound: that path breaks the speed limit
    duality_gap: float  # largest relative distance of a price from its dual bound


def compute_transfer_costs(
    steps: DiscreteModel,
    start: Float[Array, "agents n"],
    goals: Float[Array, "targets n"],
    max_control: float,
    max_speed: float = inf,
) -> TransferCosts:
    """Price every pair for q = 1 and r = ∞, exactly but for the speed limit.

    The pairs share everything but their displacement, see `least_fuel`. A pair whose
    cheapest path breaks the speed limit keeps that price, which the limit can only
    raise, and is marked; `price_within_speed` settles it.

    Args:
        steps: The remaining steps, the same for all.
        start: Where the agents are.
        goals: Where they might have to be at the end.
        max_control: U [m/s²].
        max_speed: V [m/s].

    Raises:
        ValueError: A limit is not positive, a number not finite, or no step is left.
    """
    if not max_speed > 0:
        raise ValueError(f"max_speed must be positive, got {max_speed}")
    b = compute_displacements(steps, start, goals)
    weight = tie_break_weights(len(steps), TIE_BREAK_RISE)
    agents, targets, n = b.shape
    # One lot an agent: what it pays does not depend on where the others are, to the last bit.
    burns = solve_minimum_fuel(steps, b.reshape(-1, n), max_control, weight, batches=agents)
    reachable = np.isfinite(burns.fuel)
    exact = np.ones_like(reachable)
    if isfinite(max_speed) and len(steps) > 1:
        x0 = np.repeat(start, targets, axis=0)
        exact = _is_within_speed_limit(
            steps.A, steps.B, steps.z, x0, burns.u, max_speed * (1 + 1e-9)
        )
        exact |= ~reachable
    fuel = np.where(reachable, burns.fuel, unreachable_cost(steps, max_control))
    shape = (agents, targets)
    return TransferCosts(
        fuel.reshape(shape),
        reachable.reshape(shape),
        exact.reshape(shape),
        _max_duality_gap(burns, steps, max_control),
    )


def solve_transfer(
    transfer: TransferProblem, start: Float[Array, " n"], goal: Float[Array, " n"]
) -> Trajectory | None:
    """The exact answer for one pair that the speed limit binds.

    Returns:
        None where the goal is out of reach, or, which is rare and not seen but at the very
        edge of reach, where nothing can be proven either way.
    """
    paper = (transfer.fuel_norm, transfer.control_norm) == (1, "inf")
    try:
        if paper and isfinite(transfer.max_speed):
            return _cached_solver(transfer).solve(start, goal)
        return AvoidanceProblem(transfer).solve(start, goal, empty_half_spaces(transfer)).trajectory
    except Unsolved:
        return None


_thread_cache = local()  # a solver is of one thread, and of the last transfer that was asked about


def _cached_solver(transfer: TransferProblem) -> SpeedLimitedSolver:
    last: SpeedLimitedSolver | None = getattr(_thread_cache, "last", None)
    if last is None or last.transfer is not transfer:
        last = _thread_cache.last = SpeedLimitedSolver(transfer)
    return last


def compute_exact_costs(
    steps: DiscreteModel,
    start: Float[Array, "agents n"],
    goals: Float[Array, "targets n"],
    max_control: float,
    max_speed: float = inf,
) -> TransferCosts:
    """Price every pair exactly, also those that the speed limit binds.

    Args:
        steps: The remaining steps, the same for all.
        start: Where the agents are.
        goals: Where they might have to be at the end.
        max_control: U [m/s²].
        max_speed: V [m/s].
    """
    prices = compute_transfer_costs(steps, start, goals, max_control, max_speed)
    agent, target = np.nonzero(~prices.is_exact)
    if len(agent) == 0:
        return prices
    within = SpeedLimitedSolver(
        TransferProblem(steps, max_control, max_speed, tie_break_rise=TIE_BREAK_RISE)
    )
    first = np.searchsorted(agent, np.arange(len(start) + 1))  # one lot an agent, as in `price`
    burns = within.solve_many(start[agent], goals[target], first)
    reached = np.isfinite(burns.fuel)
    fuel, reachable = prices.fuel.copy(), prices.is_reachable.copy()
    fuel[agent, target] = np.where(reached, burns.fuel, unreachable_cost(steps, max_control))
    reachable[agent, target] = reached
    gap = max(prices.duality_gap, _max_duality_gap(burns, steps, max_control))
    return TransferCosts(fuel, reachable, np.ones_like(reachable), gap)


def _max_duality_gap(
    burns: MinimumFuelSolutions, steps: DiscreteModel, max_control: float
) -> float:
    # Of all that are in reach, the largest relative one.
    fuel, bound = burns.fuel[np.isfinite(burns.fuel)], burns.dual_bound[np.isfinite(burns.fuel)]
    gap = np.abs(fuel - bound) / np.maximum(np.abs(bound), 1e-9 * max_control * steps.dt)
    return float(gap.max(initial=0.0))


def compute_costs_cvxpy(
    transfer: TransferProblem, start: Float[Array, "agents n"], goals: Float[Array, "targets n"]
) -> TransferCosts:
    """Price every pair by the statement, for norms other than q = 1 and r = ∞.

    About ten milliseconds a pair.

    Args:
        transfer: The remaining steps, the limits and the norms.
        start: Where the agents are.
        goals: Where they might have to be at the end.
    """
    shape = (len(start), len(goals))
    fuel = np.full(shape, unreachable_cost(transfer.model, transfer.max_control))
    reachable = np.zeros(shape, dtype=bool)
    for i, j in np.ndindex(*shape):
        with suppress(Unsolved):  # as `price_within_speed`, also at the very edge of reach
            fuel[i, j] = transfer.solve(start[i], goals[j]).fuel
            reachable[i, j] = True
    return TransferCosts(fuel, reachable, np.ones(shape, dtype=bool), TOLERANCE)


def unreachable_cost(steps: DiscreteModel, max_control: float) -> float:
    """A finite price above that of every flight there is: twice all that can be burnt [m/s]."""
    return 2 * steps.dt * max(len(steps), 1) * steps.axes * max_control


def compute_displacements(
    steps: DiscreteModel, start: Float[Array, "agents n"], goals: Float[Array, "targets n"]
) -> Float[Array, "agents targets n"]:
    """Goal minus where the free motion ends, for every pair."""
    free = steps.simulate(start, np.zeros((len(start), len(steps), steps.axes)))[:, -1]
    return np.asarray(goals[None] - free[:, None])


def compute_distances(
    steps: DiscreteModel, start: Float[Array, "agents n"], goals: Float[Array, "targets n"]
) -> Float[Array, "agents targets"]:
    """Straight distance, the algebraic cost of [Morgan2016, Remark 3] [m]."""
    d = steps.axes
    return np.asarray(np.linalg.norm(goals[None, :, :d] - start[:, None, :d], axis=2))


def compute_energies(
    steps: DiscreteModel, start: Float[Array, "agents n"], goals: Float[Array, "targets n"]
) -> Float[Array, "agents targets"]:
    """Least control energy, Δt Σ ‖u‖₂² = bᵀ (C Cᵀ)⁻¹ b Δt, without limits [m²/s³].

    Strictly convex in the displacement b: the assignment of least energy has paths of
    least energy that do not cross, whatever the linear dynamics. With too few steps to
    reach every state it is the energy of coming nearest.
    """
    C = reachability_matrix(steps).reshape(2 * steps.axes, -1)
    b = compute_displacements(steps, start, goals)
    rows = b.reshape(-1, len(C)).T
    if np.linalg.matrix_rank(C) == len(C):
        u = np.linalg.solve(np.linalg.qr(C.T)[1].T, rows)  # as long as the controls themselves
    else:
        u = np.linalg.pinv(C) @ rows
    return np.asarray(steps.dt * (u**2).sum(axis=0).reshape(b.shape[:2]))


@numba.njit(cache=True, parallel=True)
@no_type_check
def _is_within_speed_limit(A, B, z, start, u, limit):
    pairs, T, m = u.shape
    n = start.shape[1]
    keeps = np.ones(pairs, np.bool_)
    for p in numba.prange(pairs):
        x, after = start[p].copy(), np.empty(n)
        for k in range(T - 1):
            speed = 0.0
            for a in range(n):
                after[a] = z[k, a]
                for c in range(n):
                    after[a] += A[k, a, c] * x[c]
                for c in range(m):
                    after[a] += B[k, a, c] * u[p, k, c]
                if a >= m:
                    speed += after[a] ** 2
            x[:] = after
            if speed > limit**2:
                keeps[p] = False
                break
    return keeps
