"""Communication graphs for tests."""

import numpy as np

from sato.network.graph import CommunicationGraph


def graph_of(adjacency, alive=None):
    """Graph of these edges, in both directions, among the agents that are alive."""
    alive = np.ones(len(adjacency), dtype=bool) if alive is None else alive
    return CommunicationGraph((adjacency | adjacency.T) & alive & alive[:, None], alive)


def complete(agents):
    return graph_of(~np.eye(agents, dtype=bool))


def empty(agents):
    return graph_of(np.zeros((agents, agents), dtype=bool))


def line(agents):
    return graph_of(np.eye(agents, k=1, dtype=bool))


def ring(agents):
    return graph_of(np.roll(np.eye(agents, dtype=bool), 1, axis=1)) if agents > 2 else line(agents)


def random_graph(rng, agents, share, alive=1.0):
    live = rng.random(agents) < alive
    return graph_of(np.triu(rng.random((agents, agents)) < share, 1), live)


def two_components(first, second):
    """Graph of two complete components."""
    adjacency = np.zeros((first + second, first + second), dtype=bool)
    adjacency[:first, :first] = adjacency[first:, first:] = True
    np.fill_diagonal(adjacency, False)
    return graph_of(adjacency)
