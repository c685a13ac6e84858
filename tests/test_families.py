"""Frozen questions: their answers are recomputed, not believed."""

import numpy as np
import pytest

from problems.conic import Answer, proof
from problems.families import Family, families, family

ALL = [(name, size) for name, sizes in families().items() for size in sizes]
FINE = 1e-9  # of residuals and gaps, relative
ALIKE = 1e-6  # by which two solvers may differ where one of them is less exact


@pytest.mark.parametrize(("name", "size"), ALL)
def test_an_answer_is_an_optimum_or_a_proof_that_there_is_none(name, size):
    for instance in family(name, size).instances:
        if instance.feasible:
            answer = Answer.of(instance.problem, instance.x, instance.y)
            assert answer.worst <= FINE
            assert instance.problem.q @ instance.x == pytest.approx(instance.reference, abs=1e-15)
            assert 0 <= instance.agreed <= ALIKE
        else:
            y, doubt = proof(instance.problem, instance.y)
            assert not doubt
            np.testing.assert_allclose(y, instance.y, rtol=1e-9)
            assert np.isnan(instance.reference)


@pytest.mark.parametrize("name", families())
def test_a_larger_size_is_larger(name):
    unknowns = [len(family(name, size).instances[0].problem.q) for size in families()[name]]
    assert families()[name] == ("small", "medium", "large")
    assert unknowns == sorted(set(unknowns))


@pytest.mark.parametrize(("name", "size"), ALL)
def test_who_differ_in_b_alone_share_the_rest_and_follow_each_other(name, size):
    problems = [instance.problem for instance in family(name, size).instances]
    met = []
    for problem in problems:
        if not met or problem.A is not met[-1].A:
            assert all(problem.A is not other.A for other in met)
            met.append(problem)
        assert problem.q is met[-1].q
    assert len({problem.b.tobytes() for problem in problems}) == len(problems)


def test_what_there_is_not_is_refused_with_what_there_is():
    with pytest.raises(ValueError, match=r'no family "transfer".* transfer-lp'):
        family("transfer", "small")
    with pytest.raises(ValueError, match='no size "tiny"; it has small, medium, large'):
        family("transfer-lp", "tiny")


def test_a_family_that_asks_nothing_is_refused():
    with pytest.raises(ValueError, match="empty: it needs at least one instance"):
        Family("transfer-lp", "small", 1, "nowhere", (), ())
