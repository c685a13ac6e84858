"""Graphs, formations and gain problems for the tests of gains and rigidity."""

import numpy as np

from problems.desired_formation import DesiredFormation
from problems.gain_problem import GainProblem
from problems.rigidity import is_rigid


def graph_of(n, pairs):
    graph = np.zeros((n, n), dtype=bool)
    for i, j in pairs:
        graph[i, j] = graph[j, i] = True
    return graph


def complete(n):
    return ~np.eye(n, dtype=bool)


def ring(n):
    return graph_of(n, [(i, (i + 1) % n) for i in range(n)])


def joined_parts(*parts):
    """A graph of complete parts that share vertices."""
    n = max(map(max, parts)) + 1
    graph = np.zeros((n, n), dtype=bool)
    for part in parts:
        graph[np.ix_(part, part)] = True
    return graph & complete(n)


def random_graph(rng, n, share):
    upper = np.triu(rng.random((n, n)) < share, 1)
    return upper | upper.T


def rigid_graph(rng, n, share):
    while True:
        graph = random_graph(rng, n, share)
        if is_rigid(graph, 2, rng):
            return graph


def random_formation(rng, n, share):
    """A formation on a random graph that contains a ring."""
    graph = random_graph(rng, n, share) | ring(n)
    return DesiredFormation(rng.uniform(0, 1, (n, 3)) * [15, 15, 2], graph)


def pyramid():
    """A pyramid with one edge fewer than a rigid graph has, even in the plane."""
    angle = 2 * np.pi * np.arange(5) / 5
    base = np.stack([2 * np.cos(angle), 2 * np.sin(angle), 0 * angle], axis=1)
    edges = [(0, 2), (0, 3), (0, 5), (1, 2), (1, 5), (2, 3), (3, 4), (4, 5)]
    return DesiredFormation(np.vstack([[0, 0, 1.7], base]), graph_of(6, edges), "pyramid")


def problems_of(formation):
    return GainProblem.from_formation(formation, "xy"), GainProblem.from_formation(formation, "z")


def assert_satisfies_equations(problem, L):
    assert np.abs(L - L.conj().T).max() <= 1e-12
    assert np.abs(L @ problem.kernel).max() <= 1e-12
    assert np.abs(L[~problem.graph & complete(len(L))]).max(initial=0) <= 1e-12
    assert abs(np.trace(L).real - problem.m) <= 1e-9 * problem.m
