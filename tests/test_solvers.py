"""Every installed adapter, on programs with known optima."""

from dataclasses import replace

import numpy as np
import pytest
from random_programs import infeasible_program, random_program
from scipy.linalg import null_space
from scipy.sparse import csc_array

from dynamics.errors import InputError
from problems.conic import ConicProgram, verify
from problems.solvers import SolverAdapter, load_adapters
from problems.solvers.adapter import LP, accept_all

ADAPTERS = load_adapters()
# Adapters for programs of one special form are tested in test_solver_traps.
INSTALLED = sorted(
    name
    for name, adapter in ADAPTERS.items()
    if adapter.is_installed and adapter.unsupported_reason is accept_all
)
KINDS = ("linear", "second-order", "semidefinite")
UNBOUNDED = ConicProgram(np.ones(1), csc_array([[1.0]]), np.zeros(1), 0, 1)


def most_general_program(rng, name, rank=0):
    """Draw a program with all the cones that a solver supports."""
    kind = [kind for kind in KINDS if kind in ADAPTERS[name].cone_types][-1]
    return random_program(rng, kind, rank=rank)


def open_session(name, problem):
    return ADAPTERS[name].open_session(problem, 1e-6)


@pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, name) for kind in KINDS for name in INSTALLED if kind in ADAPTERS[name].cone_types],
)
def test_every_solver_finds_the_known_optimum(rng, kind, name):
    for _ in range(5):
        problem, x, _ = random_program(rng, kind)
        verdict = verify(problem, open_session(name, problem).solve(problem.b), 1e-6)
        assert verdict.kind == "solved", verdict.reason
        assert problem.q @ verdict.solution.x == pytest.approx(problem.q @ x, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("rank", [3, 8])
@pytest.mark.parametrize("name", [n for n in INSTALLED if ADAPTERS[n].takes_quadratic_cost])
def test_quadratic_costs_are_solved_for_every_right_hand_side(rng, name, rank):
    problem, x, _ = most_general_program(rng, name, rank)
    session, b = open_session(name, problem), problem.b.copy()
    for _ in range(3):
        verdict = verify(replace(problem, b=b), session.solve(b), 1e-6)
        assert verdict.kind == "solved", verdict.reason
        assert problem.cost(verdict.solution.x) == pytest.approx(problem.cost(x), rel=1e-4)
        # Another right-hand side with the same duals and the same P x.
        move = null_space(problem.hessian.toarray()) @ rng.normal(size=8 - rank)
        x, b = x + move, b + problem.A @ move


@pytest.mark.parametrize("name", [n for n in INSTALLED if not ADAPTERS[n].takes_quadratic_cost])
def test_a_quadratic_cost_is_refused_by_solvers_of_linear_ones(rng, name):
    problem, _, _ = random_program(rng, rank=3)
    with pytest.raises(ValueError, match=f"{name} cannot take a quadratic cost; .*clarabel.* can"):
        open_session(name, problem)


@pytest.mark.parametrize("name", INSTALLED)
def test_sessions_solve_later_right_hand_sides_alike(rng, name):
    problem, x, y = most_general_program(rng, name)
    session, b = open_session(name, problem), problem.b.copy()
    for _ in range(4):
        verdict = verify(replace(problem, b=b), session.solve(b), 1e-6)
        assert verdict.kind == "solved", verdict.reason
        assert -b @ y == pytest.approx(problem.q @ verdict.solution.x, rel=1e-4, abs=1e-4)
        b += problem.A @ rng.normal(size=len(x))  # the same program, translated; the same array


@pytest.mark.parametrize("name", [n for n in INSTALLED if ADAPTERS[n].certifies_infeasibility])
def test_promised_certificates_of_infeasibility_hold(rng, name):
    problem = infeasible_program(rng)
    verdict = verify(problem, open_session(name, problem).solve(problem.b), 1e-6)
    assert verdict.kind == "infeasible", verdict.reason


@pytest.mark.parametrize("name", [n for n in INSTALLED if not ADAPTERS[n].refusal(UNBOUNDED)])
def test_an_unbounded_program_is_neither_solved_nor_infeasible(name):
    result = open_session(name, UNBOUNDED).solve(UNBOUNDED.b)
    assert result.status != "infeasible", result.message
    assert verify(UNBOUNDED, result, 1e-6).kind in ("failed", "wrong claim")


def test_a_missing_solver_is_refused_with_its_pip_package(rng):
    absent = SolverAdapter("absent", LP, False, lambda problem, tolerance: problem, "absent_")
    with pytest.raises(ValueError, match=r"absent is not installed; pip install absent_ would do"):
        absent.open_session(UNBOUNDED, 1e-6)


def test_unsupported_cones_are_refused(rng):
    problem, _, _ = random_program(rng, "second-order")
    with pytest.raises(ValueError, match=r"highs cannot take second-order cones; .*clarabel.* can"):
        open_session("highs", problem)


def test_sessions_refuse_other_right_hand_sides_and_tolerances(rng):
    problem, _, _ = random_program(rng, "linear")
    for adapter in load_adapters().values():
        if adapter.refusal(problem):
            continue
        session = adapter.open_session(problem, 1e-8)
        for b in (problem.b[:-1], np.append(problem.b, 0.0)):
            with pytest.raises(InputError, match=f"b: must have {len(problem.b)} entries"):
                session.solve(b)
        with pytest.raises(InputError, match=r"tolerance: must be .* above 0 and below 1"):
            adapter.open_session(problem, 1e3)
