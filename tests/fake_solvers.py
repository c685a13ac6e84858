"""Fake solvers for tests: honest, wrong, crashing, hanging and printing ones."""

import multiprocessing
import os
import threading
from dataclasses import replace
from typing import ClassVar

import numpy as np

from problems.conic import ConicProgram, SolverResult
from problems.solvers.adapter import SolverAdapter


class Honest:
    """Minimizes a positive cost over x ≥ lower, whose optimum is x = lower."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        self.problem = problem

    def solve(self, b: np.ndarray) -> SolverResult:
        return SolverResult("solved", "done", -b, self.problem.q.copy(), 7)


class Wrong(Honest):
    """Returns an infeasible point as a solution."""

    def solve(self, b):
        return SolverResult("solved", "trust me", 0.1 - b, self.problem.q)


class Pessimist(Honest):
    """Claims infeasibility without a proof."""

    def solve(self, b):
        return SolverResult("infeasible", "there is none")


class Raising(Honest):
    """Raises an exception."""

    def solve(self, b):
        raise ValueError("no idea")


class Printing(Honest):
    """Prints to the file descriptors."""

    def solve(self, b):
        os.write(1, b"hello\n")
        os.write(2, b"hello\n")
        return super().solve(b)


class Constant(Honest):
    """Returns the answer to the first right-hand side to all others."""

    def solve(self, b):
        return super().solve(self.problem.b)


class CrashingAt10(Honest):
    """Aborts its process where b₀ is 10, and counts its solves before."""

    solved: ClassVar = 0

    def solve(self, b):
        if b[0] == 10:
            os.abort()
        CrashingAt10.solved += 1
        return super().solve(b)._replace(iterations=CrashingAt10.solved)


class HangingAt10(Honest):
    """Never returns where b₀ is 10."""

    def solve(self, b):
        if b[0] == 10:
            threading.Event().wait()
        return super().solve(b)


def unsupported_in_worker(problem: ConicProgram) -> str:
    """Refuse every problem in a worker process."""
    return "looks twice" if multiprocessing.parent_process() else ""


def fake_solver(name: str) -> SolverAdapter:
    """Return the adapter of a fake solver, which looks only once whether it is supported."""
    kinds = Honest, Wrong, Pessimist, Raising, Printing, Constant, CrashingAt10, HangingAt10
    [factory] = [kind for kind in kinds if kind.__name__.lower() == name]
    adapter = SolverAdapter(name, frozenset({"linear"}), True, factory, "numpy")
    return replace(adapter, unsupported_reason=unsupported_in_worker)
