"""Python interface to the exported C, and random instances of its problem, for tests of it."""

import ctypes
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.convexify import choose_normals, convexify
from problems.half_spaces import HalfSpaces
from problems.path_separation import are_hulls_separated
from sato.onboard.problem import OnboardProblem

LIBRARY = "libsato_onboard.so"
SOLVED, UNSOLVED, INVALID_INPUT = 0, 1, 2  # as in sato_onboard.h


class OnboardSolution(NamedTuple):
    """Solution of the C code; see sato_flight in sato_onboard.h."""

    code: int
    u: Float[Array, "T m"]  # [m/s²]
    fuel: float  # [m/s]
    cost: float  # [m/s]
    position_error: float  # [m]
    velocity_error: float  # [m/s]
    half_space_violation: float  # in the unit of its right-hand side
    speed_violation: float  # [m/s]
    residual: float  # relative


SOLUTION_FIELDS = OnboardSolution._fields[2:]  # the scalars of sato_flight, which follow u


class CompiledSolver:
    """Solver in a folder of `export_c`, compiled with `make`; it takes one call at a time."""

    def __init__(self, folder: str | Path) -> None:
        """Compile the code where that was not done yet, and load it; say why it cannot be."""
        made = subprocess.run(["make", "-s"], cwd=folder, capture_output=True, text=True)
        if made.returncode != 0:
            raise ValueError(f"{folder}: does not compile: {made.stderr}")
        self._solve = ctypes.CDLL(str(Path(folder, LIBRARY).resolve())).sato_solve
        header = Path(folder, "sato_model.h").read_text(encoding="utf-8")
        defined = dict(re.findall(r"#define SATO_(\w+) (\S+) ", header))
        n, m, T = (int(defined[name]) for name in ("STATE", "AXES", "STEPS"))
        row = [("step", "i4"), ("on_state", "f8", n), ("on_control", "f8", m), ("least", "f8")]
        self._row = np.dtype(row, align=True)
        self._answer = np.dtype([("u", "f8", (T, m)), *((name, "f8") for name in SOLUTION_FIELDS)])

    def solve(
        self, start: Float[Array, " n"], target: Float[Array, " n"], half_spaces: HalfSpaces
    ) -> OnboardSolution:
        """Solve for a transfer from start to target among half-spaces."""
        count = len(half_spaces.rhs)
        rows = np.zeros(max(count, 1), self._row)
        for name, column in zip(self._row.names or (), half_spaces, strict=True):
            rows[name][:count] = column
        answer = np.zeros((), self._answer)
        ends = [np.ascontiguousarray(state, dtype=float) for state in (start, target)]
        code = self._solve(*map(_pointer, (*ends, rows)), count, _pointer(answer))
        scalars = (float(answer[name]) for name in SOLUTION_FIELDS)
        return OnboardSolution(code, np.array(answer["u"]), *scalars)


def _pointer(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def random_instances(
    problem: OnboardProblem, rng: np.random.Generator
) -> Iterator[tuple[Array, Array, HalfSpaces]]:
    """Generate start, target and half-spaces of feasible instances, without end.

    A trajectory under random controls defines start and target, and the half-spaces are those
    between it and its neighbors, so that it is feasible. It is far from optimal, so that some of
    the half-spaces bind at the optimum.
    """
    horizon, T = problem.horizon, len(problem.program.transfer.model)
    while True:
        x, u = _random_transfer(problem, rng)
        nominal = horizon.control_points(x, u)
        others = [_pass_closely(problem, nominal, rng) for _ in range(problem.neighbors)]
        normal = choose_normals(nominal - np.stack(others), horizon.required_separation)
        yield x[0], x[-1], convexify(horizon, T, np.stack(others), normal)


def _random_transfer(problem: OnboardProblem, rng: np.random.Generator) -> tuple[Array, Array]:
    transfer = problem.program.transfer
    model, limit = transfer.model, transfer.max_speed
    T, d, R = len(model), model.axes, problem.horizon.clearance
    u = transfer.max_control * rng.uniform(-1, 1, (T, d))
    speed = min(limit, transfer.max_control * T * model.dt) / 4
    start = np.concatenate([rng.normal(0, 5 * R, d), rng.normal(0, speed, d)])
    x = model.simulate(start, u)
    # Without drift the motion is linear: speeds scale with the start and the control.
    scale = min(1.0, float(limit / np.linalg.norm(x[:, d:], axis=1).max()))
    return model.simulate(scale * start, scale * u), scale * u


def _pass_closely(
    problem: OnboardProblem, nominal: Float[Array, "pieces 4 d"], rng: np.random.Generator
) -> Float[Array, "pieces 4 d"]:
    """Draw the control points of a neighbor that comes near a trajectory."""
    other = problem.horizon.control_points(*_random_transfer(problem, rng))
    meet = int(rng.integers(len(other)))
    direction = rng.standard_normal(other.shape[-1:])
    direction /= np.linalg.norm(direction)
    distance = float(problem.horizon.clearance * rng.uniform(1, 1.5))
    while True:
        shifted = other - other[meet, 0] + nominal[meet, 0] + distance * direction
        if are_hulls_separated(nominal - shifted, problem.horizon.required_separation).all():
            return np.asarray(shifted)
        distance *= 1.2
