"""Least violation of the cones, and certificates of infeasibility from its duals."""

import re
from dataclasses import replace

import numpy as np
import pytest
from random_programs import random_program
from scipy.sparse import csc_array

from problems import solvers
from problems.conic import ConicProgram, Infeasible, Unsolved, solve, verify_ray
from problems.phase_one import read_ray, relax_cones
from problems.solvers import SolverAdapter, load_adapters, solve_clarabel, verified
from problems.solvers.adapter import SDP
from problems.solvers.verified import VerifiedSolver

SOLVERS = ("clarabel", "qoco", "ecos", "piqp", "highs", "daqp", "scs", "qpalm")


def infeasible_program(rng, kind, rank, size):
    """Draw a program in which a row of a cone contradicts an inequality, or another equation."""
    cones = "linear" if kind in ("equation", "inequality") else kind
    problem, _, _ = random_program(rng, cones, rank=rank)
    A, b, zero = problem.A.toarray(), problem.b.copy(), problem.zero
    if kind == "equation":  # a combination of the others, moved
        mix = rng.normal(size=zero - 1)
        A[0], b[0] = mix @ A[1:zero], mix @ b[1:zero] + size
    else:  # an inequality, t of a cone or an entry of a diagonal, all at least 0, and at most −size
        cone = {"inequality": zero + 1, "second-order": problem.linear, "semidefinite": len(b) - 1}
        A[zero], b[zero] = -A[cone[kind]], -b[cone[kind]] - size
    return replace(problem, A=csc_array(A), b=b)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("kind", ["equation", "inequality", "second-order", "semidefinite"])
def test_each_solver_certifies_infeasible_programs_of_its_cones(rng, kind, name):
    for rank in (0, 0, 3):
        problem = infeasible_program(rng, kind, rank, 10.0 ** rng.uniform(-1, 1))
        if load_adapters()[name].refusal(problem):
            continue
        chosen = VerifiedSolver(name)
        with pytest.raises(Infeasible) as verdict:
            chosen(problem)
        assert chosen.fallback_count == 0, chosen.last_rejection
        assert verify_ray(problem, verdict.value.ray)[1] == ""


@pytest.mark.parametrize("kind", ["linear", "second-order", "semidefinite"])
def test_least_violation_is_zero_only_where_there_is_a_point(rng, kind):
    problem, _, _ = random_program(rng, kind)
    relaxed = relax_cones(problem)
    assert solve(relaxed, solve_clarabel).x[-1] == pytest.approx(0.0, abs=1e-6)
    # One equation of two sides, x = 1 and x = −1: both are violated by 1 at the least.
    twice = ConicProgram(np.zeros(1), csc_array(np.ones((2, 1))), np.array([1.0, -1.0]), 2, 0)
    found = solve(relax_cones(twice), solve_clarabel)
    assert found.x[-1] == pytest.approx(1.0, abs=1e-6)
    ray, objection = verify_ray(twice, read_ray(twice, found.y))
    assert objection == "" and ray == pytest.approx([-0.5, 0.5], abs=1e-6)


def test_duals_of_a_feasible_program_certify_nothing(rng):
    for kind in ("linear", "second-order", "semidefinite"):
        problem, _, _ = random_program(rng, kind)
        duals = solve(relax_cones(problem), solve_clarabel).y
        assert verify_ray(problem, read_ray(problem, duals))[1]


class Raising:
    """Raises an error in every solve."""

    def __init__(self, problem, tolerance):
        pass

    def solve(self, b):
        raise self.error


@pytest.fixture
def broken(monkeypatch):
    """Return a function that makes the solver "broken" raise an error."""

    def install(error):
        Raising.error = error
        adapter = SolverAdapter("broken", SDP, True, Raising, "math")
        known = load_adapters() | {"broken": adapter}
        for module in (solvers, verified):
            monkeypatch.setattr(module, "load_adapters", lambda: known)

    return install


@pytest.mark.parametrize("error", [RuntimeError("bad pivot"), ValueError("no"), OSError("disk")])
def test_an_exception_of_a_solver_is_a_rejected_answer(rng, broken, error):
    broken(error)
    chosen, (problem, _, _) = VerifiedSolver("broken"), random_program(rng)
    said = rf"Raising\.solve raised {type(error).__name__}: {error} \(test_phase_one\.py:\d+\)"
    with pytest.warns(UserWarning, match=rf"^{said}; the default solver answers in its place"):
        found = chosen(problem)
    np.testing.assert_array_equal(found.x, solve(problem, solve_clarabel).x)
    assert chosen.fallback_count == chosen.error_count == 1
    wanted = rf"broken: stopped \({said}\), without a point and its duals"
    assert re.fullmatch(wanted, chosen.last_rejection)
    unbounded = replace(problem, q=problem.q - 1e3 * np.ones(8), A=0 * problem.A, b=0 * problem.b)
    with pytest.raises(Unsolved, match=r"broken: stopped \(Raising.*; clarabel: stopped"):
        chosen(unbounded)


@pytest.mark.parametrize("error", [MemoryError(), KeyboardInterrupt()])
def test_lack_of_memory_and_interrupts_are_no_answers(rng, broken, error):
    broken(error)
    with pytest.raises(type(error)):
        VerifiedSolver("broken")(random_program(rng)[0])
