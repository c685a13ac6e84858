"""Transfers of least energy against references, and solvers on their programs."""

from dataclasses import replace
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems.avoidance import AvoidanceProblem, cost_unit
from problems.conic import ConicProgram, ConicSolution, Unsolved, verify
from problems.half_spaces import HalfSpaces
from problems.solvers import load_adapters
from problems.solvers.verified import solve_program
from problems.transfer import TransferProblem

REFERENCE_TOLERANCE = 1e-9
TOLERANCE = 1e-6  # asked of the solvers side by side, and of their answers
AGREEMENT = 1e-6  # of energies, relative
NEARBY_GOALS = 10


def transfer(rng: np.random.Generator, half_spaces: bool) -> dict[str, Any]:
    """Compare the energy with that of the statement that keeps the states, by two solvers.

    Args:
        rng: Generator of the transfer.
        half_spaces: Draw some that the optimum without them violates.
    """
    problem = _draw_problem(rng, half_spaces)
    own, asked = _record(problem)
    energy_kept, (stated,) = _record(problem, cvxpy=True)
    found: dict[str, Any] = {"solved": np.isfinite(own), "limit_active": bool(asked)}
    found["statement_solved"] = np.isfinite(energy_kept)  # by the default solver, to 1e-6
    for name in ("clarabel", "highs"):
        session = load_adapters()[name].open_session(stated, REFERENCE_TOLERANCE)
        verdict = verify(stated, session.solve(stated.b), 10 * REFERENCE_TOLERANCE)
        is_solved = verdict.kind == "solved" and verdict.solution is not None
        found[f"{name}_solved"] = is_solved
        if is_solved:
            error = abs(own / (stated.cost(verdict.solution.x) * cost_unit([problem])) - 1)
            found |= {f"{name}_error": error, f"{name}_agrees": error <= AGREEMENT}
    return found


def solve(rng: np.random.Generator, solver: str, half_spaces: bool) -> dict[str, Any]:
    """Give a solver the program without the states, and again with other goals near its own.

    Times have the set-up in the first solve alone. Where no limit is active, there is no program.
    """
    _, asked = _record(_draw_problem(rng, half_spaces))
    if not asked:
        return {}
    program, adapter = asked[-1], load_adapters()[solver]
    reference = solve_program(program)
    began = perf_counter()
    session = adapter.open_session(program, TOLERANCE)
    result = session.solve(program.b)
    first = perf_counter() - began
    verdict = verify(program, result, TOLERANCE)
    cells: dict[str, Any] = {"accepted": verdict.kind == "solved", "first_ms": 1e3 * first}
    if verdict.kind == "solved" and verdict.solution is not None:
        cells["energy_error"] = abs(
            program.cost(verdict.solution.x) / program.cost(reference.x) - 1
        )
    times, accepted = [], 0
    for _ in range(NEARBY_GOALS):
        b = program.b.copy()
        b[: program.zero] *= 1 + rng.normal(0, 1e-3, program.zero)
        began = perf_counter()
        result = session.solve(b)
        times.append(perf_counter() - began)
        accepted += verify(replace(program, b=b), result, TOLERANCE).kind == "solved"
    return cells | {"nearby_ms": 1e3 * median(times), "nearby_accepted": accepted / NEARBY_GOALS}


def _record(problem: AvoidanceProblem, cvxpy: bool = False) -> tuple[float, list[ConicProgram]]:
    """Return the energy, NaN where it is not solved, and the programs of the default solver."""
    asked: list[ConicProgram] = []

    def note(program: ConicProgram) -> ConicSolution:
        asked.append(program)
        return solve_program(program)

    noted = replace(problem, solver=note)
    try:
        found = noted.solve_cvxpy() if cvxpy else noted.solve()
    except Unsolved:
        return np.nan, asked
    return float(problem.transfer.cost(found.trajectory)), asked


def _draw_problem(rng: np.random.Generator, has_half_spaces: bool) -> AvoidanceProblem:
    """Draw a transfer that controls below the limit fly."""
    T, d = int(rng.integers(20, 61)), int(rng.integers(2, 4))
    model: DiscreteModel = discretize_zoh(DoubleIntegrator(d), 1.0, T)
    U = 0.1
    if rng.random() < 1 / 3:
        model, U, d = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, T), 1e-3, 3
    transfer = TransferProblem(model, U, objective="energy")
    start = np.concatenate([rng.normal(0, 5, d), rng.normal(0, 0.1, d)])
    push = rng.choice([-1.0, 1.0], d) * U * rng.uniform(0.3, 0.95)
    u = np.where(np.arange(T)[:, None] < T / 2, push, -push) + rng.normal(0, U / 50, (T, d))
    flown = transfer.simulate(start, np.clip(u, -U, U))
    goal = flown.x[-1]
    rows = int(rng.integers(1, 9)) if has_half_spaces else 0
    step, on_state = rng.integers(1, T, rows), np.zeros((rows, 2 * d))
    on_state[:, :d] = rng.normal(size=(rows, d))
    # Half of the way from what is cheapest to what is flown stays open.
    (free,), _, _ = transfer.solve_without_limits(start, goal[None])
    values = [(on_state * x[step]).sum(axis=1) for x in (free, flown.x)]
    on_state *= np.sign(values[1] - values[0])[:, None]
    rhs = (on_state * (free + flown.x)[step] / 2).sum(axis=1)
    spaces = HalfSpaces(step, on_state, np.zeros((rows, d)), rhs)
    return AvoidanceProblem(transfer, start, goal, spaces)
