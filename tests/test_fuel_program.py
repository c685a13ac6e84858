"""Programs of least fuel to which rows are added: against HiGHS, and their certificates."""

import numpy as np
import pytest
from graphs import complete
from planner_examples import random_swarm
from scipy.optimize import linprog

from problems import fuel_program
from problems.fuel_program import FuelProgram
from problems.solvers.verified import solve_program
from sato.scp.exchange import run_scp

PENALTY, ERROR = 9.0, 7.0


def draw(rng):
    """Weights, equations, inequalities, and what of them is relaxed."""
    n, rows = int(rng.integers(6, 60)), int(rng.integers(0, 40))
    near = np.clip(rng.normal(size=n), -1, 1) * rng.choice([0.2, 1.0, 1.5])
    E, C = rng.normal(size=(4, n)), rng.normal(size=(rows, n))
    h = rng.uniform(-0.3, 0.9, rows) - C @ near * rng.choice([1.0, 0.5])
    return rng.uniform(0.5, 1.5, n), E, -E @ near, C, h, rng.random(2) < 0.5


def solve_in_parts(w, E, g, C, h, relaxed, parts):
    program = FuelProgram(w, PENALTY if relaxed[0] else np.inf)
    program.add(E, g, np.full(len(g), ERROR if relaxed[1] else np.inf))
    status = program.solve()
    for some in np.array_split(np.arange(len(h)), parts):
        if status == "optimal" and len(some):
            program.add(C[some], h[some], is_relaxed=bool(relaxed[0]))
            status = program.solve()
    return program, program.confirm() if status == "optimal" else status


def solve_highs(w, E, g, C, h, relaxed):
    n, m = len(w), len(g)
    slack, error = np.full((len(h), 1), -1.0 * relaxed[0]), np.eye(m) * relaxed[1]
    found = linprog(
        np.concatenate([w, w, [PENALTY], np.full(2 * m, ERROR)]),
        A_ub=np.hstack([-C, C, slack, np.zeros((len(h), 2 * m))]),
        b_ub=h,
        A_eq=np.hstack([E, -E, np.zeros((m, 1)), error, -error]),
        b_eq=-g,
        bounds=[(0, 1)] * (2 * n) + [(0, None)] * (1 + 2 * m),
    )
    return {0: "optimal", 2: "infeasible"}[found.status], found.fun


def cost_of(program, w, E, g, C, h, relaxed):
    u = program.controls
    violation = np.maximum(-C @ u - h, 0).max(initial=0.0)
    assert relaxed[0] or violation <= 1e-8
    assert relaxed[1] or np.abs(E @ u + g).max() <= 1e-8
    return w @ np.abs(u) + PENALTY * violation + ERROR * np.abs(E @ u + g).sum()


def test_cost_is_that_of_highs_in_however_many_parts_rows_are_added(rng):
    statuses = []
    for _ in range(120):
        drawn = draw(rng)
        expected, least = solve_highs(*drawn)
        for parts in (1, 3):
            program, status = solve_in_parts(*drawn, parts)
            assert status == expected
            if status == "optimal":
                assert cost_of(program, *drawn) == pytest.approx(least, rel=1e-7, abs=1e-7)
        statuses.append(expected)
    assert {"optimal", "infeasible"} == set(statuses)


def test_rows_that_repeat_others_leave_the_cost(rng):
    for _ in range(20):
        w, E, g, C, h, relaxed = draw(rng)
        relaxed[1] = True
        twice = w, E, g, np.vstack([C, C]), np.tile(h, 2), relaxed
        alone, expected = solve_in_parts(w, E, g, C, h, relaxed, 1)
        program, status = solve_in_parts(*twice, 2)
        assert status == expected
        if status == "optimal":
            assert cost_of(program, *twice) == pytest.approx(cost_of(alone, *twice), rel=1e-7)


def test_a_row_without_entries_decides_by_its_constant():
    for constant, expected in ((0.1, "optimal"), (-0.1, "infeasible")):
        program = FuelProgram(np.ones(3))
        program.add(np.array([[1.0, 0, 0], [0, 0, 0]]), np.array([0.0, constant]))
        assert program.solve() == expected


def test_infeasibility_is_certified_where_other_rows_are_relaxed(rng):
    """Rows that must hold join after some that need not."""
    count = 0
    for _ in range(40):
        w, E, g, C, h, _ = draw(rng)
        program = FuelProgram(w, PENALTY)
        program.add(E, g, np.full(len(g), ERROR))
        program.add(C, h, is_relaxed=True)
        assert program.solve() == "optimal"
        row = rng.normal(size=(1, len(w)))
        program.add(row, np.array([-1.001 * np.abs(row).sum()]))
        assert program.solve() == "infeasible"
        count += len(h) > 0
    assert count > 20


def test_programs_that_one_point_satisfies_are_solved(rng):
    for _ in range(50):
        n = int(rng.integers(2, 20))
        coeffs, corner = rng.normal(size=(2, n)), rng.choice([-1.0, 1.0], n)
        coeffs[0] = corner * rng.uniform(0.1, 1.0, n)
        program = FuelProgram(rng.uniform(0.5, 1.5, n))
        program.add(coeffs, -coeffs @ corner, np.full(2, np.inf))
        assert program.solve() == "optimal" == program.confirm()
        np.testing.assert_allclose(program.controls, corner, atol=1e-7)


def test_an_answer_to_another_program_is_no_answer():
    program = FuelProgram(np.ones(1), 1e6)
    program.add(np.ones((1, 1)), np.array([-0.5]), is_relaxed=True)
    assert program.solve() == "optimal" == program.confirm()
    program._slopes[1, 1] = 0.01  # with this penalty it costs less to violate the row
    assert not program._is_optimal()
    program = FuelProgram(np.ones(1))
    program.add(np.ones((1, 1)), np.array([5.0]), np.array([10.0]))
    assert program.solve() == "optimal"
    program._ray = np.array([-1.0, 0.0, 1.0])
    assert not program._is_unbounded()


def test_what_stops_without_an_answer_is_solved_by_the_conic_solver(rng, monkeypatch):
    def plan_all():
        swarm = random_swarm(np.random.default_rng(3), 5)
        return {i: own.nominal for i, own in run_scp(swarm, complete(5))[0].items()}

    found, before = plan_all(), solve_program.fallback_count
    monkeypatch.setattr(fuel_program, "MAX_PIVOTS", 1)
    for i, trajectory in plan_all().items():
        assert trajectory.fuel == pytest.approx(found[i].fuel, rel=1e-5)
    assert solve_program.fallback_count > before
