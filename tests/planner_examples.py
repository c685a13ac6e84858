"""Example planners and graphs for tests of conflict resolution."""

from functools import cache

import numpy as np

from dynamics import DoubleIntegrator, discretize_zoh
from dynamics.trajectory_geometry import separations
from problems.avoidance import AvoidanceProblem
from problems.convexify import AvoidanceHorizon
from problems.transfer import Trajectory, TransferProblem
from sato.scp import FEASIBILITY_TOLERANCE, Planner
from sato.scp.priority_orders import compute_priority_cost

T, STEP, RADIUS = 12, 1.0, 0.5


@cache
def make_problem(axes=2, horizon_steps=T, speed=0.6):
    model = DoubleIntegrator(axes)
    transfer = TransferProblem(discretize_zoh(model, STEP, T), 0.2, speed, tie_break_rise=1e-3)
    ahead = discretize_zoh(model, STEP, horizon_steps)
    return transfer, AvoidanceHorizon(
        ahead, discretize_zoh(model, STEP / 2, 2 * horizon_steps), RADIUS
    )


def make_planner(number, start, goal, spent=0.0, velocity=0.0, transfer=None, horizon=None):
    """Planner of an agent from rest, or with a velocity along x, to rest."""
    usual = make_problem(len(start))
    transfer, horizon = transfer or usual[0], horizon or usual[1]
    start = np.concatenate([start, np.full(len(start), velocity) * (np.arange(len(start)) == 0)])
    goal = np.concatenate([goal, np.zeros(len(goal))])
    free = AvoidanceProblem.alone(transfer, start, goal).solve().trajectory
    path = horizon.control_points(free.x, free.u)
    return Planner((True, -spent, number), goal, transfer, horizon, free, free, path)


def random_swarm(rng, count, axes=2, box=3.0):
    """Agents with random, separated starts and random, separated targets."""
    ends = []
    for _ in range(2):
        points = []
        while len(points) < count:
            p = rng.uniform(-box / 2, box / 2, axes)
            if all(np.linalg.norm(p - q) > 1.5 * RADIUS for q in points):
                points.append(p)
        ends.append(np.array(points))
    return {i: make_planner(i, ends[0][i], ends[1][i]) for i in range(count)}


def antipodal_swarm(count, radius, turn=0.03):
    """Agents that move to the opposite side of a circle: every pair meets in the middle."""
    angle = 2 * np.pi * np.arange(count) / count
    start = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    goal = -radius * np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=1)
    return {i: make_planner(i, start[i], goal[i]) for i in range(count)}


def total_cost(planners):
    return tuple(np.sum([compute_priority_cost(agent) for agent in planners.values()], axis=0))


def continuous_separation(planners, states=None):
    x = np.stack([p.nominal.x[:states] for p in planners.values()], axis=1)
    d = x.shape[2] // 2
    alive = np.ones(x.shape[:2], dtype=bool)
    return separations(x[..., :d], x[..., d:], alive, STEP).minimum.distance


def weighted_fuel(flight, transfer):
    return STEP * float(transfer.weights @ np.abs(flight.u).sum(axis=1))


def immobile(number, place):
    """Agent without steps left: it stays in place and cannot give way."""
    x = np.concatenate([place, np.zeros(len(place))])
    transfer, horizon = make_problem(len(place))
    flight = Trajectory(x[None], np.zeros((0, len(place))), 0.0)
    over = TransferProblem(transfer.model[:0], transfer.max_control)
    path = horizon.control_points(flight.x, flight.u)
    return Planner((False, 0.0, number), x, over, horizon, flight, flight, path)


def renumbered(planners, first):
    """The same agents, numbered from another number on."""
    return {
        first + i: p._replace(priority=(*p.priority[:2], first + i)) for i, p in planners.items()
    }


def left_astray(planner, **changes):
    """An agent whose nominal is to stay where it starts."""
    still = planner.transfer.simulate(planner.nominal.x[0], np.zeros_like(planner.nominal.u))
    return planner.with_nominal(still)._replace(terminal_error=3.0, **changes)


def with_previous_plans(planners, former):
    """The same agents, with the nominals of others of the same number."""
    return {
        i: p.with_nominal(former[i].nominal)._replace(has_converged=False)
        for i, p in planners.items()
    }


def keeps_all(planner):
    """No constraint is relaxed by more than counts as none."""
    return max(planner.slack, planner.terminal_error) <= FEASIBILITY_TOLERANCE * RADIUS
