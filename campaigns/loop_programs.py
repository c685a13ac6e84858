"""Solvers on the programs of a run, by the same code as the loop."""

from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np

import sato
from problems.conic import TOLERANCE, ConicProgram, Infeasible, SolverResult
from problems.solvers import load_adapters, solve_clarabel
from problems.solvers.verified import VerifiedSolver, solve_program

PATIENCE = 0.5  # a solver that takes longer gets no further program [s]
MOST = 200  # programs of a run, evenly chosen
AGREEMENT = 1e-5  # of the objective, relative


def solve(
    _: np.random.Generator,
    scenario: str,
    overrides: list[str],
    objective: str,
    speed_norm: str,
    solver: str,
) -> dict[str, Any]:
    """Give a solver those programs of a run, seed 0, that it takes; at 1e-8, verified at 1e-6.

    Args:
        scenario: Scenario that the default solver flies.
        overrides: Further keys of it.
        objective: "fuel" or "energy".
        speed_norm: "2", or "inf", with which the cones are linear.
        solver: Solver, with a new session a program.
    """
    # A box of speeds has corners beyond the limit.
    keys = [f"plan.objective={objective}", "plan.allow_undetectable=true"]
    programs = _record([*overrides, *keys, f"model.speed_norm={speed_norm}"], scenario)
    programs = programs[:: max(1, -(-len(programs) // MOST))]
    taken = [program for program in programs if not load_adapters()[solver].refusal(program)]
    accepted, infeasible, errors, times = 0, 0, [], []
    for program in taken:
        if max(times[1:], default=0.0) > PATIENCE:
            break
        began = process_time()
        verdict = VerifiedSolver(solver).answer(program)
        times.append(process_time() - began)
        try:
            reference = program.cost(solve_program(program).x)
        except Infeasible:
            infeasible += 1
            accepted += verdict.kind == "infeasible"
            continue
        if verdict.kind == "solved" and verdict.solution is not None:
            accepted += 1
            off = abs(program.cost(verdict.solution.x) - reference)
            errors.append(off / max(abs(reference), TOLERANCE))
    cells = {"programs": len(programs), "asked": len(times), "accepted": accepted}
    cells |= {"infeasible": infeasible, "agreed": sum(error <= AGREEMENT for error in errors)}
    worst = {"worst_error": max(errors)} if errors else {}
    return cells | worst | ({"solve_ms": 1e3 * np.median(times)} if times else {})


def _record(overrides: list[str], scenario: str) -> list[ConicProgram]:
    """Fly a mission with the default conic solver, and return the programs that it was given."""
    asked: list[ConicProgram] = []

    def note(program: ConicProgram) -> SolverResult:
        asked.append(program)
        return solve_clarabel(program)

    conic = patch("problems.constraint_generation.can_generate", lambda *_: False)
    with conic, patch("problems.solvers.verified.solve_clarabel", note):
        sato.run(scenario, overrides=overrides)
    return asked
