"""Solvers as there are none, for tests: those that lie, crash, hang and chatter."""

import multiprocessing
import os
import threading
from dataclasses import replace
from typing import ClassVar

import numpy as np

from problems.conic import ConicProgram, SolverResult
from problems.solvers.adapter import SolverAdapter


class Honest:
    """Minimises a positive cost over x ≥ lower, which anybody can."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        self.problem = problem

    def solve(self, b: np.ndarray) -> SolverResult:
        return SolverResult("solved", "done", -b, self.problem.q.copy(), 7)


class Liar(Honest):
    """Its point is none."""

    def solve(self, b):
        return SolverResult("solved", "trust me", 0.1 - b, self.problem.q)


class Prophet(Honest):
    """Says that there is none."""

    def solve(self, b):
        return SolverResult("infeasible", "there is none")


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


class Faint(Honest):
    """Takes its process with it where it is given 10, and counts what it solved before that."""

    solved: ClassVar = 0

    def solve(self, b):
        if b[0] == 10:
            os.abort()
        Faint.solved += 1
        return super().solve(b)._replace(iterations=Faint.solved)


class Dozer(Honest):
    """Never answers where it is given 10."""

    def solve(self, b):
        if b[0] == 10:
            threading.Event().wait()
        return super().solve(b)


class Fussy(Honest):
    """Looks at what it is given in planning, and nowhere else."""


def fussy(problem: ConicProgram) -> str:
    """Refuse everything in a process of a solver."""
    return "looks twice" if multiprocessing.parent_process() else ""


def cast() -> dict[str, SolverAdapter]:
    """Solvers as there are none, found by both processes."""
    some = (Honest, Liar, Prophet, Crasher, Raiser, Sleeper, Chatterer, Glutton, Forgetful)
    found = {
        kind.__name__.lower(): SolverAdapter(
            kind.__name__.lower(), frozenset({"linear"}), True, kind, "numpy"
        )
        for kind in (*some, Faint, Dozer, Fussy)
    }
    return found | {"fussy": replace(found["fussy"], unsupported_reason=fussy)}
