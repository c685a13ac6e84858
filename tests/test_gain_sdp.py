"""Formation gains by semidefinite programming: optimality, proofs and the other methods."""

import numpy as np
import pytest
from gain_examples import (
    assert_satisfies_equations,
    complete,
    graph_of,
    problems_of,
    rigid_graph,
    ring,
)

from problems.desired_formation import DesiredFormation
from problems.gain_design import NoStabilizingGain, design_gains
from problems.gain_problem import GainProblem
from problems.gain_sdp import solve
from problems.rigidity import is_rigid


@pytest.mark.parametrize(("n", "share"), [(5, 0.8), (8, 0.6), (10, 0.5)])
def test_the_rate_equals_the_bound_of_the_dual_variables(rng, n, share):
    formation = DesiredFormation(rng.uniform(0, 5, (n, 3)), rigid_graph(rng, n, share))
    for problem in problems_of(formation):
        L, Y = solve(problem)
        assert_satisfies_equations(problem, L)
        assert problem.convergence_rate(L) == pytest.approx(problem.rate_bound(Y), abs=1e-6)
        assert np.array_equal(Y, Y.conj().T)
        assert not Y[problem.graph | ~complete(n)].any()


def test_rates_do_not_depend_on_numbering_rotation_or_scale(rng):
    graph = rigid_graph(rng, 7, 0.6)
    points, order = rng.uniform(0, 5, (7, 3)), rng.permutation(7)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, -2]])
    there = DesiredFormation((3 * points @ turn.T + [7, -9, 1])[order], graph[np.ix_(order, order)])
    here = problems_of(DesiredFormation(points, graph))
    for one, other in zip(here, problems_of(there), strict=True):
        rates = [problem.convergence_rate(solve(problem)[0]) for problem in (one, other)]
        assert rates[0] == pytest.approx(rates[1], abs=1e-6)


def test_a_flat_square_has_the_vertical_rate_three_quarters():
    # A flat square without diagonals leaves two vertical weights; the best ones are equal:
    # the eigenvalues 0, 2w, 2w, 4w with sum 3.
    square = np.array([[0.0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    formation = DesiredFormation(square, ring(4))
    problem = GainProblem(formation.kernel_z, formation.graph)
    assert problem.convergence_rate(solve(problem)[0]) == pytest.approx(3 / 4, abs=1e-7)


def test_a_rigid_bipartite_graph_of_two_levels_has_no_gains(rng):
    storeys = graph_of(6, [(i, j) for i in range(3) for j in range(3, 6)])
    points = rng.uniform(0, 1, (6, 3)) + np.outer([0, 0, 0, 1, 1, 1], [0, 0, 2])
    formation = DesiredFormation(points, storeys)
    assert is_rigid(storeys, 2, rng)
    _, z = problems_of(formation)
    L, Y = solve(z)
    assert z.convergence_rate(L) < 0
    assert z.rate_bound(Y) < 0
    with pytest.raises(NoStabilizingGain, match="by proof"):
        design_gains(formation)


def test_designed_gains_reach_the_optimal_rate(rng):
    found = 0
    for n in (5, 6, 8, 9, 10):
        formation = DesiredFormation(rng.uniform(0, 5, (n, 3)), rigid_graph(rng, n, 0.55))
        best = [problem.convergence_rate(solve(problem)[0]) for problem in problems_of(formation)]
        if min(best) <= 1e-6:
            with pytest.raises(NoStabilizingGain):
                design_gains(formation)
            continue
        found += 1
        gains = design_gains(formation)
        assert [gains.rate_xy, gains.rate_z] == pytest.approx(best, abs=5e-4)
        assert gains.bound_xy >= best[0] - 1e-7 and gains.bound_z >= best[1] - 1e-7
    assert found >= 3
