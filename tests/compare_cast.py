"""Solvers as there are none, for tests: those that lie, crash, hang and chatter."""

import os
import threading

import numpy as np

from problems.conic import Conic
from problems.solvers.adapter import Adapter, Claim


class Honest:
    """Minimises a positive cost over x ≥ lower, which anybody can."""

    def __init__(self, problem: Conic, tolerance: float) -> None:
        self.problem = problem

    def solve(self, b: np.ndarray) -> Claim:
        return Claim("solved", "done", -b, self.problem.q.copy(), 7)


class Liar(Honest):
    """Its point is none."""

    def solve(self, b):
        return Claim("solved", "trust me", 0.1 - b, self.problem.q)


class Prophet(Honest):
    """Says that there is none."""

    def solve(self, b):
        return Claim("infeasible", "there is none")


class Crasher(Honest):
    """Takes its process with it."""

    def solve(self, b):
        os.abort()


class Raiser(Honest):
    """Gives up."""

    def solve(self, b):
        raise ValueError("no idea")


class Sleeper(Honest):
    """Never answers."""

    def solve(self, b):
        threading.Event().wait()


class Chatterer(Honest):
    """Prints where nobody can divert it from within Python."""

    def solve(self, b):
        os.write(1, b"hello\n")
        os.write(2, b"hello\n")
        return super().solve(b)


class Glutton(Honest):
    """Keeps 64 MiB."""

    def solve(self, b):
        self.larder = np.ones(2**23)
        return super().solve(b)


class Forgetful(Honest):
    """Answers the first question for ever."""

    def solve(self, b):
        return super().solve(self.problem.b)


def cast() -> dict[str, Adapter]:
    """Solvers as there are none, found by both processes."""
    some = (Honest, Liar, Prophet, Crasher, Raiser, Sleeper, Chatterer, Glutton, Forgetful)
    return {
        kind.__name__.lower(): Adapter(
            kind.__name__.lower(), frozenset({"linear"}), True, "numpy", "numpy", kind
        )
        for kind in some
    }
