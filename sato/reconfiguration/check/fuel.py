"""The fuel that was burnt, and the least that it could have been."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.assignment import assign
from sato.reconfiguration.check.evidence import Evidence, Stretch
from sato.reconfiguration.check.prediction import came, end_by_model
from sato.reconfiguration.mission import Norm

FEW = 600  # pairs that are solved one by one, where no method for all at once exists


class Prices(NamedTuple):
    """What every pair costs, and which of the prices are only lower bounds so far."""

    fuel: Float[Array, "survivors targets"]  # [m/s]; infinite where out of reach
    exact: Bool[Array, "survivors targets"]
    settle: Callable[[int, int], float]  # the exact price of a pair


class Bound(NamedTuple):
    """Least fuel of a leg, from where it started, in the time that it took."""

    total: float  # of the central optimum [m/s]
    agents: Int[Array, " survivors"]
    own: Float[Array, " survivors"]  # of each agent, to the target that it held at the end [m/s]
    mend: Float[Array, " survivors"]  # to be led there by the shared model, see `least` [m/s]


def burnt(evidence: Evidence) -> Float[Array, "steps agents"]:
    """Fuel of every agent in every step [m/s]."""
    u = np.where(evidence.flies[..., None], evidence.control[:-1], 0.0)
    return size(u, evidence.mission.fuel_norm) * evidence.mission.step


def size(u: Float[Array, "*k d"], norm: Norm) -> Float[Array, "*k"]:
    """A vector's size in one of the three norms."""
    order = np.inf if norm == "inf" else float(norm)
    return np.asarray(np.linalg.norm(u, ord=order, axis=-1))


def least(evidence: Evidence, stretch: Stretch) -> Bound | None:
    """Lower bound on the fuel of a leg, by the model that all agents share.

    It counts the agents that were there at the end, each from where it was at the start
    of the leg, or where it came in. A plant that is not the model may take an agent to its
    target for less. By the model, its commanded controls would have ended somewhere else,
    and as much fuel as it takes to move that end to the target, alone and without limits
    but that of the control, is what its plant can have saved it (`mend`): while limits do
    not bind, the price of a transfer grows by no more than the price of the difference.

    None where the bound cannot be had: the leg never ended, an agent could not have made
    its way, or the instance is too large for norms that have no method for all pairs at once.
    """
    if stretch.end is None or not stretch.steps:
        return None
    agents = np.asarray(stretch.end["agents"], dtype=np.int64)
    held = np.asarray(stretch.end["target"], dtype=np.int64)[agents]
    told = np.asarray(stretch.end["believed"], dtype=np.int64)[agents]
    goals = evidence.goals[stretch.leg]
    goals = goals[np.isfinite(goals).all(axis=1)]
    m = max(int(told.max(initial=0)), len(agents))
    if len(goals) < m:
        return None
    held[held >= len(goals)] = -1
    # Every target that somebody holds is priced too, for that agent's own bound.
    prices = _prices(evidence, stretch, agents, goals[: max(m, int(held.max(initial=-1)) + 1)])
    if prices is None:
        return None
    chosen = _optimum(prices, m)
    who = np.arange(len(agents))
    for i in np.flatnonzero(held >= 0):
        _settle(prices, int(i), int(held[i]))
    own = np.where(held >= 0, prices.fuel[who, held], np.nan)
    total = float(prices.fuel[who, chosen].sum())
    if not np.isfinite(total):
        return None
    return Bound(total, agents, own, _mend(evidence, stretch, agents, held))


def bound_of_each(evidence: Evidence, bounds: list[Bound | None]) -> Float[Array, " agents"]:
    """Least fuel of each agent to the targets it held; NaN unless all its legs are priced."""
    total = np.zeros(evidence.alive.shape[1])
    for stretch, bound in zip(evidence.stretches, bounds, strict=True):
        priced = np.full(len(total), np.nan)
        if bound is not None:
            priced[bound.agents] = np.where(np.isfinite(bound.own), bound.own, np.nan)
        absent = ~evidence.alive[stretch.first : stretch.last].any(axis=0)
        total += np.where(absent, 0.0, priced)
    return total


def _mend(
    evidence: Evidence,
    stretch: Stretch,
    agents: Int[Array, " survivors"],
    held: Int[Array, " survivors"],
) -> Float[Array, " survivors"]:
    # With fuel counted as |u|₁, which is at least as much as in the other norms.
    from problems.least_fuel import least_fuel

    end = end_by_model(evidence, stretch, agents, evidence.control)
    off = evidence.goals[stretch.leg][held] - end
    first, price = came(evidence, stretch, agents), np.full(len(agents), np.inf)
    known = (first < stretch.last) & (held >= 0) & np.isfinite(off).all(axis=1)
    for k in np.unique(first[known]):
        who = np.flatnonzero((first == k) & known)
        steps = evidence.steps[slice(k, stretch.last)]
        limit, weight = evidence.mission.max_control, np.ones(len(steps))
        price[who] = least_fuel(steps, off[who], limit, weight).fuel
    return price


def _optimum(prices: Prices, m: int) -> Int[Array, " survivors"]:
    # Lower bounds are made exact where the optimum uses them, until it uses no other.
    who = np.arange(len(prices.fuel))
    while True:
        first = prices.fuel[:, :m]
        finite = np.isfinite(first)
        far = 1 + np.max(first, initial=0.0, where=finite) * (len(first) + 1)
        chosen = assign(np.where(finite, first, far))
        loose = np.flatnonzero(~prices.exact[who, chosen])
        if not len(loose):
            return chosen
        for i in loose:
            _settle(prices, int(i), int(chosen[i]))


def _settle(prices: Prices, i: int, j: int) -> None:
    if not prices.exact[i, j]:
        prices.fuel[i, j] = prices.settle(i, j)
        prices.exact[i, j] = True


def _prices(
    evidence: Evidence,
    stretch: Stretch,
    agents: Int[Array, " survivors"],
    goals: Float[Array, "targets n"],
) -> Prices | None:
    from problems.auction_cost import price, price_within_speed
    from problems.conic import Infeasible
    from problems.transfer import Transfer

    mission = evidence.mission
    limits = (mission.max_control, mission.max_speed)
    norms = (mission.fuel_norm, mission.control_norm)
    together = norms == (1, "inf")
    if not together and len(agents) * len(goals) > FEW:
        return None
    first = came(evidence, stretch, agents)
    start = evidence.state[first, agents]
    if (first >= stretch.last).any() or not np.isfinite(start).all():
        return None
    transfers = {
        int(k): Transfer(evidence.steps[slice(k, stretch.last)], *limits, *norms)
        for k in np.unique(first)
    }

    def settle(i: int, j: int) -> float:
        transfer = transfers[int(first[i])]
        if together:
            flight = price_within_speed(transfer, start[i], goals[j])
            return np.inf if flight is None else flight.fuel
        try:
            return transfer.solve(start[i], goals[j]).fuel
        except Infeasible:
            return np.inf

    fuel = np.zeros((len(agents), len(goals)))
    exact = np.zeros(fuel.shape, dtype=bool)
    for k, transfer in transfers.items():
        who = np.flatnonzero(first == k)
        if together:
            found = price(transfer.steps, start[who], goals, *limits)
            fuel[who] = np.where(found.reachable, found.fuel, np.inf)
            exact[who] = found.exact
    prices = Prices(fuel, exact, settle)
    if not together:
        for i, j in np.ndindex(*fuel.shape):
            _settle(prices, i, j)
    return prices
