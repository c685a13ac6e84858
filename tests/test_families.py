"""Recorded families of programs: their solutions are recomputed."""

import runpy
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import DoubleIntegrator, discretize_zoh
from problems import gain_sdp
from problems.avoidance import AvoidanceProblem
from problems.conic import ConicSolution, Infeasible, solve, verify_ray
from problems.desired_formation import DesiredFormation
from problems.families import SIZES, list_families, load_family
from problems.gain_problem import GainProblem
from problems.solvers import solve_clarabel
from problems.transfer import TransferProblem

NAMES = (
    "avoidance-20 avoidance-5 avoidance-energy gain-sdp infeasible j2 near-infeasible "
    "transfer-energy transfer-lp transfer-socp"
).split()
ALL = [(name, size) for name in list_families() for size in SIZES]
FINE = 1e-9  # of residuals and gaps, relative
ALIKE = 1e-6  # largest difference of two solvers, one of them less exact


@pytest.fixture(scope="module")
def maker():
    return runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "problem_families.py"))


def test_every_family_has_every_size_in_ascending_order():
    assert list_families() == NAMES
    for name in NAMES:
        unknowns = [len(load_family(name, size).instances[0].problem.q) for size in SIZES]
        assert unknowns == sorted(set(unknowns))


@pytest.mark.parametrize(("name", "size"), ALL)
def test_solutions_are_optima_or_certificates_of_infeasibility(name, size):
    for instance in load_family(name, size).instances:
        assert instance.is_feasible == (name != "infeasible")
        if instance.is_feasible:
            answer = ConicSolution.evaluate(instance.problem, instance.x, instance.y)
            assert answer.max_residual <= FINE
            cost = instance.problem.cost(instance.x)
            assert cost == pytest.approx(instance.reference_cost, rel=1e-15, abs=1e-15)
            assert 0 <= instance.reference_gap <= ALIKE
        else:
            y, doubt = verify_ray(instance.problem, instance.y)
            assert not doubt
            assert_allclose(y, instance.y, rtol=1e-9, atol=1e-12)
            assert np.isnan(instance.reference_cost)


@pytest.mark.parametrize("name", list_families())
def test_cost_errors_are_within_what_duality_allows(rng, name):
    # Optima with random errors in all directions.
    for instance in load_family(name, "small").instances:
        problem = instance.problem
        for _ in range(5 if instance.is_feasible else 0):
            x = instance.x + 1e-3 * rng.normal(size=len(instance.x))
            y = instance.y + 1e-3 * rng.normal(size=len(instance.y))
            worst = ConicSolution.evaluate(problem, x, y).max_residual
            error = abs(problem.cost(x) - instance.reference_cost)
            assert error <= instance.cost_tolerance(worst)
            assert instance.cost_tolerance(worst / 100) < instance.cost_tolerance(worst)


@pytest.mark.parametrize("size", SIZES)
def test_speed_limits_are_active_but_not_everywhere(size):
    for instance in load_family("transfer-socp", size).instances:
        problem = instance.problem
        room = (problem.b - problem.A @ instance.x)[problem.zero + problem.nonnegative :]
        room = room.reshape(len(problem.soc_sizes), -1)
        slack = room[:, 0] - np.linalg.norm(room[:, 1:], axis=1)
        assert slack.min() < 1e-6 < slack.max()


@pytest.mark.parametrize("size", SIZES)
def test_avoidance_programs_have_an_active_half_space(size):
    # Rows are the arrival, the half-spaces, and the box: two rows for each unknown.
    names = ("5", "20", "energy")
    for instance in sum((load_family(f"avoidance-{name}", size).instances for name in names), ()):
        problem = instance.problem
        assert np.abs(instance.y[problem.zero : -2 * len(problem.q)]).max() > 1e-6


@pytest.mark.parametrize("size", SIZES)
def test_infeasible_targets_are_just_beyond_the_near_infeasible(size):
    near = [instance.problem for instance in load_family("near-infeasible", size).instances]
    beyond = [instance.problem for instance in load_family("infeasible", size).instances]
    beyond = [problem for problem in beyond if problem.A.shape == near[0].A.shape]
    assert len(beyond) == 5
    for here, there in zip(near[:5], beyond, strict=True):
        assert abs(here.A - there.A).max() == 0
        goal, farther = here.b[: here.zero], there.b[: there.zero]
        assert_allclose(farther, 1.001**2 * goal, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("name", "size"), ALL)
def test_programs_that_differ_in_b_alone_share_their_matrix(name, size):
    problems = [instance.problem for instance in load_family(name, size).instances]
    met = []
    for problem in problems:
        if not met or problem.A is not met[-1].A:
            assert all(problem.A is not other.A for other in met)
            met.append(problem)
        assert problem.q is met[-1].q
        assert problem.P is met[-1].P
    asked = {(problem.A.data.tobytes(), problem.b.tobytes()) for problem in problems}
    assert len(asked) == len(problems)


def test_unknown_families_are_refused_with_the_known_ones():
    with pytest.raises(ValueError, match=r'no family "transfer".* transfer-lp'):
        load_family("transfer", "small")
    with pytest.raises(ValueError, match='size: must be "small", "medium" or "large", got "tiny"'):
        load_family("transfer-lp", "tiny")


def test_families_are_small_enough_to_ship():
    files_of_families = files("problems.families").iterdir()
    sizes = [len(file.read_bytes()) for file in files_of_families if file.name.endswith(".npz")]
    assert max(sizes) < 200e3
    assert sum(sizes) < 3e6


def test_a_family_drawn_again_is_the_same(maker):
    drawn, again = (maker["FAMILIES"]["gain-sdp"]("small") for _ in range(2))
    frozen = load_family("gain-sdp", "small")
    assert (maker["SEED"], drawn.source) == (frozen.seed, frozen.source)
    for one, other, known in zip(drawn.problems, again.problems, frozen.instances, strict=True):
        assert np.array_equal(one.A.data, other.A.data) and np.array_equal(one.b, other.b)
        # Another machine may choose another basis, which is rounded in another way.
        assert one.q @ solve(one, solve_clarabel).x == pytest.approx(known.reference_cost, abs=1e-6)


def test_targets_are_moved_to_the_edge_of_reach(maker):
    transfer = TransferProblem(discretize_zoh(DoubleIntegrator(2), 1.0, 10), max_control=0.1)
    with maker["record_problems"]() as asked:
        AvoidanceProblem.alone(transfer, np.zeros(4), np.array([1.0, 0.5, 0, 0])).solve()
    (problem,) = asked
    # At full thrust for five steps and against it for five: U T² / 4 = 2.5 m on the first axis.
    assert_allclose(
        maker["move_target"](problem, 1.0).b[:4], 2.5 * problem.b[:4], rtol=1e-9, atol=1e-12
    )
    assert solve(maker["move_target"](problem, 0.999), solve_clarabel).max_residual < 1e-6
    with pytest.raises(Infeasible):
        solve(maker["move_target"](problem, 1.001), solve_clarabel)


def test_the_gain_program_has_the_convergence_rate_of_the_statement(rng, maker):
    graph = ~np.eye(6, dtype=bool)
    graph[0, 3] = graph[3, 0] = False
    question = GainProblem.from_formation(DesiredFormation(rng.uniform(0, 5, (6, 3)), graph), "xy")
    rate = solve(maker["gain_sdp_problem"](question), solve_clarabel).x[-1]
    stated = question.convergence_rate(gain_sdp.solve(question).L)
    assert rate == pytest.approx(stated, abs=1e-6)
