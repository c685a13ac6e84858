"""Constraint generation: speed limits by tangents, and programs that need no other solver."""

from dataclasses import replace

import numpy as np
import pytest

from dynamics import DoubleIntegrator, discretize_zoh
from problems.avoidance import AvoidanceProblem
from problems.conic import Infeasible
from problems.constraint_generation import _list_tangents
from problems.half_spaces import HalfSpaces
from problems.limit import Limit
from problems.transfer import TransferProblem

NORMS = (1, 2, "inf")


def draw_limit(rng, norm):
    d = int(rng.integers(2, 4))
    return Limit(rng.uniform(0.2, 1.0, d) if rng.random() < 0.5 else 0.7, norm, d)


@pytest.mark.parametrize("norm", NORMS)
def test_tangents_keep_the_limit_and_cut_off_what_exceeds_it(rng, norm):
    for _ in range(30):
        limit = draw_limit(rng, norm)
        v = rng.normal(size=(8, limit.axes))
        v *= (limit.most / limit.measure(v) * rng.uniform(1.001, 2.0, 8))[:, None]
        rows, most, at = _list_tangents(limit, v, np.arange(8))
        inside = limit.cut(rng.normal(size=(500, limit.axes)) * limit.shares * 2 * limit.most)
        assert (rows @ inside.T).max() <= most * (1 + 1e-12)
        for k in range(8):
            assert (rows[at == k] @ v[k]).max() > most


@pytest.mark.parametrize("norm", NORMS)
def test_strong_vehicles_with_a_low_speed_limit_need_no_conic_program(rng, norm, monkeypatch):
    """Tolerances of rows are relative to the control, and the speed is far below what it makes."""
    monkeypatch.setattr(AvoidanceProblem, "solve_conic", None)
    steps, size, count = discretize_zoh(DoubleIntegrator(2), 1.0, 30), 0.01, 0
    for _ in range(12):
        start = np.append([0, 0], rng.normal(size=2) * 0.3 * size)
        ends = start, np.array([10.0 * size, 0, 0, 0])
        aside = np.tile([0, rng.choice([-1.0, 1.0]), 0, 0], (6, 1))
        bounds = rng.uniform(0, 4.0 * size, 6)
        walls = HalfSpaces(rng.integers(10, 20, 6), aside, np.zeros((6, 2)), bounds)
        free = TransferProblem(steps, 1.0, tie_break_rise=1e-2, speed_norm=norm)
        fastest = AvoidanceProblem(free, *ends, walls).solve().trajectory
        V = free.speed_limit.measure(fastest.x[1:-1, 2:]).max()
        for share in (0.99, 0.9):
            transfer = replace(free, max_speed=share * float(V))
            found = AvoidanceProblem(transfer, *ends, walls).solve("separation")
            assert not transfer.is_too_fast(found.trajectory.x).any()
            speed = transfer.speed_limit.measure(found.trajectory.x[1:-1, 2:])
            count += speed.max() > 0.999 * transfer.speed_limit.most
    assert count > 10


def test_the_least_time_is_taken_and_less_is_refused():
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 10)
    for away, U in ((2.5, 0.1), (5.0, 0.2)):  # U T² / 4
        transfer = TransferProblem(steps, U)
        goal = np.array([away * (1 - 1e-9), 0, 0, 0])
        found = AvoidanceProblem.alone(transfer, np.zeros(4), goal).generate()
        assert found.terminal_error <= 1e-7
        with pytest.raises(Infeasible):
            AvoidanceProblem.alone(transfer, np.zeros(4), 1.0001 * goal).generate()
